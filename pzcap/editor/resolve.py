"""A pose fitted to its frame, and an interval between keyframes tracked anew: by the tracker, with the cameras as they
were found; and what has changed by it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pzcap import pipeline
from pzcap.body.skeleton import Body
from pzcap.camera_set import calibrated_of
from pzcap.editor.footage import Footage
from pzcap.editor.tuning import RESOLVE
from pzcap.events import BodyTracked, FrameLocalised, Progress
from pzcap.io.capture import FrameSets
from pzcap.runtime import one_thread_each
from pzcap.tracking.frame_tracker import fit_pose
from pzcap.tracking.observation import crop_view
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_colour_model import SkinColourModel
from pzcap.tracking.tracker import Tracked, Tracker
from pzcap.types import Array, FrameSet, Keyframe, Motion, Pose, PzcapError
from pzcap.views import Expecting, segment_views


def fitted_to_images(footage: Footage, body: Body, frame: int, pose: Pose, known: Array) -> Pose:
    """The ``pose`` of a frame fitted to the silhouettes of its views, what is ``known`` of it without them (43, 43
    information) counted beside them. PzcapError where no view shows the athlete."""
    config = pipeline.Config().tracking
    with one_thread_each():
        views = [
            None if view is None else crop_view(body, view, pose, config.cut_out_margin, SkinColourModel())
            for view in footage.views(frame, body, pose)
        ]
        if not any(view is not None and (view.probability > 127).any() for view in views):
            raise PzcapError("no view of this frame shows the athlete before the hall")
        objective = PoseObjective(body, views)
        fit = fit_pose(objective, pose, known, [None] * len(views), config, config.schedule[1:])
        return fit.posed.pose


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """Frames that were tracked anew, against what they were before."""

    frames: range
    moved_m: Array  # (N, 16) by which each joint has moved; 0 where there was no motion before
    before: Motion  # of all frames

    @property
    def known_before(self) -> bool:
        """True if these frames had been tracked before."""
        return bool(self.before.valid[self.frames].any())


def interval(keys: Sequence[int], frame: int, count: int, reach: int) -> range:
    """The frames from the keyframe before ``frame`` to the one after it, or so far as they can be tracked from the one
    that there is; ``reach`` frames at most to the side where there is none. PzcapError without any keyframe near."""
    before = [key for key in keys if key <= frame]
    after = [key for key in keys if key > frame]
    if not before and not after:
        raise PzcapError("no keyframe to track from; pose the body first")
    first = before[-1] if before else max(frame - reach, 0)
    last = after[0] if after else min(frame + reach, count - 1)
    if frame in keys and len(before) > 1:  # the keyframe itself is new: what leads to it changes, too
        first = before[-2]
    elif frame in keys and len(before) == 1:
        first = max(frame - reach, 0)
    return range(first, last + 1)


def ends(motion: Motion, keys: Sequence[int], frame: int) -> list[int]:
    """Frames of a ``motion`` in which its interval around ``frame`` can end though no hand has set them: on each side
    the surest one 15 to 45 frames away, unless one of the ``keys`` is as near."""
    found = []
    for way in (-1, 1):
        if any(0 < way * (key - frame) <= RESOLVE.end_to for key in keys):
            continue
        near = [frame + way * far for far in range(RESOLVE.end_from, RESOLVE.end_to + 1)]
        near = [number for number in near if 0 <= number < len(motion.valid) and motion.valid[number]]
        if near:
            found.append(min(near, key=lambda number: float(motion.sigma_m[number].max())))
    return found


def tracked_anew(
    footage: Footage, body: Body, keyframes: Sequence[Keyframe], frames: range, settings: TrackingConfig,
    report: Callable[[int, int], None], cancelled: Callable[[], bool],
) -> Motion:  # fmt: skip
    """The motion of ``frames``, tracked from the ``keyframes`` among them. PzcapError where there are none, or it was
    ``cancelled``."""
    config, calibrated = pipeline.Config(), calibrated_of(footage.found)
    own = [key for key in keyframes if key.frame in frames]
    by_fields = footage.sets.interlaced and settings.second_fields
    tracker = Tracker(body, own, replace(settings, longest_lead=len(frames)), by_fields)

    def localise(views: FrameSet, _: Expecting | None) -> FrameLocalised:
        return footage.located(views)

    poses: list[Tracked] = []
    with one_thread_each(), ThreadPoolExecutor(config.threads) as pool:
        segment = partial(segment_views, calibrated, config.foreground, config.panzoom, pool)
        for event in pipeline.follow(_Some(footage.sets, frames), localise, segment, tracker):
            match event:
                case BodyTracked(tracked):
                    poses += tracked
                case Progress():
                    report(event.done - frames.start, len(frames))
            if cancelled():
                raise PzcapError("stopped")
        return tracker.motion(poses)


def merged(old: Motion, new: Motion, frames: range, keys: Sequence[int]) -> tuple[Motion, Difference]:
    """The ``old`` motion of all frames with some of them as they are in the ``new`` one."""
    arrays = {
        name: getattr(old, name).copy() for name in ("root_position_m", "rotations", "joints_m", "sigma_m", "valid")
    }
    for name, array in arrays.items():
        array[frames] = getattr(new, name)
    moved = np.linalg.norm(new.joints_m - old.joints_m[frames], axis=2)
    moved[~(old.valid[frames] & new.valid)] = 0.0
    tracked = sorted({*old.keyframes.tolist(), *(key for key in keys if key in frames)} & set(keys))
    motion = Motion(**arrays, keyframes=np.array(tracked, np.int64), body=new.body)
    return motion, Difference(frames, moved, old)


def untracked(count: int) -> Motion:
    """A motion of so many frames in none of which the body is known."""
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (count, 16, 1))
    nowhere = np.zeros((count, 16, 3))
    return Motion(
        np.zeros((count, 3)), rotations, nowhere, np.zeros((count, 16)), np.zeros(0, np.int64), np.zeros(count, bool)
    )


class _Some(FrameSets):
    """Some of the frame sets of a capture, under their own indices."""

    def __init__(self, sets: FrameSets, frames: range) -> None:
        self._sets, self._frames = sets, frames
        self.timecodes, self.keyframes, self.interlaced = sets.timecodes, sets.keyframes, sets.interlaced

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[FrameSet]:
        return self._sets.between(self._frames.start, self._frames.stop)
