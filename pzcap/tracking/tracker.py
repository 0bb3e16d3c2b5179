"""Differential articulated tracking between keyframes, the drift removed (section 5; Yamamoto 2005).

From each keyframe the body is tracked forward in time to the next one. Each step predicts the pose with the velocity
so far and fits it to the images: the brightness of every visible point of the skin against its slowly adapting
appearance, and the body's contour against the silhouette (`pzcap.tracking.frame_tracker`). A forward pass drifts away
from its keyframe, so what lies between two of them is then solved from both (`pzcap.tracking.interval_solver`), in a
process of its own: the next forward pass goes on meanwhile, with the body as the interval before the last has left it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np

from pzcap import runtime
from pzcap.body.kinematics import difference
from pzcap.body.skeleton import DOF_SEGMENT, Body, moved
from pzcap.segmentation.expected import Expected
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.body_size import body_size, resized, seen_sizes
from pzcap.tracking.frame_tracker import NO_CONTOUR, FrameTracker, PoseEstimate
from pzcap.tracking.interval import Anchor, Instant, IntervalProblem, IntervalResult, Tracked
from pzcap.tracking.interval_solver import fit_keyframe, solved
from pzcap.tracking.keyframes import joint_sigma_m
from pzcap.tracking.observation import ViewCrop, ViewInput, anywhere, crop_view, expect
from pzcap.tracking.pixel_time import AT_REST, ClockEstimate
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.shape_refit import refit_shape
from pzcap.tracking.skin_colour_model import SkinColourModel
from pzcap.tracking.tracked_body import tracked
from pzcap.tracking.tuning import FRAME
from pzcap.types import DOF, SEGMENTS, Array, Camera, Keyframe, Motion, Pose, PzcapError

__all__ = ["TrackInput", "Tracked", "Tracker", "ViewInput", "collect"]


@dataclass(frozen=True, slots=True, eq=False)
class TrackInput:
    """One instant. A view that was dropped, or whose camera is not known, is None."""

    frame: int
    views: tuple[ViewInput | None, ...]  # one a camera
    second_field: bool = False  # half a frame period after the frame


class Tracker:
    """Tracks while the footage comes in: `push` instants in the order of their frames, then `finish`.

    Each interval between keyframes is tracked from both ends, and its frames come when the one after it has been
    tracked forward; cut-outs of two intervals are all that is kept. Before the first keyframe the body is tracked
    backward only, after the last one forward only, and so is what lies further before a keyframe than
    ``longest_stretch``. ``by_fields``: each frame is followed by its second field, which is tracked as well, halfway to
    the next. Raises PzcapError when there is no keyframe.
    """

    def __init__(
        self, body: Body, keyframes: Sequence[Keyframe], config: TrackingConfig, by_fields: bool = False
    ) -> None:
        if not keyframes:
            raise PzcapError("tracking: no keyframes; pose the body in at least one frame (keyframes.json)")
        if not config.drape:
            body = replace(body, loose_m=np.zeros(len(SEGMENTS)))
        self.body, self.config = body, config  # the body that is tracked with
        self.by_fields = by_fields
        self._period = 0.5 if by_fields else 1.0  # frame periods from an instant to the next
        self._keys = {key.frame: key for key in keyframes}
        self._last_key = max(self._keys)
        self._estimate = BodyEstimate.of(self.body)
        self.clocks: ClockEstimate | None = None  # None: before the first instant
        self._before: Sequence[Pose] = ()  # the last frames before those that wait
        self._solving: Future[IntervalResult] | None = None
        self._ahead: FrameTracker | None = None
        self._reached: Keyframe | None = None
        self._skin_colours = SkinColourModel()
        self._lead: list[TrackInput] = []  # before the first keyframe
        self._waiting: list[Instant] = []  # since the latest one

    def expect(self, frame: int, camera: Camera) -> Expected | None:
        """Prior of the silhouette in a view of the next ``frame``. None before the first keyframe, and where the camera
        does not see the body."""
        key = self._keys.get(frame)
        if key is not None and key is not self._reached:
            pose, sigma_m = key.pose, 2.0 * joint_sigma_m(key, self.body)
        elif self._ahead is not None and self._ahead.astray:
            return anywhere(self.body, self._ahead.predict(), camera, FRAME.lost_margin)
        elif self._ahead is not None:
            pose, sigma_m = self._ahead.predict(), self._ahead.prediction_error_m
        else:
            return None
        return expect(self.body, pose, sigma_m, camera, self.config.cut_out_margin)

    def push(self, item: TrackInput) -> list[Tracked]:
        """Take in one instant; the frames that are finished by it, in order."""
        if item.frame in self._keys and not item.second_field:
            return self._reach_keyframe(item, self._keys[item.frame])
        if self._ahead is None:
            self._lead.append(item)
            too_long = len(self._lead) * self._period > self.config.longest_lead
            return self._unknown(self._lead.pop(0)) if too_long else []
        views = self._crop(item.views, self._ahead.predict(), self._ahead.astray)
        step = self._ahead.step(views)
        if item.frame > self._last_key:
            return [*self._solved(), *self._tracked(item, step)]
        self._waiting.append(Instant(item.frame, views, step, item.second_field))
        if len(self._waiting) * self._period < self.config.longest_stretch:
            return []
        done = self._solved()
        self._solve(None)
        return done

    def finish(self) -> list[Tracked]:
        """The frames that waited for a keyframe that did not come: the footage has ended."""
        done = self._solved()
        for instant in self._waiting:
            done += self._tracked(instant, instant.forward)
        for item in self._lead:
            done += self._unknown(item)
        self._waiting, self._lead = [], []
        return done

    def motion(self, results: Iterable[Tracked]) -> Motion:
        """Gather all ``results``, with the body as it is known when they have come to their end."""
        found = refit_shape(self._estimate, results) if self.config.shape_refit else results
        return collect(found, list(self._keys.values()), self._estimate.body)

    def _tracked(self, at: TrackInput | Instant, found: PoseEstimate) -> list[Tracked]:
        """The frame as it was ``found``; nothing of a second field, which only serves the tracking."""
        return [] if at.second_field else [tracked(self._estimate, at.frame, found)]

    def _reach_keyframe(self, item: TrackInput, key: Keyframe) -> list[Tracked]:
        self._reached, done = key, self._solved()
        if self._ahead is None and self.config.body_size:
            self._correct_size(item, key)
        views = self._crop(item.views, key.pose)
        rates = AT_REST if self._ahead is None else self._ahead.rates(key.pose)
        fit, _ = fit_keyframe(self._estimate.body, key, views, rates, self.config)
        if self.config.skin_colours:
            for view, where in zip(item.views, PoseObjective(self.body, views, rates).place(fit.pose)[1], strict=True):
                if view is not None and where is not None:
                    self._skin_colours.learn(view.image, self.body.surface.segment, where.skin.pixels, where.facing)
        velocity = np.zeros(DOF) if self._ahead is None else _carried(self._ahead, views, fit.pose)
        anchor = Anchor(key, views, fit, velocity, rates)
        if self._ahead is None:
            first = solved(self._problem([], anchor))
            self._estimate, self._before = first.estimate, first.before
            done += [*self._lead_in(anchor), *first.tracked]
        else:
            self._solve(anchor)
        self._ahead = FrameTracker(self.body, self.config, fit.pose, velocity, views, self._period)
        return done

    def _correct_size(self, item: TrackInput, key: Keyframe) -> None:
        """Correct the size of the whole body before anything is tracked with it."""
        cameras = [None if view is None else view.camera for view in item.views]
        silhouettes = [None if view is None else view.silhouette for view in item.views]
        margin = self.config.cut_out_margin
        size = body_size(self.body, seen_sizes(self.body, key.pose, cameras, silhouettes, margin))
        if size is not None:
            self.body = resized(self.body, size)
            self._estimate = BodyEstimate.of(self.body)

    def _problem(self, instants: Sequence[Instant], anchor: Anchor | None) -> IntervalProblem:
        reference = () if self._ahead is None else self._ahead.reference
        return IntervalProblem(
            self._estimate, self._clocks(), self._before, instants, reference, anchor, self.config, self._period
        )

    def _clocks(self) -> ClockEstimate:
        assert self.clocks is not None, "there has been an instant"
        return self.clocks.after((len(self._waiting) + 1) * self._period)

    def _solve(self, anchor: Anchor | None) -> None:
        """Start to solve what waits, up to ``anchor``. What was being solved has been taken before."""
        instants, self._waiting = self._waiting, []
        self._solving = runtime.submit(solved, self._problem(instants, anchor))

    def _solved(self) -> list[Tracked]:
        """The interval that is being solved, once it is; from then on its body is tracked with."""
        if self._solving is None:
            return []
        result, self._solving = runtime.taken(self._solving), None
        self._estimate, self._before, self.body = result.estimate, result.before, result.estimate.body
        self.clocks = result.clocks
        return result.tracked

    def _lead_in(self, anchor: Anchor) -> list[Tracked]:
        """The frames before the first keyframe, tracked backward from it."""
        back = FrameTracker(self.body, self.config, anchor.fit.pose, np.zeros(DOF), anchor.views, -self._period)
        done: list[Tracked] = []
        for item in reversed(self._lead):
            done = [*self._tracked(item, back.step(self._crop(item.views, back.predict()))), *done]
        self._lead = []
        return done

    def _unknown(self, item: TrackInput) -> list[Tracked]:
        """A frame too far from any keyframe."""
        nowhere = PoseEstimate(self._keys[min(self._keys)].pose, np.zeros((DOF, DOF)), NO_CONTOUR, False)
        return self._tracked(item, nowhere)

    def _crop(self, views: Sequence[ViewInput | None], pose: Pose, astray: bool = False) -> list[ViewCrop | None]:
        if self.clocks is None:
            self.clocks = ClockEstimate.of(len(views), self.config.clock_sigma)
        clocks = self.clocks.clock.tolist()

        def crop(view: ViewInput, clock: float) -> ViewCrop | None:
            view = replace(view, exposure=view.exposure._replace(clock=clock))
            if not self.config.camera_refinement:
                view = replace(view, camera_prior=None)
            margin = FRAME.lost_margin if astray else self.config.cut_out_margin
            return crop_view(self.body, view, pose, margin, self._skin_colours, astray)

        return [
            None if view is None or not view.silhouette.valid else crop(view, clock)
            for view, clock in zip(views, clocks, strict=True)
        ]


def _carried(arriving: FrameTracker, views: Sequence[ViewCrop | None], pose: Pose) -> Array:
    """The velocity (43,) with which the forward pass arrives, of those joints that arrive where the keyframe has
    them."""
    arrived = arriving.step(views)
    off = np.abs(difference(pose, arrived.pose))
    limit = np.full(DOF, 0.5)
    limit[:3] = 0.1
    lost = np.zeros(len(SEGMENTS), bool)
    lost[DOF_SEGMENT[off > limit]] = True
    return np.where(lost[DOF_SEGMENT], 0.0, arrived.velocity)


def collect(results: Iterable[Tracked], keyframes: Sequence[Keyframe], body: Body) -> Motion:
    """Gather the results of `Tracker`, by which ``body`` is moved."""
    found = list(results)
    return Motion(
        root_position_m=np.array([t.pose.root_position_m for t in found]).reshape(-1, 3),
        rotations=np.array([t.pose.rotations for t in found]).reshape(-1, len(SEGMENTS), 4),
        joints_m=np.array([t.joints_m for t in found]).reshape(-1, len(SEGMENTS), 3),
        sigma_m=np.array([t.sigma_m for t in found]).reshape(-1, len(SEGMENTS)),
        keyframes=np.array(sorted({k.frame for k in keyframes if not k.found} & {t.frame for t in found}), np.int64),
        valid=np.array([t.valid for t in found], bool),
        body=moved(body),
    )
