"""Input of the methods of the bench: a calibrated background of each camera, and frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrate_camera, footage_of, taken_over
from pzcap.extras.paper import method as paper
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.lens import at as lens_at
from pzcap.geometry.lens import distort, undistort
from pzcap.io import results
from pzcap.io.capture import frame_sets
from pzcap.io.video import VideoReader
from pzcap.progress import Report
from pzcap.types import Array, CameraFiles, Capture, Image, Mask, Panorama, PanZoomCamera, PzcapError
from sim.truth import Truth

SWEEP_STEP = 0.25  # between the frames of a sweep that a peer is given, in fields of view
FARTHEST = 1e-6  # 1 / m: what is nearer to nothing than this counts as so far away


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    pan_rad: float
    focal_px: float


@dataclass(frozen=True, slots=True, eq=False)
class SweepView:
    """A frame of the sweep, and the pan that our joint adjustment gave it."""

    image: Image  # (H, W, 3)
    pan_rad: float


@dataclass(frozen=True, eq=False)
class Background:
    """Everything that is known of one camera before the motion. The same for every method."""

    camera: PanZoomCamera
    panorama: Panorama
    sweep: tuple[SweepView, ...]  # ``SWEEP_STEP`` apart
    config: PanZoomConfig
    paper: tuple[Panorama, PanZoomCamera] | None  # what the paper's own procedure made of the same footage

    @cached_property
    def centre(self) -> Array:
        """(2,) the middle of the image."""
        return np.array([(self.camera.lens.width - 1) / 2, (self.camera.lens.height - 1) / 2])

    def points(self, panorama_px: Array) -> Array:
        """(N, 3) points of the hall, world, that the panorama shows at its pixels (N, 2)."""
        azimuth, slope = cylinder.from_panorama(self.panorama, panorama_px)
        near = cylinder.inverse_distance(self.panorama.surroundings, azimuth, slope)
        places = np.column_stack([np.cos(azimuth), np.sin(azimuth), slope]) / np.maximum(near, FARTHEST)[:, None]
        return places @ self.camera.world_T_head[:3, :3].T + self.camera.world_T_head[:3, 3]

    def straight(self, points_px: Array, focal_px: float) -> Array:
        """Pixels (N, 2) of a frame as a lens without distortion, its axis in the image's middle, would show them."""
        principal, distortion = lens_at(self.camera.lens, focal_px)
        return focal_px * undistort((points_px - principal) / focal_px, distortion) + self.centre

    def straightened(self, image: Image, focal_px: float) -> Image:
        """`straight` for a whole image."""
        principal, distortion = lens_at(self.camera.lens, focal_px)

        def bent(points_px: Array) -> Array:
            return principal + focal_px * distort((points_px - self.centre) / focal_px, distortion)

        column, row = cylinder.smooth_map(bent, self.camera.lens.width, self.camera.lens.height)
        return np.asarray(cv2.remap(image, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)

    def rotation(self, pan_rad: float) -> Array:
        """(3, 3) camera coordinates to head coordinates."""
        return geometry.head_T_cam(pan_rad, self.camera.tilt_rad, self.camera.roll_rad)[:3, :3]

    def pan_of(self, rotation: Array) -> float:
        """The pan of a camera whose coordinates ``rotation`` (3, 3) takes to those of the head."""
        ahead = rotation @ self.rotation(0.0).T @ np.array([1.0, 0.0, 0.0])
        return float(np.arctan2(ahead[1], ahead[0]))

    def around(self, pan_rad: float, focal_px: float) -> list[int]:
        """Up to four frames of the sweep that show most of what a frame of this pan and focal length shows."""
        reach = np.arctan(self.camera.lens.width / 2 / self.camera.lens.reference_focal_px)
        apart = np.abs([geometry.wrapped(view.pan_rad - pan_rad) for view in self.sweep])
        field = np.arctan(self.camera.lens.width / 2 / focal_px)
        return [int(i) for i in np.argsort(apart, kind="stable")[:4] if apart[i] < reach + 0.5 * field]


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One view to be located."""

    camera: int
    frame: int
    image: Image  # (H, W, 3)
    truth: Estimate | None
    person: Mask | None  # (H, W) where the athlete is known to be, if anybody knows


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A test set: cameras and frames."""

    name: str
    cameras: tuple[str, ...]
    backgrounds: tuple[Background, ...]
    count: int  # of frames, over all cameras
    shots: Callable[[], Iterator[Shot]]  # frame after frame, camera after camera


def spaced(views: list[SweepView], step_rad: float) -> tuple[SweepView, ...]:
    """Some of a sweep's frames, each at least ``step_rad`` on from the one before."""
    chosen: list[SweepView] = []
    for view in views:
        if not chosen or abs(view.pan_rad - chosen[-1].pan_rad) >= step_rad:
            chosen.append(view)
    return tuple(chosen)


def from_capture(
    capture: Capture,
    truth: Truth | None,
    finished: Path | None,
    config: PanZoomConfig,
    with_paper: bool,
    report: Report,
) -> Material:
    """The material of a capture: every camera that has an image of the calibration object, a sweep and motion.

    ``finished`` is a folder with a reconstruction of the same capture, whose cameras and panoramas are then used.
    Raises PzcapError where a file is not what it should be, or no camera can be prepared.
    """
    chosen = [
        index
        for index, files in enumerate(capture.cameras)
        if capture.calibration_object and files.reference and files.sweep and files.motion
    ]
    if not chosen:
        raise PzcapError(
            f"{capture.folder}: no camera has an image of the calibration object, a sweep and motion; bring all three"
        )
    ready = taken_over(capture, results.load(finished), "exact", []) if finished else (None,) * len(capture.cameras)
    backgrounds = []
    for index in chosen:
        files = capture.cameras[index]

        def tell(stage: str, done: int, total: int, name: str = files.name) -> None:
            report(f"camera {name}: {stage}", done, total)

        known = ready[index]
        panorama, camera = (
            (known.panorama, known.camera)
            if known
            else _prepared(capture, files, replace(config, method="exact"), tell)
        )
        paper = _prepared(capture, files, replace(config, method="paper"), tell) if with_paper else None
        sweep = _swept(files, panorama, camera)
        backgrounds.append(Background(camera, panorama, sweep, config, paper))

    sets = frame_sets(capture)
    frames = {timecode: frame for frame, timecode in enumerate(truth.timecodes)} if truth else {}

    def shots() -> Iterator[Shot]:
        for views in sets:
            for number, index in enumerate(chosen):
                image = views.images[index]
                if image is None:
                    continue
                true, person = None, None
                name, frame = capture.cameras[index].name, frames.get(views.timecode)
                if truth is not None and frame is not None and name in truth.camera_names:
                    at = truth.camera_names.index(name)
                    true = Estimate(float(truth.pan_rad[at, frame]), float(truth.focal_px[at, frame]))
                    person = truth.mask(at, frame)
                yield Shot(number, views.index, image, true, person)

    names = tuple(capture.cameras[index].name for index in chosen)
    return Material(capture.name, names, tuple(backgrounds), len(sets) * len(chosen), shots)


def _prepared(
    capture: Capture, files: CameraFiles, config: PanZoomConfig, report: Report
) -> tuple[Panorama, PanZoomCamera]:
    calibrate = paper.calibrate if config.method == "paper" else calibrate_camera
    try:
        ready = calibrate(footage_of(capture, files), config, report)
    except PzcapError as error:
        raise PzcapError(f"camera {files.name}: {error}") from error
    return ready.panorama, ready.camera


def _swept(files: CameraFiles, panorama: Panorama, camera: PanZoomCamera) -> tuple[SweepView, ...]:
    assert files.sweep is not None
    step = SWEEP_STEP * 2 * np.arctan(camera.lens.width / 2 / camera.lens.reference_focal_px)
    pans = panorama.sweep_pan_rad
    # decoding them all is quick; only those that are kept take memory
    wanted = {v.pan_rad for v in spaced([SweepView(np.empty(0, np.uint8), float(pan)) for pan in pans], step)}
    images = zip((image for _, image in VideoReader(files.sweep)), pans, strict=False)
    kept = [SweepView(image, float(pan)) for image, pan in images if float(pan) in wanted]
    if len(kept) != len(wanted):
        raise PzcapError(f"{files.sweep}: is shorter than the sweep of the reconstruction; give its own or none")
    return tuple(kept)
