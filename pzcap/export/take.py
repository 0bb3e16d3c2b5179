"""The take: what all formats are written from. Cameras of each frame, labelled points, the rig, names of files."""

from __future__ import annotations

import importlib
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pzcap.body.kinematics import chain
from pzcap.geometry.camera import of_track
from pzcap.io.files import write_bytes
from pzcap.types import (
    ENDS,
    JOINTS,
    PARENTS,
    SEGMENTS,
    Array,
    Camera,
    Capture,
    Indices,
    Mask,
    Motion,
    MovedBody,
    PanZoomCamera,
    PanZoomTrack,
    PzcapError,
    Reconstruction,
)

SENSOR_WIDTH_MM = 36.0
"""Width that the sensor is taken to have where a format wants millimetres: footage does not tell. Only its ratio to the
focal length means anything."""


@dataclass(frozen=True, slots=True, eq=False)
class LocatedCamera:
    """A camera whose frames were located."""

    number: int  # of all cameras of the capture, from 0
    name: str
    file: str  # its name as far as it may stand in the name of a file, unlike that of any other camera
    head: PanZoomCamera
    track: PanZoomTrack

    def at(self, frame: int) -> Camera | None:
        """The camera in a frame; None where it was not located."""
        track = self.track
        if not track.valid[frame]:
            return None
        return of_track(self.head, track, frame)

    def frames(self) -> Iterator[tuple[int, Camera]]:
        """The frames in which it was located, in order."""
        for frame in np.flatnonzero(self.track.valid).tolist():
            camera = self.at(frame)
            assert camera is not None
            yield frame, camera

    def sigma(self, frame: int) -> tuple[float, float]:
        """Standard deviations of pan, in degrees, and of the focal length, in pixels."""
        pan, log_focal = np.sqrt(np.diag(self.track.covariance[frame]))
        return float(np.rad2deg(pan)), float(log_focal * self.track.focal_px[frame])

    def shear(self, frame: int) -> tuple[float, float]:
        """Change of pan, in degrees, and of the focal length, in pixels, from the first row to the last; 0 where all
        rows are exposed at once."""
        if not len(self.track.shear):
            return 0.0, 0.0
        pan, log_focal = self.track.shear[frame]
        return float(np.rad2deg(pan)), float(log_focal * self.track.focal_px[frame])


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """A reconstruction, and the capture that it was made of where it is at hand."""

    reconstruction: Reconstruction
    capture: Capture | None = None

    @property
    def file(self) -> str:
        """The name of the take as far as it may stand in the name of a file."""
        return plain(self.reconstruction.capture_name) or "take"

    @property
    def rate(self) -> float:
        """Frames a second."""
        return float(self.reconstruction.frame_rate)

    @property
    def times_s(self) -> Array:
        """(F,) since the first frame set."""
        return np.arange(len(self.reconstruction.timecodes)) / self.rate

    def cameras(self) -> tuple[LocatedCamera, ...]:
        """The cameras that have frames, corrected by the body where it was tracked. PzcapError if there are none."""
        whole, found = self.reconstruction, []
        files = _unlike([plain(name) or "camera" for name in whole.camera_names])
        rows = zip(whole.camera_names, files, whole.cameras, whole.tracks, whole.refined, strict=True)
        for number, (name, file, head, track, refined) in enumerate(rows):
            used = track if refined is None else refined
            if head is not None and used is not None and used.valid.any():
                found.append(LocatedCamera(number, name, file, head, used))
        if not found:
            raise PzcapError(f"'{whole.capture_name}': no camera was located in any frame; there is nothing to write")
        return tuple(found)

    def motion(self) -> Motion:
        """The athlete's motion. PzcapError if there is none."""
        motion = self.reconstruction.motion
        if motion is None or not motion.valid.any():
            raise PzcapError(f"'{self.reconstruction.capture_name}': no body was tracked; there is nothing to write")
        return motion

    def rig(self) -> tuple[Motion, MovedBody]:
        """The motion and the body that it moves. PzcapError if there is none."""
        motion = self.motion()
        if motion.body is None:
            raise PzcapError(
                f"'{self.reconstruction.capture_name}': joints, but no body (an earlier pzcap wrote it, or an estimator"
                " that has none); reconstruct it again, or write trc or c3d"
            )
        return motion, motion.body


def points(motion: Motion) -> tuple[tuple[str, ...], Array]:
    """Names and places (F, N, 3) of the joints and, where the body is known, of its ends."""
    if motion.body is None:
        return JOINTS, motion.joints_m
    rotations = segment_rotations(motion, motion.body)
    carriers = [SEGMENTS.index(segment) for segment in ENDS.values()]
    ends = motion.joints_m[:, carriers] + np.einsum("fnij,nj->fni", rotations[:, carriers], motion.body.ends_m)
    return (*JOINTS, *ENDS), np.concatenate([motion.joints_m, ends], axis=1)


def segment_rotations(motion: Motion, body: MovedBody) -> Array:
    """(F, 16, 3, 3) of each segment to the world."""
    parents = np.array(PARENTS)
    rows = zip(motion.root_position_m, motion.rotations, strict=True)
    return np.stack([chain(root, rotations, body.offsets_m, parents) for root, rotations in rows])[:, :, :3, :3]


def held(valid: Mask) -> Indices:
    """(F,) for each frame the one whose pose it shows in a format that knows no gaps: itself, or the valid one before,
    or the first valid one."""
    frames = np.where(valid, np.arange(len(valid)), -1)
    before = np.maximum.accumulate(frames)
    return np.where(before < 0, int(np.argmax(valid)), before)


def library(name: str, form: str) -> Any:
    """The package ``name``, which writes format ``form``. PzcapError if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = {"pxr": "usd-core"}.get(name, name)
        raise PzcapError(
            f"{form} is written by the package {package}, which is not installed; pip install 'pzcap[export]'"
        ) from error


def write_text(path: Path, text: str) -> Path:
    """Write a text file, whole or not at all; the path."""
    return write_bytes(path, text.encode(errors="replace"))  # names may hold what no text does


def plain(name: str) -> str:
    """``name`` with ASCII letters, digits, - and _ alone, which every tool reads; of other letters what is left without
    their accents."""
    bare = "".join(each for each in unicodedata.normalize("NFKD", name) if not unicodedata.combining(each))
    return re.sub(r"[^A-Za-z0-9_-]+", "_", bare.replace("ß", "ss")).strip("_")


def _unlike(names: Sequence[str]) -> list[str]:
    """``names``, those that occur twice with their number, so that all differ."""
    found: list[str] = []
    for k, name in enumerate(names):
        own = name if names.count(name) == 1 else f"{name}_{k + 1}"
        while own in found or (own != name and own in names):
            own += "_"
        found.append(own)
    return found
