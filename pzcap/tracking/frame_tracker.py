"""Follow the body from frame to frame in one direction of time.

A step predicts the pose with the velocity so far and improves it, coarse to fine, by Gauss-Newton on what the images
say (`pzcap.tracking.pose_objective`). Where they say little, as of a forearm that is held against the trunk, joints are
expected to come to rest, and no arm to enter the trunk (`pzcap.tracking.self_collision`): if a joint were expected to
keep its velocity, a small error of it would grow with every frame until the limb is lost. When a step fits the
silhouettes worse than usual something was lost: then it is tried again with a wider prior and from where the body was,
and each limb is taken from the attempt that fits it best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from pzcap.body.skeleton import DOF, DOF_SEGMENT, Body, difference, forward, limit_residuals, retract
from pzcap.limbs.search import LIMBS, LimbSearch
from pzcap.tracking import self_collision
from pzcap.tracking.observation import Cut, PlacedView
from pzcap.tracking.pose_objective import Appearance, Normal, PoseObjective, Terms, misfit_px2
from pzcap.types import SEGMENTS, Array, Pose, PzcapError


@dataclass(frozen=True, slots=True)
class Round:
    """Some iterations with the same residuals."""

    terms: Terms
    iterations: int
    stiffness: float = 1.0  # the joints' prior; large: the body moves as a whole
    solid: bool = True  # the trunk keeps arms out; else one that is found again may pass through it
    surprise_m: float = 0.0  # left out where predictions have been nearer than this lately


def _schedule() -> tuple[Round, ...]:
    def terms(
        level: int, reach: float, contour_sigma: float, contour_weight: float, brightness_sigma: float,
        keypoint_scale: float,
    ) -> Terms:  # fmt: skip
        return Terms(level, reach, contour_sigma, brightness_sigma, contour_weight, 0.15, 0.15, 0.3, keypoint_scale)

    # the edge that is nearest to a hand is often another limb's: limbs by themselves are led to far edges with caution
    return (
        Round(terms(2, 30.0, 8.0, 0.3, 20.0, 10.0), 5, 5.0, solid=False, surprise_m=0.025),
        Round(terms(2, 20.0, 4.0, 0.15, 20.0, 10.0), 4, solid=False),
        Round(terms(1, 10.0, 2.0, 0.2, 15.0, 5.0), 3),
        Round(terms(0, 5.0, 1.0, 0.3, 12.0, 3.0), 1),
    )


@dataclass(frozen=True, slots=True)
class TrackingConfig:
    """Defaults suit a body of 150-400 pixels at 25-60 frames a second."""

    keyframe_position_sigma_m: float = 0.010
    """How well a hand places the root."""
    keyframe_rotation_sigma_rad: float = 0.052
    """And turns each joint."""
    appearance_rate: float = 0.15
    """Share of the image that the appearance takes on with each frame."""
    prediction_position_sigma_m: float = 0.03
    """What the pose that is expected may be wrong by, a frame."""
    prediction_rotation_sigma_rad: float = 0.20
    velocity_gain: float = 0.8
    """How fast the velocity follows."""
    joint_persistence: float = 0.2
    """Of a joint's velocity, what is expected to go on: unseen limbs come to rest."""
    limit_sigma_rad: float = 0.05
    cut_out_margin: float = 0.1
    """What is kept of a view around the body, in sizes of the body."""
    doubt_m2: float = 0.004
    """Foreground that nothing explains, or hall that a limb lies on, to search for the limb again."""
    step_tolerance: float = 3e-3
    """Metres, radians: a smaller step ends a round."""
    schedule: tuple[Round, ...] = field(default_factory=_schedule)
    start_widening: float = 4.0
    """Of a prediction's sigma while the velocity is not known."""
    shape_weight: float = 0.024
    """Of a frame's contour, on the body's shape: the next frame errs alike; 0: the body stays as the tape has it."""
    shape_texture_weight: float = 0.6
    """And of its texture."""
    shape_rounds: int = 2
    """Of correcting the body and improving the poses, a stretch."""
    acceleration_position_sigma_m: float = 0.01
    """What the motion accelerates by, a frame squared."""
    acceleration_rotation_sigma_rad: float = 0.05
    fall_sigma_m_s2: float = 2.5
    """What the centre of mass departs from a fall by in flight: the masses of the segments are not known."""
    polishing_sweeps: int = 2
    longest_stretch: int = 200
    """Frames that wait for a keyframe to be tracked backward."""
    longest_lead: int = 120
    """Frames before the first keyframe that are kept to be tracked backward."""

    def __post_init__(self) -> None:
        if not self.schedule or self.schedule[-1].surprise_m > 0.0:
            raise PzcapError("tracking.schedule has no last round that is always made; give it surprise_m: 0")

    @property
    def hand_sigma(self) -> Array:
        """(43,) How well a hand sets a keyframe: the standard deviation of the pose's tangent."""
        sigma = np.full(DOF, self.keyframe_rotation_sigma_rad)
        sigma[:3] = self.keyframe_position_sigma_m
        return sigma


@dataclass(slots=True, eq=False)
class Step:
    """One direction's estimate of one instant."""

    pose: Pose
    velocity: Array  # (43,) tangent a frame
    hessian: Array  # (43, 43) of what the images alone say
    contour: Array  # (16, 3) how well they bear it out, as `pzcap.tracking.pose_objective.Normal` has it
    variance: Array  # (16,) relative: how little each segment is to be trusted
    seen: bool  # any view at all


UNSEEN: Final = np.zeros((len(SEGMENTS), 3))
"""The contour of a body that no view shows."""
_LEAP: Final = 3.0
"""Sigmas of the prediction that nobody moves by."""
BESIDE: Final = 2
"""Frames beside a keyframe in which limbs are still where they are thought to be."""
_FORGETS: Final = 0.3
"""Share that the latest frame has in what predictions were off by."""


class Follower:
    """Follows the body in one direction of time from a keyframe."""

    def __init__(
        self, body: Body, config: TrackingConfig, pose: Pose, velocity: Array, cuts: Sequence[Cut | None]
    ) -> None:
        self.body, self.config = body, config
        self.pose, self.velocity, self.age = pose, velocity, 0
        self.surprise_m = config.prediction_position_sigma_m  # how far predictions have the joints off, lately
        self._known = velocity != 0.0  # of each degree of freedom, whether the velocity is
        self._limbs = LimbSearch(body)
        points = len(body.surface.points_m)
        self.appearances = [Appearance.unseen(points) for _ in cuts]
        sigma = np.full(DOF, config.prediction_rotation_sigma_rad)
        sigma[:3] = config.prediction_position_sigma_m
        self._sigma = sigma
        self._persistence = np.where(DOF_SEGMENT > 0, config.joint_persistence, 1.0)  # the body as a whole moves on
        evidence = PoseObjective(body, cuts)
        placed = evidence.visibility(pose)
        evidence.learn(placed, self.appearances, 1.0)
        # what drifts with the limbs is of no use to find them by: this is of the frames beside the keyframe alone
        self.known = [Appearance.unseen(points) for _ in cuts]
        evidence.learn(placed, self.known, 1.0)
        self._loose = self._limbs.loose(pose, evidence.grounds(placed))  # what is usual, square metres

    def predict(self) -> Pose:
        return retract(self.pose, self.velocity)

    def step(self, cuts: Sequence[Cut | None]) -> Step:
        """Move on by one frame."""
        predicted = self.predict()
        self.age += 1
        if all(cut is None for cut in cuts):  # nothing was seen: coast, slow down, and be less sure with every frame
            self.pose, self.velocity = predicted, 0.9 * self.velocity
            self.surprise_m = math.hypot(self.surprise_m, self.config.prediction_position_sigma_m)
            nothing, little = np.zeros((DOF, DOF)), np.full(len(SEGMENTS), 1e3)
            return Step(predicted, self.velocity, nothing, UNSEEN, little, False)
        evidence = PoseObjective(self.body, cuts)
        sigma = self._sigma * np.where(self._known, 1.0, self.config.start_widening)
        prior = np.diag(1.0 / sigma**2)
        expected = retract(self.pose, self._persistence * self.velocity)
        schedule = [each for each in self.config.schedule if self.surprise_m >= each.surprise_m]
        pose, normal = improve(evidence, predicted, prior, self.appearances, self.config, schedule, expected)
        placed = evidence.visibility(pose)
        evidence, pose, normal, placed, found = self._recover(evidence, pose, normal, placed)
        evidence.learn(placed, self.appearances, self.config.appearance_rate)
        if self.age <= BESIDE:
            evidence.learn(placed, self.known, 1.0 / (self.age + 1))
        gain = np.where(self._known, self.config.velocity_gain, 1.0)
        velocity = self.velocity + gain * (difference(pose, self.pose) - self.velocity)
        again = np.isin(DOF_SEGMENT, [s for limb in found for s in LIMBS[limb]])
        if evidence.detected:  # keypoints pull from far away: what came so is no motion
            again |= np.abs(difference(pose, predicted)) > _LEAP * sigma
        self._known = ~again
        self.velocity = np.where(again, 0.0, velocity)
        off = forward(self.body, pose)[:, :3, 3] - forward(self.body, predicted)[:, :3, 3]
        self.surprise_m += _FORGETS * (float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) - self.surprise_m)
        self.pose = pose
        variance = _variance(normal.contour, self.age)
        return Step(pose, self.velocity, normal.hessian, normal.contour, variance, True)

    def _recover(
        self, evidence: PoseObjective, pose: Pose, normal: Normal, placed: list[PlacedView | None]
    ) -> tuple[PoseObjective, Pose, Normal, list[PlacedView | None], list[int]]:
        """Search again for the limbs that the silhouettes do not bear out; also, which were found elsewhere."""
        config = self.config
        found: list[int] = []
        grounds = evidence.grounds(placed)
        loose = self._limbs.loose(pose, grounds)
        doubtful = np.flatnonzero(loose > 1.3 * self._loose + config.doubt_m2)
        self._loose += np.where(loose < self._loose, 0.5, 0.1) * (loose - self._loose)
        if not len(doubtful):
            return evidence, pose, normal, placed, found
        support = self._limbs.support(pose, grounds)
        for limb in doubtful.tolist():
            other = self._limbs.search(limb, pose, grounds)
            if not _explains_more(self._limbs.support(other, grounds), support, config.doubt_m2):
                continue
            free = np.where(np.isin(DOF_SEGMENT, LIMBS[limb]), config.start_widening, 0.1)
            prior = np.diag(1.0 / (self._sigma * free) ** 2)
            trial = PoseObjective(self.body, evidence.cuts)
            other, again = improve(trial, other, prior, self.appearances, config, config.schedule[1:])
            there = trial.visibility(other)
            grounds_there = trial.grounds(there)
            better = self._limbs.support(other, grounds_there)
            if _explains_more(better, support, config.doubt_m2):
                evidence, pose, normal, placed, grounds, support = trial, other, again, there, grounds_there, better
                found.append(limb)
        return evidence, pose, normal, placed, found


def _explains_more(support: Array, before: Array, by_m2: float) -> bool:
    """Whether the limbs cover more of the body, not only less of the hall: an arm in front of the trunk does that."""
    more = support.sum(axis=0) - before.sum(axis=0)
    return bool(more[0] > by_m2 and more[0] - more[1] > by_m2)


def _variance(contour: Array, age: int) -> Array:
    """How little each segment is to be trusted (16,): it drifts away from its keyframe with age, and what misses the
    silhouette is wrong."""
    return np.asarray(0.1 * age + misfit_px2(contour, 25.0) ** 2)


def improve(
    evidence: PoseObjective,
    start: Pose,
    prior: Array,
    appearances: Sequence[Appearance | None],
    config: TrackingConfig,
    schedule: Sequence[Round],
    expected: Pose | None = None,
) -> tuple[Pose, Normal]:
    """Gauss-Newton from ``start``, coarse to fine; the cameras of the ``evidence`` are corrected with it. Beside the
    images the pose ``expected``, else the start, counts with the information matrix ``prior`` (43, 43)."""
    pose, expected = start, expected or start
    normal: Normal | None = None
    for each in schedule:
        placed = evidence.visibility(pose)
        stiff = np.ones(DOF)
        stiff[6:] = each.stiffness
        information = prior * stiff[:, None] * stiff
        for _ in range(each.iterations):
            normal = evidence.normal(pose, placed, appearances, each.terms)
            stiffness, pull = restraint(evidence.body, pose, each.solid, config)
            hessian = normal.hessian + information + stiffness
            gradient = normal.gradient + information @ difference(expected, pose) + pull
            step = np.clip(np.linalg.solve(hessian, gradient), -0.35, 0.35)
            pose = retract(pose, step)
            evidence.correct(normal.free, step)
            if np.abs(step).max() < config.step_tolerance:
                break
    assert normal is not None, "the last round is always made"
    return pose, normal


def restraint(body: Body, pose: Pose, solid: bool, config: TrackingConfig) -> tuple[Array, Array]:
    """What no body can do, as normal equations (43, 43) and (43,): joints beyond their limits and, if it is ``solid``,
    arms in the trunk."""
    excess, violated = limit_residuals(pose)
    stiffness = violated / config.limit_sigma_rad**2
    hessian, gradient = np.diag(stiffness), -stiffness * excess
    if solid:
        inside, depth = self_collision.residuals(self_collision.shapes(body), forward(body, pose))
        hessian, gradient = hessian + inside.T @ inside, gradient - inside.T @ depth
    return hessian, gradient
