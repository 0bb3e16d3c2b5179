"""The frames between two keyframes, solved from both ends: drift removed (Yamamoto 2005), the body corrected.

The forward pass (`pzcap.tracking.tracker`) has tracked the body up to a keyframe. From there it is tracked backward;
the two passes are fused limb by limb (`pzcap.tracking.bidirectional_fusion`), the body is corrected, and all frames are
refined together (`pzcap.tracking.batch_refinement`). None of it needs what comes after the keyframe but the body, so
that the next interval's forward pass goes on meanwhile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pzcap.body.skeleton import Body
from pzcap.solver.gauss_newton import SolveReport
from pzcap.tracking.appearance import LimbAppearance
from pzcap.tracking.batch_refinement import RefinedBatch, refine_batch
from pzcap.tracking.bidirectional_fusion import discontinuous, fuse
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.frame_tracker import NO_CONTOUR, FrameTracker, PoseEstimate, fit_pose
from pzcap.tracking.interval import IntervalProblem, IntervalResult
from pzcap.tracking.keyframes import information
from pzcap.tracking.observation import Views
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.reacquisition import PassResults
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_appearance import shared
from pzcap.tracking.tracked_body import lost, tracked, trusted
from pzcap.tracking.tuning import SHAPE
from pzcap.tracking.view_sequence import ViewSequence
from pzcap.types import SEGMENTS, Array, Keyframe, Mask, Pose


def solved(problem: IntervalProblem) -> IntervalResult:
    """Solve an interval; without any frames, its keyframe by itself, with the body as corrected by then."""
    anchor, config = problem.anchor, problem.config
    if anchor is not None and anchor.fit.seen:
        estimate = problem.estimate.with_keyframe(anchor.key, anchor.fit.pose, anchor.views, anchor.rates, config)
        problem = replace(problem, estimate=estimate)
    if not problem.instants:
        assert anchor is not None, "an interval has a frame or a keyframe"
        fit, report = fit_keyframe(problem.estimate.body, anchor.key, anchor.views, anchor.rates, config)
        keyframe = tracked(problem.estimate, anchor.key.frame, trusted(anchor.key, fit))
        return IntervalResult([keyframe], problem.estimate, problem.clocks, [fit.pose], report)
    poses, views, doubt_m, passes = _passes(problem)
    frames_of = [None if each.second_field else each.frame for each in problem.instants]
    if anchor is not None:  # a frame like the others, with the hand's pose as prior
        frames_of, views = [*frames_of, anchor.key.frame], [*views, anchor.views]
        poses, doubt_m = [*poses, anchor.fit.pose], np.vstack([doubt_m, np.zeros(len(SEGMENTS))])
    batch, estimate = _refined(problem, poses, ViewSequence(views, problem.period), passes)
    frames = list(batch.frames)
    if anchor is not None:
        frames[-1] = trusted(anchor.key, frames[-1])
    doubt_m = np.fmax(doubt_m, batch.spread_m)
    done = [
        tracked(
            estimate, number, found, doubt, list(zip(objective.views, cameras, strict=True)),
            lost(objective, found.pose),
        )
        for number, found, doubt, objective, cameras in zip(
            frames_of, frames, doubt_m, batch.objectives, batch.cameras, strict=True
        )
        if number is not None
    ]  # fmt: skip
    return IntervalResult(
        done, estimate, batch.clocks, [*problem.before, *(found.pose for found in frames)][-2:], batch.report
    )


def fit_keyframe(
    body: Body, key: Keyframe, views: Views, rates: Array, config: TrackingConfig
) -> tuple[PoseEstimate, SolveReport]:
    """A keyframe's pose, fitted to the images with its own error as prior; ``rates`` (16, 12) are those of the segments
    there."""
    prior = information(key)
    if all(view is None for view in views):
        return PoseEstimate(key.pose, prior, NO_CONTOUR, False), SolveReport(True, 0, 0.0)
    fit = fit_pose(PoseObjective(body, views, rates), key.pose, prior, [None] * len(views), config, config.schedule)
    return PoseEstimate(fit.posed.pose, fit.normal.hessian + prior, fit.normal.contour, True), fit.report


def _passes(problem: IntervalProblem) -> tuple[list[Pose], list[Views], Array, PassResults]:
    """The poses of the frames after both passes, the views as the surer pass took them, by how much joints (T, 16) are
    in doubt where the two disagree, and what they leave behind."""
    anchor, body, before = problem.anchor, problem.estimate.body, problem.before[-1]
    ahead = [instant.forward for instant in problem.instants]
    if anchor is None:
        poses, agreed = [each.pose for each in ahead], np.zeros((len(ahead), len(SEGMENTS)))
        nowhere: Mask = agreed > 0.0
        views = [each.views for each in ahead]
        return poses, views, agreed, PassResults([poses], nowhere, nowhere, nowhere, shared(problem.reference))
    tracker = FrameTracker(body, problem.config, anchor.fit.pose, -anchor.velocity, anchor.views, -problem.period)
    back = [tracker.step(instant.views) for instant in reversed(problem.instants)][::-1]
    pairs = zip(problem.reference, tracker.reference, strict=True)
    reference = shared([one.with_other(other) for one, other in pairs])
    limbs = LimbAppearance(body, problem.config.appearance_score)
    views = [(b if a.lost > b.lost else a).views for a, b in zip(ahead, back, strict=True)]
    both = [[each.pose for each in one] for one in (ahead, back)]
    moving = [ViewSequence(views, problem.period).objectives(body, poses) for poses in both]

    def score(k: int, t: int) -> Array:
        return limbs.score(both[k][t], moving[k][t], reference)

    poses, apart_m, doubt_m = fuse(body, before, ahead, back, anchor.fit.pose, score)
    doubtful = discontinuous(body, before, poses, anchor.fit.pose, apart_m)
    return poses, views, doubt_m, PassResults(both, apart_m > 0.0, apart_m == 0.0, doubtful, reference)


def _refined(
    problem: IntervalProblem, poses: Sequence[Pose], sequence: ViewSequence, passes: PassResults
) -> tuple[RefinedBatch, BodyEstimate]:
    """Refine the poses of an interval, and the body with them. A keyframe that ends it has been accumulated before."""
    config, estimate = problem.config, problem.estimate
    key = None if problem.anchor is None else problem.anchor.key

    def refine(body: Body, passes: PassResults | None) -> RefinedBatch:
        return refine_batch(body, poses, sequence, problem.before, key, passes, problem.clocks, config)

    if not config.shape_weight:
        return refine(estimate.body, passes), estimate
    some = slice(None, None if key is None else -1, round(SHAPE.stride / sequence.period))
    for left in reversed(range(config.shape_rounds)):
        equations = estimate.accumulate(poses[some], sequence.objectives(estimate.body, poses)[some], config)
        before, estimate = estimate, estimate.solve(equations)
        moved = np.linalg.norm(estimate.body.offsets_m - before.body.offsets_m, axis=1).max()
        last = not left or moved < SHAPE.settled_m
        # to reacquire limbs takes long: in the last round alone
        batch = refine(estimate.body, passes if last else None)
        poses, sequence = [each.pose for each in batch.frames], sequence.corrected(batch.objectives)
        if last:
            break
    return batch, estimate.commit(equations)


def warm_up() -> None:
    """Done by the worker process, this has imported all that `solved` needs, which takes seconds."""
