"""Cameras that other programs write an instant at a time, as tracks."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pzcap.scoring.records import CameraPoses, CameraTrack
from pzcap.types import Array, PzcapError


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """One camera at one frame, in the conventions of `pzcap.types`."""

    rotation: Array  # (3, 3) camera to world
    position_m: Array  # (3,)
    focal_px: float
    principal_px: Array  # (2,)
    distortion: Array  # (4,)


def view_of(name: str, cameras: Sequence[str], where: str) -> tuple[str, int]:
    """Camera and frame that an image's name says: CAMERA/FRAME.png or CAMERA_FRAME.png, the frame its last number."""
    stem = re.sub(r"\.\w+$", "", name)
    numbers = re.findall(r"\d+", stem.replace("\\", "/").rpartition("/")[2])
    camera = re.sub(r"[/\\_-]*[A-Za-z_-]*\d+$", "", stem)
    if camera not in cameras or not numbers:
        raise PzcapError(f"{where}: '{name}' names no camera and frame; call it {cameras[0]}/000012.png")
    return camera, int(numbers[-1])


def tracks(
    found: Mapping[tuple[str, int], Instant], names: Sequence[str], frames: int, path: Path
) -> tuple[CameraTrack | None, ...]:
    """The tracks of the cameras ``names``, None for one of which nothing was found."""
    last = max((frame for _, frame in found), default=-1)
    if last >= frames:
        hint = "count them from 0, not from 1" if last == frames else "number them as the capture does, from 0"
        raise PzcapError(f"{path}: frame {last} of {frames}; {hint}")
    known = {name for name, _ in found}
    return tuple(
        track({f: one for (n, f), one in found.items() if n == name}, frames) if name in known else None
        for name in names
    )


def track(instants: Mapping[int, Instant], frames: int) -> CameraTrack:
    """The track, so many ``frames`` long, of a camera that is known at some of them."""
    valid, focal = np.zeros(frames, bool), np.ones(frames)
    poses = CameraPoses(
        np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 3)), np.zeros((frames, 2)), np.zeros((frames, 4))
    )
    for frame, one in instants.items():
        valid[frame], focal[frame] = True, one.focal_px
        poses.rotation[frame], poses.position_m[frame] = one.rotation, one.position_m
        poses.principal_px[frame], poses.distortion[frame] = one.principal_px, one.distortion
    return CameraTrack(valid, focal, None, None, poses)
