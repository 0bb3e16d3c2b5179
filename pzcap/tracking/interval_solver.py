"""The frames between two keyframes, solved from both ends: drift removed (Yamamoto 2005), the body corrected.

The forward pass (`pzcap.tracking.tracker`) has tracked the body up to a keyframe. From there it is tracked backward;
the two passes are fused limb by limb (`pzcap.tracking.bidirectional_fusion`), the body is corrected, and all frames are
refined together (`pzcap.tracking.batch_refinement`). None of it needs what comes after the keyframe but the body, so
that the next interval's forward pass goes on meanwhile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.body.kinematics import forward, joint_jacobians
from pzcap.body.shape_estimation import Shape
from pzcap.body.skeleton import Body
from pzcap.solver.gauss_newton import SolveReport
from pzcap.tracking.appearance import LimbAppearance
from pzcap.tracking.batch_refinement import RefinedBatch, refine_batch
from pzcap.tracking.bidirectional_fusion import discontinuous, fuse
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.camera_refinement import Correction, MarginalisedCamera
from pzcap.tracking.frame_tracker import NO_CONTOUR, FrameEstimate, FrameTracker, PoseEstimate, fit_pose, probably_lost
from pzcap.tracking.keyframes import information
from pzcap.tracking.limbs import mismatch
from pzcap.tracking.observation import ViewCrop, Views
from pzcap.tracking.pixel_time import ClockEstimate
from pzcap.tracking.pose_objective import PoseObjective, ViewSequence, misfit_px2
from pzcap.tracking.reacquisition import PassResults
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_appearance import Appearances, shared
from pzcap.tracking.tuning import INTERVAL, SHAPE
from pzcap.types import PARENTS, SEGMENTS, Array, Keyframe, Mask, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """The body at one instant."""

    frame: int
    pose: Pose
    joints_m: Array  # (16, 3)
    sigma_m: Array  # (16,)
    valid: bool
    shape: Shape  # of the body that was tracked
    corrections: tuple[Correction | None, ...]  # of the cameras, one a view; empty: not solved with other frames
    lost: float = 0.0  # probability that the body as a whole is not where it was found, see `lost`


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """An instant after a keyframe, as the forward pass has it."""

    frame: int
    views: Views
    forward: FrameEstimate
    second_field: bool = False  # half a frame period after the frame


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A keyframe, fitted to its images."""

    key: Keyframe
    views: Views
    fit: PoseEstimate
    velocity: Array  # (43,) with which the forward pass arrives at it
    rates: Array  # (16, 12) the same of the segments, as in `pixel_time.rates_between`


@dataclass(frozen=True, slots=True, eq=False)
class IntervalProblem:
    """The instants between two keyframes, for `solved`."""

    estimate: BodyEstimate
    clocks: ClockEstimate
    before: Sequence[Pose]  # of up to two frames before the first of them
    instants: Sequence[Instant]
    reference: Appearances  # of the skin beside the keyframe that the interval began with, a view each
    anchor: Anchor | None  # the keyframe that ends them; None: none does
    config: TrackingConfig
    period: float  # frame periods from an instant to the next


@dataclass(frozen=True, slots=True, eq=False)
class IntervalResult:
    """The solution of an `IntervalProblem`."""

    tracked: list[Tracked]  # the frames, and the keyframe that ends them
    estimate: BodyEstimate
    clocks: ClockEstimate
    before: Sequence[Pose]  # of the last two frames
    report: SolveReport


def solved(problem: IntervalProblem) -> IntervalResult:
    """Solve an interval; without any frames, its keyframe by itself, with the body as corrected by then."""
    anchor, config = problem.anchor, problem.config
    if anchor is not None and anchor.fit.seen:
        estimate = problem.estimate.with_keyframe(anchor.key, anchor.fit.pose, anchor.views, anchor.rates, config)
        problem = replace(problem, estimate=estimate)
    if not problem.instants:
        assert anchor is not None, "an interval has a frame or a keyframe"
        fit, report = fit_keyframe(problem.estimate.body, anchor.key, anchor.views, anchor.rates, config)
        keyframe = tracked(problem.estimate, config, anchor.key.frame, trusted(anchor.key, fit))
        return IntervalResult([keyframe], problem.estimate, problem.clocks, [fit.pose], report)
    poses, views, disagreement, passes = _passes(problem)
    frames_of = [None if each.second_field else each.frame for each in problem.instants]
    if anchor is not None:  # a frame like the others, with the hand's pose as prior
        frames_of, views = [*frames_of, anchor.key.frame], [*views, anchor.views]
        poses, disagreement = [*poses, anchor.fit.pose], np.vstack([disagreement, np.zeros(len(SEGMENTS))])
    batch, estimate = _refined(problem, poses, ViewSequence(views, problem.period), passes)
    frames = list(batch.frames)
    if anchor is not None:
        frames[-1] = trusted(anchor.key, frames[-1])
    doubt_m = np.fmax(0.5 * disagreement, batch.spread_m)
    done = [
        tracked(
            estimate, config, number, found, doubt, list(zip(objective.views, cameras, strict=True)),
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
    prior = information(key, config)
    if all(view is None for view in views):
        return PoseEstimate(key.pose, prior, NO_CONTOUR, False), SolveReport(True, 0, 0.0)
    fit = fit_pose(PoseObjective(body, views, rates), key.pose, prior, [None] * len(views), config, config.schedule)
    return PoseEstimate(fit.posed.pose, fit.normal.hessian + prior, fit.normal.contour, True), fit.report


def tracked(
    estimate: BodyEstimate, config: TrackingConfig, frame: int, found: PoseEstimate,
    doubt_m: Array | float = 0.0,
    cameras: Sequence[tuple[ViewCrop | None, MarginalisedCamera | None]] = (), lost: float = 0.0,
) -> Tracked:  # fmt: skip
    """The body at an instant. ``doubt_m`` (16,) is the deviation of a joint that may be in several places: those of two
    estimates that do not agree, or of postures that score nearly as much.
    ``cameras``, where they were corrected, is each view with the camera as it is now, and the marginalised one;
    ``lost`` the probability that the whole body is elsewhere."""
    frames = forward(estimate.body, found.pose)
    information = found.hessian + np.diag(1.0 / config.prediction_sigma**2)
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    jacobians = joint_jacobians(frames)
    variance = np.einsum("jad,de,jae->j", jacobians, covariance, jacobians)
    unsure = misplaced(found.contour) + lost
    variance += estimate.known.joint_variance_m2 + np.asarray(doubt_m) ** 2 + unsure * INTERVAL.misplaced_m**2
    corrections = tuple(
        None if view is None or view.camera_prior is None or camera is None
        else Correction(view.camera_prior.correction, camera.covariance_with(covariance))
        for view, camera in cameras
    )  # fmt: skip
    sigma = np.sqrt(variance)
    return Tracked(frame, found.pose, frames[:, :3, 3], sigma, found.seen, estimate.known, corrections, lost)


def trusted(key: Keyframe, found: PoseEstimate) -> PoseEstimate:
    """The pose ``found`` of a keyframe. A hand knows where the limbs are: what the images do not bear out is a
    contradiction (`pzcap.extras.keyframe_diagnostics`), and adds nothing to the sigmas. A detector may be wrong."""
    return replace(found, contour=NO_CONTOUR, seen=True) if not key.found else found


def misplaced(contour: Array) -> Array:
    """Probability (16,) that a joint is not where it was found, from how well the contours of the two segments that
    meet there fit the silhouettes: ``contour`` (16, 3) as `pzcap.tracking.pose_objective.PoseEquations` has it. How
    it was fitted stands in docs/method.md."""
    misfit_px = np.sqrt(misfit_px2(contour + contour[np.maximum(PARENTS, 0)], 1.0))
    return np.asarray(1.0 / (1.0 + np.exp(INTERVAL.misplaced_px - misfit_px) ** INTERVAL.misplaced_slope))


def lost(objective: PoseObjective, pose: Pose) -> float:
    """Probability that the body as a whole is not at ``pose``."""
    return probably_lost(mismatch(objective.views, objective.place(pose)[1]))


def _passes(problem: IntervalProblem) -> tuple[list[Pose], list[Views], Array, PassResults]:
    """The poses of the frames after both passes, the views as the surer pass took them, how far the two are apart
    (T, 16), and what they leave behind."""
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

    poses, disagreement = fuse(body, before, ahead, back, anchor.fit.pose, score)
    doubtful = discontinuous(body, before, poses, anchor.fit.pose, disagreement)
    return poses, views, disagreement, PassResults(both, disagreement > 0.0, disagreement == 0.0, doubtful, reference)


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
