"""Differential articulated tracking between keyframes, the drift removed (section 5; Yamamoto 2005).

From each keyframe the body is followed forward in time to the next one, and from there backward to this one. Each step
predicts the pose with the velocity so far and improves it, coarse to fine, by Gauss-Newton on what the images say
(`pzcap.evidence`): the brightness of every visible point of the skin against its slowly adapting appearance, and the
body's contour against the silhouette. A forward pass drifts away from its keyframe as a backward pass does from the
other; merging them limb by limb by their confidence removes the drift.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from pzcap.body import DOF, DOF_SEGMENT, Body, difference, forward, joint_jacobians, limit_residuals, retract
from pzcap.evidence import (
    Appearance,
    Evidence,
    Normal,
    Observation,
    Terms,
    body_window,
    observe,
    place_body,
    place_view,
    signed_distance,
)
from pzcap.foreground import ForegroundConfig, refine
from pzcap.merging import Cut, best_of, merge, mismatch
from pzcap.types import SEGMENTS, Array, Camera, Image, Keyframe, Mask, Motion, Pose, PzcapError, Silhouette

_SEGMENT_WIDTH_M = np.array(
    [{"pelvis": 0.3, "lumbar": 0.27, "thorax": 0.3, "head": 0.16, "upper_arm": 0.09, "forearm": 0.07, "hand": 0.05,
      "thigh": 0.15, "shank": 0.1, "foot": 0.08}[n.removeprefix("left_").removeprefix("right_")] for n in SEGMENTS]
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One camera's part of an instant."""

    image: Image  # (H, W, 3)
    camera: Camera
    silhouette: Silhouette


@dataclass(frozen=True, slots=True, eq=False)
class TrackInput:
    """One instant. A view that was dropped, or whose camera is not known, is None."""

    frame: int
    views: tuple[View | None, ...]  # one a camera


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """The body at one instant."""

    frame: int
    pose: Pose
    joints_m: Array  # (16, 3)
    sigma_m: Array  # (16,)
    valid: bool


@dataclass(frozen=True, slots=True)
class Round:
    """Some iterations with the same residuals."""

    terms: Terms
    iterations: int
    stiffness: float = 1.0  # the joints' prior; large: the body moves as a whole


def _schedule() -> tuple[Round, ...]:
    def terms(level: int, reach: float, contour_sigma: float, brightness_sigma: float) -> Terms:
        return Terms(level, reach, contour_sigma, brightness_sigma, 0.3, 0.15, 0.15)

    return (
        Round(terms(2, 30.0, 8.0, 20.0), 3, 5.0),
        Round(terms(2, 20.0, 4.0, 20.0), 3),
        Round(terms(1, 10.0, 2.0, 15.0), 3),
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
class _Step:
    """One direction's estimate of one instant."""

    pose: Pose
    velocity: Array  # (43,) tangent a frame
    hessian: Array  # (43, 43) of what the images alone say
    variance: Array  # (16,) relative: how little each segment is to be trusted
    seen: bool  # any view at all


@dataclass(slots=True, eq=False)
class _Instant:
    """A frame between two keyframes, waiting for the backward pass."""

    frame: int
    cuts: list[Cut | None]
    step: _Step


class _Follower:
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
        return _improve(self.body, cuts, start, np.diag(1.0 / sigma**2), self.appearances, self.config)

    def predict(self) -> Pose:
        return retract(self.pose, self.velocity)

    def step(self, cuts: Sequence[Cut | None]) -> _Step:
        """Move on by one frame."""
        predicted = self.predict()
        self.age += 1
        if all(cut is None for cut in cuts):  # nothing was seen: coast, and slow down
            self.pose, self.velocity = predicted, 0.9 * self.velocity
            return _Step(predicted, self.velocity, np.zeros((DOF, DOF)), np.full(len(SEGMENTS), 1e3), False)
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
        return _Step(pose, self.velocity, normal.hessian, _variance(normal, self.age), True)


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
            probability = refine(cut.image, cut.background, cut.camera, cut.left, cut.top, predicted, config.foreground)
        views.append(observe(cut.image, probability, cut.camera, cut.left, cut.top))
    return Evidence(body, views, _SEGMENT_WIDTH_M)


def _improve(
    body: Body,
    cuts: Sequence[Cut | None],
    predicted: Pose,
    prior: Array,
    appearances: Sequence[Appearance | None],
    config: TrackingConfig,
) -> tuple[Pose, Normal, Evidence]:
    """Gauss-Newton from ``predicted``, whose information matrix (43, 43) is ``prior``, coarse to fine."""
    pose = predicted
    evidence = _evidence(body, cuts, predicted, config if config.second_look else None)
    normal: Normal | None = None
    for each in config.schedule:
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


def _cut(body: Body, view: View | None, pose: Pose, config: TrackingConfig) -> Cut | None:
    """The part of a view around the body, copied so that the frame itself can be let go."""
    if view is None or not view.silhouette.valid:
        return None
    window = body_window(body, pose, view.camera, config.cut_out_margin)
    if window is None:
        return None
    left, top, right, bottom = window
    part = np.s_[top:bottom, left:right]
    return Cut(
        view.camera, left, top, view.image[part].copy(), view.silhouette.background[part].copy(),
        view.silhouette.probability[part].copy(),
    )  # fmt: skip


class _Tracker:
    def __init__(self, body: Body, config: TrackingConfig) -> None:
        self.body, self.config = body, config
        sigma = np.full(DOF, config.keyframe_rotation_sigma_rad)
        sigma[:3] = config.keyframe_position_sigma_m
        self._hand = np.diag(1.0 / sigma**2)

    def cut(self, views: Sequence[View | None], pose: Pose) -> list[Cut | None]:
        return [_cut(self.body, view, pose, self.config) for view in views]

    def settle(self, pose: Pose, cuts: list[Cut | None]) -> _Step:
        """A keyframe's pose, improved by the images with the hand's error as prior."""
        unseen: list[Appearance | None] = [None] * len(cuts)
        if all(cut is None for cut in cuts):
            return _Step(pose, np.zeros(DOF), self._hand, np.zeros(len(SEGMENTS)), False)
        pose, normal, _ = _improve(self.body, cuts, pose, self._hand, unseen, self.config)
        return _Step(pose, np.zeros(DOF), normal.hessian + self._hand, np.zeros(len(SEGMENTS)), True)

    def result(self, frame: int, pose: Pose, hessian: Array, valid: bool) -> Tracked:
        frames = forward(self.body, pose)
        sigma = np.full(DOF, self.config.prediction_rotation_sigma_rad)
        sigma[:3] = self.config.prediction_position_sigma_m
        covariance = np.linalg.inv(hessian + np.diag(1.0 / sigma**2))
        jacobians = joint_jacobians(frames)
        variance = np.einsum("jad,de,jae->j", jacobians, covariance, jacobians)
        # what the images cannot tell: joints that the tape has put elsewhere in the body
        return Tracked(frame, pose, frames[:, :3, 3], np.sqrt(variance + 2 * self.body.sigma_m**2), valid)


def track(
    body: Body, keyframes: Sequence[Keyframe], inputs: Iterable[TrackInput], config: TrackingConfig
) -> Iterator[Tracked]:
    """Track the body through ``inputs``, which come in the order of their frames; one result each, in that order.

    Results come an interval between keyframes late, since each interval is tracked from both ends; cut-outs of one
    interval are all that is kept. Before the first keyframe the body is tracked backward only, after the last one
    forward only. Raises PzcapError when there is no keyframe.
    """
    if not keyframes:
        raise PzcapError("tracking: no keyframes; pose the body in at least one frame (keyframes.json)")
    poses = {key.frame: key.pose for key in keyframes}
    tracker = _Tracker(body, config)
    follower: _Follower | None = None
    anchor: _Step | None = None
    lead: list[TrackInput] = []
    waiting: list[_Instant] = []
    for item in inputs:
        if item.frame in poses:
            cuts = tracker.cut(item.views, poses[item.frame])
            arrived = follower
            anchor = tracker.settle(poses[item.frame], cuts)
            velocity = np.zeros(DOF) if arrived is None else _carried(arrived, cuts, anchor.pose)
            follower = _Follower(body, config, anchor.pose, velocity, cuts)
            backward = _Follower(body, config, anchor.pose, -velocity, cuts)
            yield from _finish_lead(tracker, lead, backward)
            lead = []
            yield from _finish(tracker, waiting, backward)
            waiting = []
            yield tracker.result(item.frame, anchor.pose, anchor.hessian, True)
        elif follower is None:
            lead.append(item)
            if len(lead) > config.longest_lead:
                old = lead.pop(0)
                yield tracker.result(old.frame, next(iter(poses.values())), np.zeros((DOF, DOF)), False)
        else:
            cuts = tracker.cut(item.views, follower.predict())
            step = follower.step(cuts)
            waiting.append(_Instant(item.frame, cuts, step))
            if item.frame > max(poses):
                waiting.pop()
                yield tracker.result(item.frame, step.pose, step.hessian, step.seen)
    for instant in waiting:
        yield tracker.result(instant.frame, instant.step.pose, instant.step.hessian, instant.step.seen)


def _carried(arriving: _Follower, cuts: Sequence[Cut | None], pose: Pose) -> Array:
    """The velocity with which the forward pass arrives, of those joints that arrive where the keyframe has them."""
    arrived = arriving.step(cuts)
    off = np.abs(difference(pose, arrived.pose))
    limit = np.full(DOF, 0.5)
    limit[:3] = 0.1
    lost = np.zeros(len(SEGMENTS), bool)
    lost[DOF_SEGMENT[off > limit]] = True
    return np.where(lost[DOF_SEGMENT], 0.0, arrived.velocity)


def _finish(tracker: _Tracker, waiting: list[_Instant], backward: _Follower) -> Iterator[Tracked]:
    """Track the interval backward and merge it with the forward pass."""
    done: list[Tracked] = []
    for instant in reversed(waiting):
        step = backward.step(instant.cuts)
        pose, _ = merge(tracker.body, instant.step.pose, step.pose, instant.step.variance, step.variance, instant.cuts)
        instant.cuts = []
        done.append(
            tracker.result(instant.frame, pose, instant.step.hessian + step.hessian, step.seen or instant.step.seen)
        )
    yield from reversed(done)


def _finish_lead(tracker: _Tracker, lead: list[TrackInput], backward: _Follower) -> Iterator[Tracked]:
    """Frames before the first keyframe, backward only."""
    done: list[Tracked] = []
    for item in reversed(lead):
        step = backward.step(tracker.cut(item.views, backward.predict()))
        done.append(tracker.result(item.frame, step.pose, step.hessian, step.seen))
    yield from reversed(done)


def collect(results: Iterable[Tracked], keyframes: Sequence[Keyframe]) -> Motion:
    """Gather what `track` yields."""
    tracked = list(results)
    return Motion(
        root_position_m=np.array([t.pose.root_position_m for t in tracked]).reshape(-1, 3),
        rotations=np.array([t.pose.rotations for t in tracked]).reshape(-1, len(SEGMENTS), 4),
        joints_m=np.array([t.joints_m for t in tracked]).reshape(-1, len(SEGMENTS), 3),
        sigma_m=np.array([t.sigma_m for t in tracked]).reshape(-1, len(SEGMENTS)),
        keyframes=np.array(sorted({k.frame for k in keyframes} & {t.frame for t in tracked}), np.int64),
        valid=np.array([t.valid for t in tracked], bool),
    )
