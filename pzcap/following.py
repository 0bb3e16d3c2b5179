"""Follow the body from frame to frame in one direction of time.

A step predicts the pose with the velocity so far and improves it, coarse to fine, by Gauss-Newton on what the images
say (`pzcap.evidence`). When a step fits the silhouettes worse than usual something was lost: then it is tried again
with a wider prior and from where the body was, and each limb is taken from the attempt that fits it best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pzcap.body import DOF, Body, difference, limit_residuals, retract
from pzcap.evidence import (
    Appearance,
    Evidence,
    Normal,
    Observation,
    Terms,
    observe,
    place_body,
    place_view,
    signed_distance,
)
from pzcap.foreground import ForegroundConfig, refine
from pzcap.merging import Cut, best_of, mismatch
from pzcap.types import SEGMENTS, Array, Mask, Pose

SEGMENT_WIDTH_M = np.array(
    [{"pelvis": 0.3, "lumbar": 0.27, "thorax": 0.3, "head": 0.16, "upper_arm": 0.09, "forearm": 0.07, "hand": 0.05,
      "thigh": 0.15, "shank": 0.1, "foot": 0.08}[n.removeprefix("left_").removeprefix("right_")] for n in SEGMENTS]
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Round:
    """Some iterations with the same residuals."""

    terms: Terms
    iterations: int
    stiffness: float = 1.0  # the joints' prior; large: the body moves as a whole
    look: bool = False  # cut the silhouettes again first, with the body where it was found so far


def _schedule() -> tuple[Round, ...]:
    def terms(level: int, reach: float, contour_sigma: float, brightness_sigma: float) -> Terms:
        return Terms(level, reach, contour_sigma, brightness_sigma, 0.3, 0.15, 0.15)

    return (
        Round(terms(2, 30.0, 8.0, 20.0), 3, 5.0),
        Round(terms(2, 20.0, 4.0, 20.0), 3),
        Round(terms(1, 10.0, 2.0, 15.0), 3, look=True),
        Round(terms(0, 5.0, 1.0, 12.0), 3),
    )


@dataclass(frozen=True, slots=True)
class TrackingConfig:
    """Defaults suit a body of 150-400 pixels at 25-60 frames a second."""

    keyframe_position_sigma_m: float = 0.010  # how well a hand places the root
    keyframe_rotation_sigma_rad: float = 0.052  # and turns each joint
    appearance_rate: float = 0.15  # share of the image that the appearance takes on with each frame
    # what a prediction with constant velocity may be wrong by, a frame
    prediction_position_sigma_m: float = 0.03
    prediction_rotation_sigma_rad: float = 0.20
    velocity_gain: float = 0.8  # how fast the velocity follows
    limit_sigma_rad: float = 0.05
    cut_out_margin: float = 0.35  # what is kept of a view around the body, in sizes of the body
    second_look: bool = True  # cut the silhouettes again, now that the body is predicted
    foreground: ForegroundConfig = field(default_factory=ForegroundConfig)
    schedule: tuple[Round, ...] = field(default_factory=_schedule)
    start_widening: float = 4.0  # of a prediction's sigma while the velocity is not known
    longest_lead: int = 120  # frames before the first keyframe that are kept to be tracked backward


@dataclass(slots=True, eq=False)
class Step:
    """One direction's estimate of one instant."""

    pose: Pose
    velocity: Array  # (43,) tangent a frame
    hessian: Array  # (43, 43) of what the images alone say
    variance: Array  # (16,) relative: how little each segment is to be trusted
    seen: bool  # any view at all


class Follower:
    """Follows the body in one direction of time from a keyframe."""

    def __init__(
        self, body: Body, config: TrackingConfig, pose: Pose, velocity: Array, cuts: Sequence[Cut | None]
    ) -> None:
        self.body, self.config = body, config
        self.pose, self.velocity, self.age = pose, velocity, 0
        self._known = velocity != 0.0  # of each degree of freedom, whether the velocity is
        points = len(body.surface.points_m)
        self.appearances = [Appearance.unseen(points) for _ in cuts]
        sigma = np.full(DOF, config.prediction_rotation_sigma_rad)
        sigma[:3] = config.prediction_position_sigma_m
        self._sigma = sigma
        self._usual = mismatch(body, pose, cuts)
        _evidence(body, cuts).learn(pose, self.appearances, 1.0)

    def _attempt(self, cuts: Sequence[Cut | None], start: Pose, known: Mask) -> tuple[Pose, Normal, Evidence]:
        """Improve ``start``, trusting the prediction of the degrees of freedom (43,) whose velocity is ``known``."""
        sigma = self._sigma * np.where(known, 1.0, self.config.start_widening)
        return improve(self.body, cuts, start, np.diag(1.0 / sigma**2), self.appearances, self.config)

    def predict(self) -> Pose:
        return retract(self.pose, self.velocity)

    def step(self, cuts: Sequence[Cut | None]) -> Step:
        """Move on by one frame."""
        predicted = self.predict()
        self.age += 1
        if all(cut is None for cut in cuts):  # nothing was seen: coast, and slow down
            self.pose, self.velocity = predicted, 0.9 * self.velocity
            return Step(predicted, self.velocity, np.zeros((DOF, DOF)), np.full(len(SEGMENTS), 1e3), False)
        pose, normal, evidence = self._attempt(cuts, predicted, self._known)
        score = mismatch(self.body, pose, cuts)
        if score > 1.2 * self._usual + 0.004:  # something was lost: look wider, and also where it was a frame ago
            unknown = np.zeros(DOF, bool)
            tries = [pose, *(self._attempt(cuts, start, unknown)[0] for start in (predicted, self.pose))]
            pose, found = best_of(self.body, tries, cuts)
            if found < score:
                pose, normal, evidence = self._attempt(cuts, pose, self._known)
                score = mismatch(self.body, pose, cuts)
        self._usual += (0.5 if score < self._usual else 0.1) * (score - self._usual)
        evidence.learn(pose, self.appearances, self.config.appearance_rate)
        gain = np.where(self._known, self.config.velocity_gain, 1.0)
        self._known[:] = True
        self.velocity = self.velocity + gain * (difference(pose, self.pose) - self.velocity)
        self.pose = pose
        return Step(pose, self.velocity, normal.hessian, _variance(normal, self.age), True)


def _variance(normal: Normal, age: int) -> Array:
    """How little each segment is to be trusted (16,): it drifts away from its keyframe with age, and what misses the
    silhouette is wrong."""
    squares, found, sought = normal.contour.T
    misfit = (squares + 25.0 * (sought - found + 3.0)) / (sought + 3.0)
    return 0.1 * age + misfit**2


def _evidence(
    body: Body, cuts: Sequence[Cut | None], pose: Pose | None = None, config: TrackingConfig | None = None
) -> Evidence:
    """Prepare the views; with a pose, their silhouettes are cut a second time with the body where the pose has it."""
    if pose is not None and config is not None:
        _, points, normals = place_body(body, pose)
    views: list[Observation | None] = []
    for cut in cuts:
        if cut is None:
            views.append(None)
            continue
        probability = cut.probability
        if pose is not None and config is not None:
            height, width = probability.shape
            placed = place_view(body, points, normals, cut.camera)
            predicted = signed_distance(placed, cut.left, cut.top, width, height)
            probability = refine(cut.image, cut.background, cut.colours, predicted, config.foreground)
        views.append(observe(cut.image, probability, cut.camera, cut.left, cut.top))
    return Evidence(body, views, SEGMENT_WIDTH_M)


def improve(
    body: Body,
    cuts: Sequence[Cut | None],
    predicted: Pose,
    prior: Array,
    appearances: Sequence[Appearance | None],
    config: TrackingConfig,
) -> tuple[Pose, Normal, Evidence]:
    """Gauss-Newton from ``predicted``, whose information matrix (43, 43) is ``prior``, coarse to fine."""
    pose = predicted
    evidence = _evidence(body, cuts)
    normal: Normal | None = None
    for each in config.schedule:
        if each.look and config.second_look:
            evidence = _evidence(body, cuts, pose, config)
        placed = evidence.visibility(pose)
        stiff = np.ones(DOF)
        stiff[6:] = each.stiffness
        information = prior * stiff[:, None] * stiff
        for _ in range(each.iterations):
            normal = evidence.normal(pose, placed, appearances, each.terms)
            excess, violated = limit_residuals(pose)
            stiffness = violated / config.limit_sigma_rad**2
            hessian = normal.hessian + information + np.diag(stiffness)
            gradient = normal.gradient + information @ difference(predicted, pose) - stiffness * excess
            step = np.clip(np.linalg.solve(hessian, gradient), -0.35, 0.35)
            pose = retract(pose, step)
            if np.abs(step).max() < 1e-3:
                break
    assert normal is not None, "a schedule has at least one round"
    return pose, normal, evidence
