"""Differential articulated tracking between keyframes, the drift removed (section 5; Yamamoto 2005).

From each keyframe the body is followed forward in time to the next one. Each step predicts the pose with the velocity
so far and improves it on what the images say: the brightness of every visible point of the skin against its slowly
adapting appearance, and the body's contour against the silhouette (`pzcap.tracking.frame_tracker`). A forward pass
drifts away from its keyframe, so what lies between two of them is then solved from both
(`pzcap.tracking.interval_solver`), in a process of its own: the next forward pass goes on meanwhile, with the body as
the interval before the last has left it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

import numpy as np

from pzcap import runtime
from pzcap.body.skeleton import DOF, DOF_SEGMENT, Body, difference
from pzcap.io.detections import NOBODY
from pzcap.limbs.skin_colour_model import SkinColourModel
from pzcap.segmentation.foreground import Expected
from pzcap.tracking.camera_refinement import CameraPrior
from pzcap.tracking.frame_tracker import UNSEEN, Follower, TrackingConfig
from pzcap.tracking.interval_solver import Anchor, Instant, IntervalSolver, Tracked, nothing, solved
from pzcap.tracking.observation import Cut, PlacedView, cut_out, expect
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.types import SEGMENTS, Array, Camera, Image, Keyframe, Motion, Pose, PzcapError, Silhouette

__all__ = ["TrackInput", "Tracked", "Tracker", "TrackingConfig", "View", "collect", "track"]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One camera's part of an instant."""

    image: Image  # (H, W, 3)
    camera: Camera
    silhouette: Silhouette
    people: Array = field(default_factory=lambda: NOBODY)  # (P, 26, 3) a detector's, as in `pzcap.io.detections`
    aim: CameraPrior | None = None  # how well the background tells the camera; None: it is not to be corrected


@dataclass(frozen=True, slots=True, eq=False)
class TrackInput:
    """One instant. A view that was dropped, or whose camera is not known, is None."""

    frame: int
    views: tuple[View | None, ...]  # one a camera


class Tracker:
    """Tracks while the footage comes in: `push` instants in the order of their frames, then `finish`.

    Each interval between keyframes is tracked from both ends, and its frames come when the one after it has been
    followed; cut-outs of two intervals are all that is kept. Before the first keyframe the body is tracked backward
    only, after the last one forward only, and so is what lies further before a keyframe than ``longest_stretch``.
    Raises PzcapError when there is no keyframe.
    """

    def __init__(self, body: Body, keyframes: Sequence[Keyframe], frame_rate: float, config: TrackingConfig) -> None:
        if not keyframes:
            raise PzcapError("tracking: no keyframes; pose the body in at least one frame (keyframes.json)")
        self.body, self.config = body, config
        self._keys = {key.frame: key for key in keyframes}
        self._last_key = max(self._keys)
        self._solver = IntervalSolver(body, frame_rate, config)
        self._solving: Future[tuple[IntervalSolver, list[Tracked]]] | None = None
        self._ahead: Follower | None = None
        self._complexion = SkinColourModel()
        self._lead: list[TrackInput] = []  # before the first keyframe
        self._waiting: list[Instant] = []  # since the latest one

    def make_ready(self) -> None:
        """Have the process that solves intervals started by the time that it is needed: that takes it seconds."""
        runtime.submit(nothing)

    def expect(self, frame: int, camera: Camera) -> Expected | None:
        """Where the body is expected in a view of the next ``frame``, for whoever cuts its silhouette. None before the
        first keyframe, and where the camera does not see it."""
        if frame in self._keys:
            pose, sigma_m = self._keys[frame].pose, 2.0 * self.config.keyframe_position_sigma_m
        elif self._ahead is not None:
            pose, sigma_m = self._ahead.predict(), self._ahead.surprise_m
        else:
            return None
        return expect(self.body, pose, sigma_m, camera, self.config.cut_out_margin)

    def push(self, item: TrackInput) -> list[Tracked]:
        """Take in one instant; what is finished by it, in order."""
        if item.frame in self._keys:
            return self._reach_keyframe(item, self._keys[item.frame])
        if self._ahead is None:
            self._lead.append(item)
            return [] if len(self._lead) <= self.config.longest_lead else [self._unknown(self._lead.pop(0))]
        cuts = self._cut(item.views, self._ahead.predict())
        step = self._ahead.step(cuts)
        if item.frame > self._last_key:
            return [*self._solved(), self._solver.result(item.frame, step.pose, step.hessian, step.contour, step.seen)]
        self._waiting.append(Instant(item.frame, cuts, step))
        if len(self._waiting) < self.config.longest_stretch:
            return []
        done = self._solved()
        self._solve(None)
        return done

    def finish(self) -> list[Tracked]:
        """The footage has ended: what waited for a keyframe that did not come."""
        done = self._solved()
        done += [
            self._solver.result(i.frame, i.step.pose, i.step.hessian, i.step.contour, i.step.seen)
            for i in self._waiting
        ]
        done += [self._unknown(item) for item in self._lead]
        self._waiting, self._lead = [], []
        return done

    def motion(self, tracked: Iterable[Tracked]) -> Motion:
        """All that was ``tracked``, with the body as it is known when that has come to its end."""
        return collect(self._solver.refit_shape(tracked), list(self._keys.values()))

    def _reach_keyframe(self, item: TrackInput, key: Keyframe) -> list[Tracked]:
        done = self._solved()
        cuts = self._cut(item.views, key.pose)
        settled = self._solver.settle(key.pose, cuts)
        self._look_at_arms(item.views, PoseObjective(self.body, cuts).visibility(settled.pose))
        velocity = np.zeros(DOF) if self._ahead is None else _carried(self._ahead, cuts, settled.pose)
        anchor = Anchor(key, cuts, settled, velocity)
        if self._ahead is None:
            arrived = self._solver.begin(anchor)
            done += [*self._led(anchor), arrived]
        else:
            self._solve(anchor)
        self._ahead = Follower(self.body, self.config, settled.pose, velocity, cuts)
        return done

    def _look_at_arms(self, views: Sequence[View | None], placed: Sequence[PlacedView | None]) -> None:
        """Learn their colours where the body was ``placed``."""
        segment = self.body.surface.segment
        for view, where in zip(views, placed, strict=True):
            if view is not None and where is not None:
                self._complexion.learn(view.image, segment, where.skin.pixels, where.facing)

    def _solve(self, anchor: Anchor | None) -> None:
        """Start to solve what waits, up to ``anchor``. What was being solved has been taken before."""
        assert self._ahead is not None
        interval, self._waiting = self._waiting, []
        self._solving = runtime.submit(solved, self._solver, interval, self._ahead.known, anchor)

    def _solved(self) -> list[Tracked]:
        """The interval that is being solved, once it is; from then on its body is followed."""
        if self._solving is None:
            return []
        self._solver, done = runtime.taken(self._solving)
        self._solving = None
        self.body = self._solver.body
        return done

    def _led(self, anchor: Anchor) -> list[Tracked]:
        """The frames before the first keyframe."""
        early = Follower(self.body, self.config, anchor.settled.pose, np.zeros(DOF), anchor.cuts)
        done: list[Tracked] = []
        for item in reversed(self._lead):
            step = early.step(self._cut(item.views, early.predict()))
            done.insert(0, self._solver.result(item.frame, step.pose, step.hessian, step.contour, step.seen))
        self._lead = []
        return done

    def _unknown(self, item: TrackInput) -> Tracked:
        """A frame too far from any keyframe."""
        return self._solver.result(item.frame, self._keys[min(self._keys)].pose, np.zeros((DOF, DOF)), UNSEEN, False)

    def _cut(self, views: Sequence[View | None], pose: Pose) -> list[Cut | None]:
        margin = self.config.cut_out_margin

        def cut(view: View) -> Cut | None:
            image, silhouette, camera = view.image, view.silhouette, view.camera
            return cut_out(self.body, image, silhouette, camera, pose, margin, self._complexion, view.people, view.aim)

        return [None if view is None or not view.silhouette.valid else cut(view) for view in views]


def track(
    body: Body, keyframes: Sequence[Keyframe], inputs: Iterable[TrackInput], frame_rate: float, config: TrackingConfig
) -> Iterator[Tracked]:
    """Track the body through ``inputs``, in the order of their frames: a result each, in that order. See `Tracker`."""
    tracker = Tracker(body, keyframes, frame_rate, config)
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
