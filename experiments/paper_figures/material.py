"""Input of the figures: a finished run, its footage, and the truth where there is one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cattrs
import numpy as np
from numpy.typing import NDArray

from experiments import footage
from experiments.score import frames_of
from pzcap.geometry.camera import mount
from pzcap.io import results
from pzcap.io.capture import frame_sets, read_capture, read_image
from pzcap.types import (
    Array,
    CalibrationObject,
    Camera,
    Image,
    Panorama,
    PanZoomCamera,
    PanZoomTrack,
    Pose,
    PzcapError,
    Reconstruction,
    Subject,
)
from pzcap.viewer.drawing import figures, instants
from sim.session import ShootConfig
from sim.truth import Truth

Views = Callable[[int], tuple[Image | None, ...]]
"""The images of a frame set, one a camera."""


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """A camera of which all is known: lens, panorama and track."""

    number: int
    name: str
    camera: PanZoomCamera
    panorama: Panorama
    track: PanZoomTrack
    at: list[Camera | None]  # (F,)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A finished run."""

    reconstruction: Reconstruction
    target: CalibrationObject | None
    subject: Subject | None
    references: tuple[Image | None, ...]  # (C,) the still images of the calibration object
    views: Views
    truth: Truth | None = None
    truth_frames: NDArray[np.int64] | None = None  # (F,) index into the truth of each frame set

    def located(self) -> list[Located]:
        """The cameras of which all is known. PzcapError if there is none."""
        found = []
        parts = self.reconstruction
        for number, name in enumerate(parts.camera_names):
            camera, panorama, track = parts.cameras[number], parts.panoramas[number], parts.tracks[number]
            if camera is not None and panorama is not None and track is not None and track.valid.any():
                found.append(Located(number, name, camera, panorama, track, instants(camera, track)))
        if not found:
            raise PzcapError(f"{parts.capture_name}: no camera was reconstructed; figures need at least one")
        return found

    def body(self) -> Array:
        """(F, 21, 3) the athlete as a stick figure. PzcapError where no motion was tracked."""
        motion = self.reconstruction.motion
        if motion is None:
            raise PzcapError(f"{self.reconstruction.capture_name}: no motion was tracked; its figures need one")
        return figures(motion.joints_m, motion.rotations)

    def true_body(self) -> Array | None:
        """(F, 21, 3) the same as it was."""
        if self.truth is None or self.truth_frames is None:
            return None
        return figures(self.truth.joints_m[self.truth_frames], self.truth.rotations[self.truth_frames])

    def true_pose(self, frame: int) -> Pose | None:
        """The athlete's pose as it was in a frame set."""
        if self.truth is None or self.truth_frames is None:
            return None
        return self.truth.pose(int(self.truth_frames[frame]))

    def true_camera(self, name: str, frame: int | None) -> Camera | None:
        """A camera as it was in a frame set, or at the reference pose."""
        if self.truth is None or self.truth_frames is None:
            return None
        truth, c = self.truth, self.truth.camera_names.index(name)
        return truth.reference_camera(c) if frame is None else truth.camera(c, int(self.truth_frames[frame]))

    def true_track(self, name: str) -> tuple[Array, Array] | None:
        """Pan, rad, and focal length, px, as they were in all frame sets: (F,) each."""
        if self.truth is None or self.truth_frames is None:
            return None
        c = self.truth.camera_names.index(name)
        return self.truth.pan_rad[c, self.truth_frames], self.truth.focal_px[c, self.truth_frames]

    def true_head(self, name: str) -> PanZoomCamera | None:
        """A camera and its head as they were; millimetres between the pan axis and the centre are left out."""
        reference = self.true_camera(name, None)
        if reference is None or self.truth is None:
            return None
        c = self.truth.camera_names.index(name)
        tilt, roll = float(np.median(self.truth.tilt_rad[c])), float(np.median(self.truth.roll_rad[c]))
        return mount(reference, PanZoomCamera(self.truth.lens(c), np.eye(4), tilt, roll))


def load(folder: Path, command: str) -> Run:
    """The run in ``folder``. PzcapError, with the ``command`` that makes it, where there is none."""
    if not (folder / "reconstruction" / results.MANIFEST).is_file() or not (folder / "capture").exists():
        raise PzcapError(f"{folder}: no finished run there; make it: python -m experiments.run {command}")
    reconstruction = results.load(folder / "reconstruction")
    capture = read_capture(folder / "capture")
    truth = footage.truth_beside(folder / "capture")
    sets = frame_sets(capture)

    @lru_cache(maxsize=32)
    def views(frame: int) -> tuple[Image | None, ...]:
        return next(iter(sets.between(frame, frame + 1))).images

    return Run(
        reconstruction=reconstruction,
        target=capture.calibration_object,
        subject=capture.subject,
        references=tuple(None if c.reference is None else read_image(c.reference) for c in capture.cameras),
        views=views,
        truth=truth,
        truth_frames=None if truth is None else frames_of(truth, reconstruction)[0],
    )


def shoot_config(truth: Truth) -> ShootConfig:
    """Settings of the simulator that shot what this is the truth of."""
    return cattrs.Converter().structure(json.loads(truth.config), ShootConfig)
