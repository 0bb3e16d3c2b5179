"""What lies between two keyframes, solved from both ends at once: drift removed (Yamamoto 2005), the body corrected.

The forward pass (`pzcap.tracking.tracker`) has followed the body up to a keyframe. From there it is followed backward;
the two passes are merged limb by limb (`pzcap.tracking.bidirectional_fusion`), the body is corrected from what came
out, and all frames are improved together (`pzcap.tracking.batch_refinement`). None of it needs what comes after the
keyframe but the body, so that the next interval's forward pass goes on meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pzcap.body.shape_estimation import Shape, ShapeEstimate
from pzcap.body.skeleton import DOF, Body, forward, joint_jacobians, joints
from pzcap.tracking.appearance import LimbAppearance, shared
from pzcap.tracking.batch_refinement import RefinedBatch, accumulate_hand, hear, refine_batch
from pzcap.tracking.bidirectional_fusion import leaping, merge
from pzcap.tracking.camera_refinement import Correction, MarginalisedCamera
from pzcap.tracking.frame_tracker import UNSEEN, Follower, Step, TrackingConfig, improve
from pzcap.tracking.keypoint_residuals import LandmarkEstimate
from pzcap.tracking.observation import Cut
from pzcap.tracking.pose_objective import Appearance, PoseObjective, misfit_px2
from pzcap.tracking.reacquisition import Passes
from pzcap.tracking.shape_refit import refit_poses
from pzcap.types import PARENTS, SEGMENTS, Array, Keyframe, Pose

_ASTRAY_PX: Final = 4.0  # misfit of a joint that is as likely astray as not
_SUDDEN: Final = 4.0  # by how much a pixel more changes the logarithm of those odds
_ASTRAY_M: Final = 0.15  # how far off it is then
_SOME: Final = 4
"""Of so many frames one corrects the body: its neighbours say the same."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """A frame after a keyframe, as the forward pass has it."""

    frame: int
    cuts: list[Cut | None]
    step: Step


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A keyframe, and what the images make of it."""

    key: Keyframe
    cuts: list[Cut | None]
    settled: Step
    velocity: Array  # (43,) with which the forward pass arrives at it


def astray(contour: Array) -> Array:
    """The probability (16,) that a joint is not where it was found, from how well the outlines of the two segments that
    meet there fit the silhouettes: ``contour`` (16, 3) as `pzcap.tracking.pose_objective.Normal` has it. What it was
    fitted to is said in docs/method.md."""
    misfit_px = np.sqrt(misfit_px2(contour + contour[np.maximum(PARENTS, 0)], 1.0))
    return np.asarray(1.0 / (1.0 + np.exp(_ASTRAY_PX - misfit_px) ** _SUDDEN))


class IntervalSolver:
    """Solves one interval after the other. The body gets better with each."""

    def __init__(self, body: Body, frame_rate: float, config: TrackingConfig) -> None:
        self.body, self.frame_rate, self.config = body, frame_rate, config
        self._shape = ShapeEstimate(body)
        # of the joints, until the images have told
        self._known = Shape(self._shape.amounts_m, np.full(len(SEGMENTS), 2 * body.sigma_m**2))
        self._landmarks = LandmarkEstimate(body.landmarks)
        self._before: list[Pose]  # the frames up to where the interval begins, two at most
        self._hand = np.diag(1.0 / config.hand_sigma**2)

    def settle(self, pose: Pose, cuts: list[Cut | None]) -> Step:
        """A keyframe's pose, improved by the images with the hand's error as prior."""
        unseen: list[Appearance | None] = [None] * len(cuts)
        if all(cut is None for cut in cuts):
            return Step(pose, np.zeros(DOF), self._hand, UNSEEN, np.zeros(len(SEGMENTS)), False)
        evidence = PoseObjective(self.body, cuts)
        pose, normal = improve(evidence, pose, self._hand, unseen, self.config, self.config.schedule)
        hessian, sure = normal.hessian + self._hand, np.zeros(len(SEGMENTS))
        return Step(pose, np.zeros(DOF), hessian, normal.contour, sure, True)

    def begin(self, anchor: Anchor) -> Tracked:
        """The first keyframe: nothing lies before it."""
        self._learn(anchor)
        return self._arrive(anchor)

    def solve(self, interval: Sequence[Instant], known: Sequence[Appearance], anchor: Anchor | None) -> list[Tracked]:
        """The frames of an interval, and the keyframe that ends it; ``anchor`` is None where it ends without.

        ``known`` is what the skin looked like in each view beside the keyframe that it began with.
        """
        if anchor is not None:
            self._learn(anchor)
        if interval:
            return self._solve(interval, known, anchor)
        return [] if anchor is None else [self._arrive(anchor)]

    def result(
        self, frame: int, pose: Pose, hessian: Array, contour: Array, valid: bool, doubt_m: Array | float = 0.0,
        cameras: Sequence[tuple[Cut | None, MarginalisedCamera | None]] = (),
    ) -> Tracked:  # fmt: skip
        """The body at an instant. ``contour`` (16, 3) is as `pzcap.tracking.pose_objective.Normal` has it; ``doubt_m``
        (16,): how far apart two estimates of a joint are that do not agree. ``cameras``, where they were corrected, is
        each view with the camera as it is now, and how well that is known."""
        frames = forward(self.body, pose)
        sigma = np.full(DOF, self.config.prediction_rotation_sigma_rad)
        sigma[:3] = self.config.prediction_position_sigma_m
        covariance = np.asarray(np.linalg.inv(hessian + np.diag(1.0 / sigma**2)), np.float64)
        jacobians = joint_jacobians(frames)
        variance = np.einsum("jad,de,jae->j", jacobians, covariance, jacobians)
        variance += self._known.joint_variance_m2 + (0.5 * np.asarray(doubt_m)) ** 2 + astray(contour) * _ASTRAY_M**2
        corrections = tuple(
            None if cut is None or cut.aim is None or free is None
            else Correction(cut.aim.correction, free.covariance_with(covariance))
            for cut, free in cameras
        )  # fmt: skip
        return Tracked(frame, pose, frames[:, :3, 3], np.sqrt(variance), valid, self._known, corrections)

    def refit_shape(self, tracked: Iterable[Tracked]) -> list[Tracked]:
        """What was ``tracked`` with the body as it was known then, with the body as it is known now."""
        now, then, body = self._known, self._known, self.body
        found = []
        for each in tracked:
            if each.shape is not then:  # all of an interval share theirs
                then, body = each.shape, self._shape.body(each.shape.amounts_m)
            if then is not now:
                pose = refit_poses(each.pose, body, self.body)
                variance = each.sigma_m**2 - then.joint_variance_m2 + now.joint_variance_m2
                each = replace(each, pose=pose, joints_m=joints(self.body, pose), sigma_m=np.sqrt(variance), shape=now)
            found.append(each)
        return found

    def _learn(self, anchor: Anchor) -> None:
        """What a keyframe says of the body, and of where on it the detector's keypoints lie."""
        if not anchor.settled.seen:
            return
        pose, cuts = anchor.settled.pose, anchor.cuts
        if self.config.shape_weight:
            self._shape.keep(accumulate_hand(self.body, self._shape, pose, anchor.key, self._hand, cuts, self.config))
        frames = forward(self.body, pose)
        for cut in cuts:
            if cut is not None and cut.person is not None:
                self._landmarks.add(frames, cut.seen.camera, cut.person)
        self.body = replace(self.body, landmarks=self._landmarks.solve())

    def _arrive(self, anchor: Anchor) -> Tracked:
        """A keyframe by itself, as the body corrected by then has it; the next interval begins there."""
        settled = self.settle(anchor.key.pose, anchor.cuts)
        self._before = [settled.pose]
        return self._at(anchor.key, settled.pose, settled.hessian)

    def _at(
        self,
        key: Keyframe,
        pose: Pose,
        hessian: Array,
        cameras: Sequence[tuple[Cut | None, MarginalisedCamera | None]] = (),
    ) -> Tracked:
        # a hand knows where the limbs are: what the images do not bear out is a contradiction
        # (`pzcap.extras.keyframe_diagnostics`)
        return self.result(key.frame, pose, hessian, UNSEEN, True, cameras=cameras)

    def _solve(self, interval: Sequence[Instant], known: Sequence[Appearance], anchor: Anchor | None) -> list[Tracked]:
        views, steps = [instant.cuts for instant in interval], [instant.step for instant in interval]
        after = None if anchor is None else anchor.settled.pose
        if anchor is None or after is None:
            poses, doubt = [step.pose for step in steps], np.zeros((len(steps), len(SEGMENTS)))
            passes = Passes([poses], doubt > 0.0, doubt > 0.0, shared(known))
        else:
            back = Follower(self.body, self.config, after, -anchor.velocity, anchor.cuts)
            behind = [back.step(cuts) for cuts in reversed(views)][::-1]
            known = shared([one.with_other(other) for one, other in zip(known, back.known, strict=True)])
            likeness = LimbAppearance(self.body)

            def worth(t: int, pose: Pose) -> Array:
                return likeness.worth(pose, PoseObjective(self.body, views[t]), known)

            poses, doubt = merge(self.body, self._before[-1], steps, behind, after, worth)
            doubtful = leaping(self.body, self._before[-1], poses, after, doubt)
            both = [[step.pose for step in one] for one in (steps, behind)]
            passes = Passes(both, doubt > 0.0, doubtful, known)
        key = None
        if anchor is not None:  # a frame like the others, of which the hand has told something besides
            key, poses, views = anchor.key, [*poses, anchor.settled.pose], [*views, anchor.cuts]
        polished = self._polish(poses, views, key, passes)
        self._before = [*self._before, *polished.poses][-2:]
        cameras = [list(zip(cuts, free, strict=True)) for cuts, free in zip(polished.views, polished.free, strict=True)]
        found = zip(polished.poses, polished.hessians, polished.contours, cameras, strict=True)
        done = [
            self.result(instant.frame, pose, hessian, contour, instant.step.seen, apart, known)
            for instant, (pose, hessian, contour, known), apart in zip(interval, found, doubt, strict=False)
        ]
        return done if key is None else [*done, self._at(key, polished.poses[-1], polished.hessians[-1], cameras[-1])]

    def _polish(
        self, poses: list[Pose], views: Sequence[Sequence[Cut | None]], key: Keyframe | None, passes: Passes
    ) -> RefinedBatch:
        """Improve the poses of an interval, and the body with them. A ``key`` that ends it has told of the body."""
        if not self.config.shape_weight:
            return refine_batch(self.body, poses, views, self._before, key, passes, self.frame_rate, self.config)
        inner = slice(None if key is None else -1)
        for left in reversed(range(self.config.shape_rounds)):
            said = hear(self.body, self._shape, poses[inner][::_SOME], views[inner][::_SOME], self.config)
            self.body = replace(self._shape.solve(said), landmarks=self.body.landmarks)
            again = None if left else passes  # a second look takes long: in the last round alone
            polished = refine_batch(self.body, poses, views, self._before, key, again, self.frame_rate, self.config)
            poses, views = polished.poses, polished.views
        self._shape.keep(said)
        self._known = Shape(self._shape.amounts_m, self._shape.joint_variance())
        return polished


def solved(
    solver: IntervalSolver, interval: Sequence[Instant], known: Sequence[Appearance], anchor: Anchor | None
) -> tuple[IntervalSolver, list[Tracked]]:
    """The ``solver`` after `IntervalSolver.solve`, and what came of it: a process elsewhere works on a copy of it."""
    done = solver.solve(interval, known, anchor)
    return solver, done


def nothing() -> None:
    """Done elsewhere, this has imported all that `solved` needs, which takes seconds."""
