"""The frames between two keyframes once more, all at once: the body corrected, the drift and the jitter taken out.

The passes from the keyframes have found the body in every frame, each from its own side. Now the contours of all these
frames correct the body's shape (`pzcap.body.shape_estimation`); then every pose is improved against the silhouettes and
against what each point of the skin looks like on average, with a motion that does not jerk
(`pzcap.tracking.banded_solver`). The keyframe that ends them is one of these frames: the hand that set it is wrong by
more than they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.body.shape_estimation import Said, ShapeEstimate, Sight
from pzcap.body.skeleton import DOF, Body, difference, forward, retract
from pzcap.limbs.search import LIMBS
from pzcap.tracking.appearance import LimbAppearance
from pzcap.tracking.banded_solver import smooth_step
from pzcap.tracking.bidirectional_fusion import choose
from pzcap.tracking.camera_refinement import MarginalisedCamera
from pzcap.tracking.contact import ties
from pzcap.tracking.flight import falls
from pzcap.tracking.frame_tracker import UNSEEN, TrackingConfig, restraint
from pzcap.tracking.observation import Cut, PlacedView
from pzcap.tracking.pose_objective import Appearance, PoseObjective
from pzcap.tracking.reacquisition import Passes, reacquire
from pzcap.types import Array, Keyframe, Mask, Pose

_WORTHWHILE_M2: Final = 0.002  # that a limb must gain a frame: whoever searches finds what looks a little better
_BRIGHTNESS_SIGMA: Final = 25.0  # grey levels, while the shape is not known: more than in tracking


@dataclass(frozen=True, slots=True, eq=False)
class RefinedBatch:
    """The poses of a stretch, and how well the images of each fix it."""

    poses: list[Pose]
    hessians: list[Array]  # (43, 43)
    contours: list[
        Array
    ]  # (16, 3) how well the silhouettes bear each out, as `pzcap.tracking.pose_objective.Normal` has it
    views: list[Sequence[Cut | None]]  # their cameras corrected
    free: list[list[MarginalisedCamera | None]]  # and how well these are known


def hear(
    body: Body,
    shape: ShapeEstimate,
    poses: Sequence[Pose],
    views: Sequence[Sequence[Cut | None]],
    config: TrackingConfig,
) -> Said:
    """What some frames of a stretch, tracked with ``body``, say of its shape."""
    terms = config.schedule[-1].terms
    evidence = [PoseObjective(body, cuts) for cuts in views]
    placed = [each.visibility(pose) for each, pose in zip(evidence, poses, strict=True)]
    appearances = _appearances(body, evidence, placed)
    anything = config.shape_weight / config.start_widening**2 * np.eye(DOF)
    sights = []
    for pose, each, where in zip(poses, evidence, placed, strict=True):
        rows = each.contour(pose, where, terms)
        rows.weight[:] *= config.shape_weight
        texture = each.texture(pose, where, appearances, replace(terms, brightness_sigma=_BRIGHTNESS_SIGMA))
        texture.hessians[:] *= config.shape_texture_weight
        texture.gradients[:] *= config.shape_texture_weight
        sights.append(Sight(forward(body, pose), rows, texture, anything, np.zeros(DOF)))
    return shape.hear(sights)


def accumulate_hand(
    body: Body, shape: ShapeEstimate, pose: Pose, key: Keyframe, hand: Array, cuts: Sequence[Cut | None],
    config: TrackingConfig,
) -> Said:  # fmt: skip
    """What a keyframe says of the shape: a hand knows where the joints are, and not only where the skin is.

    ``pose`` is the one settled on, ``hand`` the information (43, 43) of the keyframe's.
    """
    evidence = PoseObjective(body, cuts)
    rows = evidence.contour(pose, evidence.visibility(pose), config.schedule[-1].terms)
    rows.weight[:] *= config.shape_weight
    return shape.hear([Sight(forward(body, pose), rows, None, hand, hand @ difference(key.pose, pose))])


def refine_batch(
    body: Body, poses: Sequence[Pose], views: Sequence[Sequence[Cut | None]], before: Sequence[Pose],
    key: Keyframe | None, passes: Passes | None, frame_rate: float, config: TrackingConfig,
) -> RefinedBatch:  # fmt: skip
    """Improve the ``poses`` of a stretch of frames; in those ``before`` it the body is held fast. Where the last is a
    ``key``, what the hand made of it counts there beside the images.

    Where it is told what the ``passes`` have left behind in the others, limbs that do not look like themselves are also
    looked for once more (`pzcap.tracking.reacquisition`), and taken from there if that is worth more.
    """
    stretch = _Stretch(
        body, [PoseObjective(body, cuts) for cuts in views], before, key, frame_rate, config, LimbAppearance(body)
    )
    placed = stretch.visibility(poses)
    appearances = _appearances(body, stretch.evidence, placed)
    found = stretch.sweep(poses, placed, appearances)
    if passes is None:
        return found
    inner = len(poses) if key is None else len(poses) - 1
    again = reacquire(
        stretch.likeness, poses[:inner], stretch.evidence[:inner], placed[:inner], passes, before[-1],
        None if key is None else poses[-1],
    )  # fmt: skip
    if again is not None:
        otherwise = [*again.poses, *poses[inner:]]
        other = stretch.sweep(otherwise, stretch.visibility(otherwise), again.known)
        chosen = stretch.choose(found.poses, other.poses, again.lost, again.known)
        found = stretch.sweep(chosen, stretch.visibility(chosen), again.known)  # where they meet, they leap
    return found


def _appearances(
    body: Body, evidence: Sequence[PoseObjective], placed: Sequence[Sequence[PlacedView | None]]
) -> list[Appearance]:
    """What each point of the skin looks like on average over some frames, a view each."""
    means = [Appearance.unseen(len(body.surface.points_m)) for _ in placed[0]]
    for count, (each, where) in enumerate(zip(evidence, placed, strict=True), start=1):
        each.learn(where, means, 1.0 / count)
    return means


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """Frames that are solved for together."""

    body: Body
    evidence: list[PoseObjective]
    before: Sequence[Pose]
    key: Keyframe | None  # of the last of them
    frame_rate: float
    config: TrackingConfig
    likeness: LimbAppearance

    def visibility(self, poses: Sequence[Pose]) -> list[list[PlacedView | None]]:
        return [each.visibility(pose) for each, pose in zip(self.evidence, poses, strict=True)]

    def sweep(
        self, poses: Sequence[Pose], placed: Sequence[Sequence[PlacedView | None]], appearances: Sequence[Appearance]
    ) -> RefinedBatch:
        """Some Gauss-Newton steps, of the poses and of the cameras."""
        config = self.config
        found, hessians, contours = list(poses), [np.zeros((DOF, DOF)) for _ in poses], [UNSEEN for _ in poses]
        free: list[list[MarginalisedCamera | None]] = [[None] * len(each.cuts) for each in self.evidence]
        sigma = np.full(DOF, config.acceleration_rotation_sigma_rad)
        sigma[:3] = config.acceleration_position_sigma_m
        for _ in range(config.polishing_sweeps):
            gradients = []
            for t, (each, where) in enumerate(zip(self.evidence, placed, strict=True)):
                normal = each.normal(found[t], where, appearances, config.schedule[-1].terms)
                stiffness, pull = restraint(self.body, found[t], True, config)
                hessians[t] = normal.hessian + stiffness
                gradients.append(normal.gradient + pull)
                contours[t] = normal.contour
                free[t] = normal.free
            if self.key is not None:
                hand = 1.0 / config.hand_sigma**2
                hessians[-1] += np.diag(hand)
                gradients[-1] += hand * difference(self.key.pose, found[-1])
            chain = [*self.before, *found]
            tied = [*ties(self.body, chain), *falls(self.body, chain, self.frame_rate, config.fall_sigma_m_s2)]
            steps = smooth_step(found, hessians, gradients, sigma, self.before, tied).clip(-0.5, 0.5)
            found = [retract(pose, step) for pose, step in zip(found, steps, strict=True)]
            for each, cameras, step in zip(self.evidence, free, steps, strict=True):
                each.correct(cameras, step)
        return RefinedBatch(found, hessians, contours, [each.cuts for each in self.evidence], free)

    def choose(self, one: Sequence[Pose], other: Sequence[Pose], lost: Mask, known: Sequence[Appearance]) -> list[Pose]:
        """``one``, but the limbs that were ``lost`` (t, 16) in the first frames as ``other`` has them, where that is
        worth clearly more."""
        frames = np.flatnonzero(lost.any(axis=1))
        gain = np.zeros((len(lost), len(LIMBS)))
        gain[frames] = self._worth(other, frames, known) - self._worth(one, frames, known) - _WORTHWHILE_M2
        return choose(self.body, self.before[-1], one, other, lost, gain)

    def _worth(self, poses: Sequence[Pose], frames: NDArray[np.int64], known: Sequence[Appearance]) -> Array:
        """(N, 4) what each limb is worth in some ``frames``, as `Likeness.worth` has it."""
        return np.array([self.likeness.worth(poses[t], self.evidence[t], known) for t in frames])
