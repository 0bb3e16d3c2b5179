"""A sweep by a rolling shutter: its frames put right, so that the panorama is neither sheared nor banded.

A head that turns evenly shears all frames of the sweep alike, and so the panorama: rows stand beside each other by what
the head turns meanwhile. Nothing within the sweep contradicts that. The reference image does: its camera stands still,
and it shows no shear, but the opposite of the panorama's when it is aligned with that.

Mains light leaves bands in rows. Those of the sweep's frames may be alike, and are then the panorama's; what a frame
has beyond them it shows when it is aligned with the panorama (`row_bands`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration.calibrate import CalibratedCamera, Footage
from pzcap.calibration.stitching import SweptFrames, ZoomedFrames
from pzcap.calibration.sweep import Frames
from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.localisation.photometric_alignment import Aligner, Belief
from pzcap.localisation.rectification import rectified
from pzcap.localisation.row_bands import without_bands
from pzcap.localisation.tuning import ALIGNMENT, BANDS, READOUT
from pzcap.types import Array, Image, Localisation, PanZoomCamera


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedFrames:
    """The ``frames`` of a sweep or a zoom run as if all rows of each had been exposed at once."""

    frames: Frames
    camera: PanZoomCamera
    numbers: NDArray[np.int64]  # (M,) of those frames whose shear is known
    shear: Array  # (M, 2) of pan and log focal

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        for number, image in self.frames:
            shear = np.array([np.interp(number, self.numbers, one) for one in self.shear.T])
            yield number, rectified(image, self.camera, _sheared(self.camera, shear))


def put_right(
    footage: Footage, readout: float, found: CalibratedCamera, swept: SweptFrames, zoomed: ZoomedFrames
) -> Footage:
    """The ``footage`` with all rows of its frames exposed at once. Sweep and zoom run have a ``readout`` of so many
    frame periods; how fast the camera turned and zoomed is as it was ``found`` by the frames as they are."""
    pan_rate = np.gradient(np.unwrap(found.panorama.sweep_pan_rad), swept.kept)
    shear = readout * np.column_stack([pan_rate, np.zeros_like(pan_rate)])
    sweep, zoom = RectifiedFrames(footage.sweep, found.camera, swept.kept, shear), footage.zoom
    if zoom is not None and len(zoomed.numbers) > 1:
        zoom_rate = np.gradient(zoomed.log_focal, zoomed.numbers)
        shear = readout * np.column_stack([np.zeros_like(zoom_rate), zoom_rate])
        zoom = RectifiedFrames(zoom, found.camera, zoomed.numbers, shear)
    return footage._replace(sweep=sweep, zoom=zoom)


@dataclass(frozen=True, slots=True, eq=False)
class EvenlyLit:
    """The ``frames`` of a sweep or a zoom run without their ``bands``, one (K,) a frame."""

    frames: Frames
    bands: dict[int, Array]

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        for number, image in self.frames:
            yield number, without_bands(image, self.bands[number]) if number in self.bands else image


def evenly_lit(footage: Footage, found: CalibratedCamera, swept: SweptFrames, zoomed: ZoomedFrames) -> Footage:
    """The ``footage``, reference image, sweep and zoom run in the light of the panorama; itself where few of their
    frames, looked at here and there, have bands that it has not."""
    aligner, camera, sweep_pan = Aligner(found.panorama, found.camera), found.camera, found.panorama.sweep_pan_rad
    focal_px, pans = camera.lens.reference_focal_px, np.unwrap(sweep_pan)

    def bands(image: Image, pan_rad: float, focal_px: float) -> Array:
        return aligner.align(image, ViewPlace(pan_rad, camera.tilt_rad, focal_px), 4.0).bands

    def swept_at(number: int) -> tuple[float, float]:
        return float(np.interp(number, swept.kept, pans)), focal_px

    def zoomed_at(number: int) -> tuple[float, float]:
        return zoomed.pan_rad, float(np.exp(np.interp(number, zoomed.numbers, zoomed.log_focal)))

    def found_in(frames: Frames, at: Callable[[int], tuple[float, float]]) -> dict[int, Array]:
        return {number: one for number, image in frames if (one := bands(image, *at(number))).size}

    some = np.unique(np.linspace(0, len(pans) - 1, BANDS.probes).astype(int))
    in_sweep = [bands(swept.images[number], float(pans[number]), focal_px).size > 0 for number in some]
    probes = [] if footage.zoom is None else [frame for frame in footage.zoom if frame[0] in zoomed.numbers[::3]]
    in_zoom = [bands(image, *zoomed_at(number)).size > 0 for number, image in probes]
    in_reference = bands(footage.reference_image, 0.0, found.reference.camera.focal_px)
    if not any(np.mean(banded) >= 0.5 for banded in (in_sweep, in_zoom, [in_reference.size > 0]) if banded):
        return footage
    image = without_bands(footage.reference_image, in_reference)
    zoom = None if footage.zoom is None else EvenlyLit(footage.zoom, found_in(footage.zoom, zoomed_at))
    sweep = EvenlyLit(footage.sweep, found_in(footage.sweep, swept_at))
    return footage._replace(reference_image=image, sweep=sweep, zoom=zoom)


def _sheared(camera: PanZoomCamera, shear: Array) -> Localisation:
    """Place of a frame with a ``shear`` (2,); all else does not matter."""
    nothing = np.empty((0, 2))
    return Localisation(
        0.0, camera.tilt_rad, camera.lens.reference_focal_px, np.eye(2), True, nothing, nothing, shear=shear
    )


def remaining_readout(footage: Footage, found: CalibratedCamera, swept: SweptFrames) -> float:
    """Read-out, frame periods of the sweep, that its frames show beyond what they were put right by: 0 where the
    reference image shows none, or cannot be aligned."""
    panorama, camera, image = found.panorama, found.camera, footage.reference_image
    focal_px = found.reference.camera.focal_px
    start = ViewPlace(0.0, camera.tilt_rad, focal_px)
    belief = Belief(start, *([READOUT.panorama_rad] * 3))
    aligned = Aligner(panorama, camera, pixels=image.size).align(image, start, 4.0, None, belief)
    if aligned.agreement < ALIGNMENT.sure_agreement or not aligned.report.converged:
        return 0.0
    shear_rad, sigma_rad = aligned.at.pan_shear_rad, np.sqrt(ALIGNMENT.doubt * aligned.covariance[4, 4])
    if abs(shear_rad) < max(READOUT.least_shear_rad, 3.0 * sigma_rad):
        return 0.0
    return -float(shear_rad) / _rate_at_reference(found, swept)


def readout_sigma(found: CalibratedCamera, swept: SweptFrames) -> float:
    """Standard deviation of the read-out, frame periods of the sweep, that `remaining_readout` leaves."""
    return READOUT.least_shear_rad / abs(_rate_at_reference(found, swept))


def _rate_at_reference(found: CalibratedCamera, swept: SweptFrames) -> float:
    """Pan a frame period where the reference image looks: a frame of the sweep has shown there what it had of shear."""
    pan_rad = found.panorama.sweep_pan_rad
    rate = float(np.median(np.gradient(np.unwrap(pan_rad), swept.kept)[np.argsort(np.abs(pan_rad))[:5]]))
    return float(np.copysign(max(abs(rate), 1e-9), rate))
