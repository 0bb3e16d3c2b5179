"""Records of the score: what a method says of a capture, and what is true of it. Conventions: `pzcap.types`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, Mask, PzcapError


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One number for each frame set; 0 where ``valid`` is False."""

    values: Array  # (F,)
    valid: Mask  # (F,)

    def __post_init__(self) -> None:
        self.values[~self.valid] = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CameraPoses:
    """Poses and lenses of one camera, a value a frame: all that a projection needs."""

    rotation: Array  # (F, 3, 3) camera axes in the world: camera coordinates to world coordinates
    position_m: Array  # (F, 3) projection centre, world
    principal_px: Array  # (F, 2)
    distortion: Array  # (F, 4) k1, k2, p1, p2


@dataclass(frozen=True, slots=True, eq=False)
class CameraTrack:
    """Answer about one camera, a value a frame. Without ``poses`` there is ``pan_rad``."""

    valid: Mask  # (F,)
    focal_px: Array  # (F,)
    pan_rad: Array | None = None  # (F,) about its pan axis, from the reference pose; None: as its pose has it
    covariance: Array | None = None  # (F, 2, 2) of (pan_rad, log focal)
    poses: CameraPoses | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BodyTrack:
    """Answer about the athlete's joints, `pzcap.types.JOINTS`."""

    joints_m: Array  # (F, 16, 3) world
    valid: Mask  # (F, 16)
    sigma_m: Array | None  # (F, 16) standard deviation of a joint's distance from the truth
    keyframe: Mask  # (F,) posed by hand: not scored
    read_by: str | None = None  # axes by which another program's file was read; None: by ours


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All that a method says of one capture: F frames, C cameras."""

    method: str
    capture: str
    frames: int
    timecodes: tuple[str, ...] | None  # (F,) None: the frames are those of the truth
    image_size: tuple[int, int] | None  # width and height of the images that it was given
    camera_names: tuple[str, ...]  # (C,)
    cameras: tuple[CameraTrack | None, ...]  # (C,)
    body: BodyTrack | None
    own_world: bool = False  # rotations are in a frame of the method's own, one a camera, as of self-calibration


@dataclass(frozen=True, slots=True, eq=False)
class TrueCamera:
    """Truth about one camera while the motion is recorded."""

    track: CameraTrack  # with poses and pan; valid everywhere
    recorded: Mask  # (F,) False where the frame was dropped
    pan_axis: Array  # (3,) unit vector, world, up
    scene_points_m: Array  # (P, 3) points of the static scene that the camera sees as it turns
    pan_bound_rad: Series | None = None  # Cramer-Rao bound of the standard deviation, where it was computed
    focal_bound: Series | None = None  # the same of the focal length, relative


@dataclass(frozen=True, slots=True, eq=False)
class TrueCapture:
    """Truth about one capture: F frames, C cameras, at mid-exposure."""

    name: str
    image_size: tuple[int, int]
    frame_rate: str  # a fraction, such as "30000/1001"
    timecodes: tuple[str, ...]  # (F,)
    camera_names: tuple[str, ...]  # (C,)
    cameras: tuple[TrueCamera, ...]  # (C,)
    joints_m: Array  # (F, 16, 3)
    inverted: Mask  # (F,) head below the pelvis
    airborne: Mask  # (F,) no contact with the floor
    keyframe: Mask  # (F,) the capture gives the pose: not scored, whatever a method says of it


def matched(results: Results, truth: TrueCapture) -> tuple[NDArray[np.int64], Mask]:
    """Index into the truth of each frame of ``results`` (F,), or of the nearest, and which the truth knows (F,).

    Raises PzcapError if the truth is of another capture: it lacks a camera or all timecodes.
    """
    strange = [name for name in results.camera_names if name not in truth.camera_names]
    if strange:
        raise PzcapError(
            f"the truth knows no '{strange[0]}', which the results name as a camera; its cameras are "
            f"{', '.join(truth.camera_names)}"
        )
    if results.timecodes is None:
        if results.frames != len(truth.timecodes):
            raise PzcapError(
                f"{results.frames} frames where the capture has {len(truth.timecodes)}; number them as it does, from 0"
            )
        return np.arange(results.frames), np.ones(results.frames, bool)
    return by_timecode(results.timecodes, truth.timecodes)


def by_timecode(timecodes: Sequence[str], true: Sequence[str]) -> tuple[NDArray[np.int64], Mask]:
    """Index into ``true`` of each of ``timecodes`` (F,), or of the nearest, and which of them are there (F,)."""
    index = {timecode: frame for frame, timecode in enumerate(true)}
    known = np.array([timecode in index for timecode in timecodes], bool)
    if not known.any():
        first_one = timecodes[0] if timecodes else ""
        raise PzcapError(
            f"the truth knows no timecode '{first_one}', nor any other of the results; it is of another capture, or "
            "leave timecodes out where frames are counted as in the capture"
        )
    first = int(np.argmax(known))
    frames = np.arange(len(known)) - first + index[timecodes[first]]
    return np.clip(frames, 0, len(index) - 1), known


def thinned(truth: TrueCapture, every: int) -> TrueCapture:
    """``truth``, of whose cameras only each ``every``-th frame counts, from 0: for tracks that ask for no more."""
    if every < 1:
        raise PzcapError(f"every is {every}; give 1 or more")
    counts = np.arange(len(truth.timecodes)) % every == 0
    return replace(truth, cameras=tuple(replace(camera, recorded=camera.recorded & counts) for camera in truth.cameras))


def within(track: CameraTrack, known: Mask) -> CameraTrack:
    """``track``, valid in the frames ``known`` (F,) alone."""
    return replace(track, valid=track.valid & known)
