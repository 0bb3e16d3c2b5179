"""Differential articulated tracking between keyframes, the drift removed (section 5; Yamamoto 2005).

From each keyframe the body is followed forward in time to the next one, and from there backward to this one. Each step
predicts the pose with the velocity so far and improves it on what the images say: the brightness of every visible
point of the skin against its slowly adapting appearance, and the body's contour against the silhouette
(`pzcap.following`). A forward pass drifts away from its keyframe as a backward pass does from the other; merging them
limb by limb by their confidence removes the drift (`pzcap.merging`). What is merged is then improved as a whole, after
the body itself has been corrected from it (`pzcap.polishing`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from pzcap.body import DOF, DOF_SEGMENT, Body, difference, forward, joint_jacobians
from pzcap.evidence import Appearance, Evidence
from pzcap.following import Follower, Step, TrackingConfig, improve
from pzcap.foreground import Expected
from pzcap.keypoints import NOBODY
from pzcap.landmarks import LandmarkEstimate
from pzcap.merging import leaping, merge
from pzcap.polishing import Polished, hear, hear_hand, polish
from pzcap.shape import ShapeEstimate
from pzcap.types import SEGMENTS, Array, Camera, Image, Keyframe, Mask, Motion, Pose, PzcapError, Silhouette
from pzcap.views import Cut, cut_out, expect

_SOME: Final = 4
"""Of so many frames one corrects the body: its neighbours say the same."""

__all__ = ["TrackInput", "Tracked", "Tracker", "TrackingConfig", "View", "collect", "track"]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One camera's part of an instant."""

    image: Image  # (H, W, 3)
    camera: Camera
    silhouette: Silhouette
    people: Array = field(default_factory=lambda: NOBODY)  # (P, 26, 3) a detector's, as in `pzcap.keypoints`


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


@dataclass(slots=True, eq=False)
class _Instant:
    """A frame between two keyframes, waiting for the backward pass."""

    frame: int
    cuts: list[Cut | None]
    step: Step


class Tracker:
    """Tracks while the footage comes in: `push` instants in the order of their frames, then `finish`.

    Results come an interval between keyframes late, since each interval is tracked from both ends; cut-outs of one
    interval are all that is kept. Before the first keyframe the body is tracked backward only, after the last one
    forward only, and so is what lies further before a keyframe than ``longest_stretch``. Raises PzcapError when there
    is no keyframe.
    """

    def __init__(self, body: Body, keyframes: Sequence[Keyframe], config: TrackingConfig) -> None:
        if not keyframes:
            raise PzcapError("tracking: no keyframes; pose the body in at least one frame (keyframes.json)")
        self.body, self.config = body, config
        self._keys = {key.frame: key.pose for key in keyframes}
        self._last_key = max(self._keys)
        self._shape = ShapeEstimate(body)
        self._shape_variance: Array = np.full(len(SEGMENTS), 2 * body.sigma_m**2)  # (16,) until the images have told
        self._landmarks = LandmarkEstimate(body.landmarks)
        self._ahead: Follower | None = None
        self._anchor: Pose  # before what waits
        self._lead: list[TrackInput] = []  # before the first keyframe
        self._waiting: list[_Instant] = []  # since the latest one
        self._hand = np.diag(1.0 / config.hand_sigma**2)

    def expect(self, frame: int, camera: Camera) -> Expected | None:
        """Where the body is expected in a view of the next ``frame``, for whoever cuts its silhouette. None before the
        first keyframe, and where the camera does not see it."""
        pose = self._keys.get(frame) or (None if self._ahead is None else self._ahead.predict())
        return None if pose is None else expect(self.body, pose, camera, self.config.cut_out_margin)

    def push(self, item: TrackInput) -> list[Tracked]:
        """Take in one instant; what is finished by it, in order."""
        if item.frame in self._keys:
            return self._reach_keyframe(item, self._keys[item.frame])
        if self._ahead is None:
            self._lead.append(item)
            if len(self._lead) <= self.config.longest_lead:
                return []
            old = self._lead.pop(0)
            return [self._result(old.frame, next(iter(self._keys.values())), np.zeros((DOF, DOF)), False)]
        cuts = self._cut(item.views, self._ahead.predict())
        step = self._ahead.step(cuts)
        if item.frame > self._last_key:
            return [self._result(item.frame, step.pose, step.hessian, step.seen)]
        self._waiting.append(_Instant(item.frame, cuts, step))
        return self._close(None) if len(self._waiting) >= self.config.longest_stretch else []

    def finish(self) -> list[Tracked]:
        """The footage has ended: what waited for a keyframe that did not come."""
        rest = [self._result(i.frame, i.step.pose, i.step.hessian, i.step.seen) for i in self._waiting]
        rest += [
            self._result(i.frame, next(iter(self._keys.values())), np.zeros((DOF, DOF)), False) for i in self._lead
        ]
        self._waiting, self._lead = [], []
        return rest

    def _reach_keyframe(self, item: TrackInput, pose: Pose) -> list[Tracked]:
        cuts = self._cut(item.views, pose)
        anchor = self._settle(pose, cuts)
        velocity = np.zeros(DOF) if self._ahead is None else _carried(self._ahead, cuts, anchor.pose)
        if anchor.seen:
            if self.config.shape_weight:
                key = Keyframe(item.frame, pose)
                said = hear_hand(self.body, self._shape, anchor.pose, key, self._hand, cuts, self.config)
                self._shape.keep(said)
            self._learn_landmarks(anchor.pose, cuts)
        done = self._close(Follower(self.body, self.config, anchor.pose, -velocity, cuts))
        if done:
            anchor = self._settle(pose, cuts)  # the body has been corrected
        self._ahead = Follower(self.body, self.config, anchor.pose, velocity, cuts)
        self._anchor = anchor.pose
        early = Follower(self.body, self.config, anchor.pose, -velocity, cuts)
        for lead in reversed(self._lead):
            step = early.step(self._cut(lead.views, early.predict()))
            done.insert(0, self._result(lead.frame, step.pose, step.hessian, step.seen))
        self._lead = []
        return [*done, self._result(item.frame, anchor.pose, anchor.hessian, True)]

    def _close(self, back: Follower | None) -> list[Tracked]:
        """The frames that wait, with a pass ``back`` from the keyframe after them, or without."""
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return []
        views, steps = [instant.cuts for instant in waiting], [instant.step for instant in waiting]
        after = None if back is None else back.pose
        if back is None or after is None:
            poses, doubt = [step.pose for step in steps], np.zeros((len(steps), len(SEGMENTS)))
            doubtful = doubt > 0.0
        else:
            behind = [back.step(cuts) for cuts in reversed(views)][::-1]
            poses, doubt = merge(self.body, self._anchor, steps, behind, after)
            doubtful = leaping(self.body, self._anchor, poses, after, doubt)
        polished = self._polish(poses, views, after, doubtful)
        self._anchor = polished.poses[-1]
        return [
            self._result(instant.frame, polished.poses[t], polished.hessians[t], instant.step.seen, doubt[t])
            for t, instant in enumerate(waiting)
        ]

    def _polish(self, poses: list[Pose], views: list[list[Cut | None]], after: Pose | None, doubtful: Mask) -> Polished:
        """Improve the poses of a stretch, and the body with them."""
        if not self.config.shape_weight:
            return polish(self.body, poses, views, self._anchor, after, doubtful, self.config)
        for _ in range(self.config.shape_rounds):
            said = hear(self.body, self._shape, poses[::_SOME], views[::_SOME], self.config)
            self.body = replace(self._shape.solve(said), landmarks=self.body.landmarks)
            polished = polish(self.body, poses, views, self._anchor, after, doubtful, self.config)
            poses = polished.poses
        self._shape.keep(said)
        self._shape_variance = self._shape.joint_variance()
        return polished

    def _cut(self, views: Sequence[View | None], pose: Pose) -> list[Cut | None]:
        config = self.config
        return [
            None
            if view is None or not view.silhouette.valid
            else cut_out(self.body, view.image, view.silhouette, view.camera, pose, config.cut_out_margin, view.people)
            for view in views
        ]

    def _learn_landmarks(self, pose: Pose, cuts: Sequence[Cut | None]) -> None:
        """Find out where the detector's keypoints lie, from a frame in which a hand has posed the body."""
        frames = forward(self.body, pose)
        for cut in cuts:
            if cut is not None and cut.person is not None:
                self._landmarks.add(frames, cut.seen.camera, cut.person)
        self.body = replace(self.body, landmarks=self._landmarks.solve())

    def _settle(self, pose: Pose, cuts: list[Cut | None]) -> Step:
        """A keyframe's pose, improved by the images with the hand's error as prior."""
        unseen: list[Appearance | None] = [None] * len(cuts)
        if all(cut is None for cut in cuts):
            return Step(pose, np.zeros(DOF), self._hand, np.zeros(len(SEGMENTS)), np.zeros((4, 2)), False)
        evidence = Evidence(self.body, cuts)
        pose, normal = improve(evidence, pose, self._hand, unseen, self.config, self.config.schedule)
        return Step(pose, np.zeros(DOF), normal.hessian + self._hand, np.zeros(len(SEGMENTS)), np.zeros((4, 2)), True)

    def _result(self, frame: int, pose: Pose, hessian: Array, valid: bool, doubt_m: Array | float = 0.0) -> Tracked:
        """``doubt_m`` (16,): how far apart two estimates of a joint are that do not agree."""
        frames = forward(self.body, pose)
        sigma = np.full(DOF, self.config.prediction_rotation_sigma_rad)
        sigma[:3] = self.config.prediction_position_sigma_m
        covariance = np.linalg.inv(hessian + np.diag(1.0 / sigma**2))
        jacobians = joint_jacobians(frames)
        variance = np.einsum("jad,de,jae->j", jacobians, covariance, jacobians)
        variance += self._shape_variance + (0.5 * np.asarray(doubt_m)) ** 2
        return Tracked(frame, pose, frames[:, :3, 3], np.sqrt(variance), valid)


def track(
    body: Body, keyframes: Sequence[Keyframe], inputs: Iterable[TrackInput], config: TrackingConfig
) -> Iterator[Tracked]:
    """Track the body through ``inputs``, in the order of their frames: a result each, in that order. See `Tracker`."""
    tracker = Tracker(body, keyframes, config)
    for item in inputs:
        yield from tracker.push(item)
    yield from tracker.finish()


def _carried(arriving: Follower, cuts: Sequence[Cut | None], pose: Pose) -> Array:
    """The velocity with which the forward pass arrives, of those joints that arrive where the keyframe has them."""
    arrived = arriving.step(cuts)
    off = np.abs(difference(pose, arrived.pose))
    limit = np.full(DOF, 0.5)
    limit[:3] = 0.1
    lost = np.zeros(len(SEGMENTS), bool)
    lost[DOF_SEGMENT[off > limit]] = True
    return np.where(lost[DOF_SEGMENT], 0.0, arrived.velocity)


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
