"""A sweep by a rolling shutter: its frames put right, so that the panorama is neither sheared nor banded.

A head that turns evenly shears all frames of the sweep alike, and so the panorama: rows stand beside each other by what
the head turns meanwhile. Nothing within the sweep contradicts that. The reference image does, or the zoom run where
there is none: its camera stands still, and it shows no shear, but the opposite of the panorama's when it is aligned
with that.

Mains light leaves bands in rows. Frames one after the other may have nearly the same, and the panorama then has them,
too; what overlaps of all frames together tell of them (`pzcap.imaging.row_bands.fit_frames`) is divided out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration.calibrate import CalibratedCamera, Footage
from pzcap.calibration.stitching import SweptFrames, ZoomedFrames
from pzcap.calibration.sweep import Frames, MappedFrames
from pzcap.geometry.camera import wrapped
from pzcap.imaging import bspline
from pzcap.imaging.row_bands import without_bands
from pzcap.localisation.frame_prior import FramePrior
from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.localisation.photometric_alignment import Aligner
from pzcap.localisation.rectification import rectified
from pzcap.localisation.tuning import ALIGNMENT, READOUT
from pzcap.types import Array, Image, Localisation, PanZoomCamera


def put_right(
    footage: Footage, readout: float, found: CalibratedCamera, swept: SweptFrames, zoomed: ZoomedFrames
) -> Footage:
    """The ``footage`` with all rows of its frames exposed at once. Sweep and zoom run have a ``readout`` of so many
    frame periods; how fast the camera turned and zoomed is as it was ``found`` by the frames as they are."""
    pan_rate = np.gradient(np.unwrap(found.panorama.sweep_pan_rad), swept.kept)
    shear = readout * np.column_stack([pan_rate, np.zeros_like(pan_rate)])
    sweep, zoom = _rectified(footage.sweep, found.camera, swept.kept, shear), footage.zoom
    if zoom is not None and len(zoomed.numbers) > 1:
        zoom_rate = np.gradient(zoomed.log_focal, zoomed.numbers)
        shear = readout * np.column_stack([np.zeros_like(zoom_rate), zoom_rate])
        zoom = _rectified(zoom, found.camera, zoomed.numbers, shear)
    image = footage.reference_image
    if footage.calibration_object is None:  # it is the sweep's first frame
        _, image = next(iter(sweep))
    return footage._replace(reference_image=image, sweep=sweep, zoom=zoom)


def _rectified(frames: Frames, camera: PanZoomCamera, numbers: NDArray[np.int64], shear: Array) -> MappedFrames:
    """The ``frames`` as if all rows of each had been exposed at once, of some ``numbers`` (M,) of which the ``shear``
    (M, 2) of pan and log focal is known."""

    def rectify(number: int, image: Image) -> Image:
        own = np.array([np.interp(number, numbers, one) for one in shear.T])
        return rectified(image, camera, _sheared(camera, own), bspline.resampled)

    return MappedFrames(frames, rectify)


def _without_bands(frames: Frames, numbers: NDArray[np.int64], bands: Array) -> MappedFrames:
    """The ``frames`` without the ``bands`` (M, K) of those of some ``numbers`` (M,)."""
    known = dict(zip(numbers.tolist(), bands, strict=True))
    return MappedFrames(frames, lambda k, image: without_bands(image, known[k]) if k in known else image)


def evenly_lit(footage: Footage, bands: Array, kept: NDArray[np.int64], zoomed: NDArray[np.int64]) -> Footage:
    """The ``footage`` without the ``bands`` (F, K) of its frames, those of the sweep that were ``kept`` (M,), the
    reference image and those of the zoom run with the numbers ``zoomed`` (Z,); itself where there are none."""
    if not bands.size:
        return footage
    swept, reference, in_zoom = bands[: len(kept)], bands[len(kept)], bands[len(kept) + 1 :]
    zoom = None if footage.zoom is None else _without_bands(footage.zoom, zoomed, in_zoom)
    image, sweep = without_bands(footage.reference_image, reference), _without_bands(footage.sweep, kept, swept)
    return footage._replace(reference_image=image, sweep=sweep, zoom=zoom)


def _sheared(camera: PanZoomCamera, shear: Array) -> Localisation:
    """Place of a frame with a ``shear`` (2,); all else does not matter."""
    nothing = np.empty((0, 2))
    return Localisation(
        0.0, camera.tilt_rad, camera.lens.reference_focal_px, np.eye(2), True, nothing, nothing, shear=shear
    )


class Still(NamedTuple):
    """A picture by a camera that stood still, and where it looked."""

    image: Image
    at: ViewPlace
    zooms: bool  # its rows differ in focal length, if the shutter rolls


def still_of(footage: Footage, found: CalibratedCamera, zoomed: ZoomedFrames) -> Still | None:
    """The reference image, if the calibration object is in it; else, as any of the sweep would tell nothing, the
    frame of the zoom run whose focal length is nearest to its own. None without either."""
    tilt_rad, focal_px = found.camera.tilt_rad, found.reference.camera.focal_px
    if footage.calibration_object is not None:
        return Still(footage.reference_image, ViewPlace(0.0, tilt_rad, focal_px), False)
    if footage.zoom is None or not len(zoomed.numbers):
        return None
    nearest = int(np.argmin(np.abs(zoomed.log_focal - np.log(focal_px))))
    image = next(image for number, image in footage.zoom if number == zoomed.numbers[nearest])
    return Still(image, ViewPlace(zoomed.pan_rad, tilt_rad, float(np.exp(zoomed.log_focal[nearest]))), True)


class Remaining(NamedTuple):
    """Read-out, frame periods, that is seen beyond what frames were put right by."""

    share: float
    sigma: float  # 0: nothing shows it

    @property
    def matters(self) -> bool:
        """True if frames have to be put right by it."""
        return abs(self.share) >= self.sigma > 0.0

    def with_other(self, other: Remaining) -> Remaining:
        """Both together by their variances; this one alone where they contradict each other, the other where nothing
        shows this one."""
        if not self.sigma:
            return other
        if abs(self.share - other.share) > READOUT.contradiction * float(np.hypot(self.sigma, other.sigma)):
            return self
        first, second = self.sigma**-2.0, other.sigma**-2.0
        return Remaining((first * self.share + second * other.share) / (first + second), (first + second) ** -0.5)


def in_sweep(still: Still, found: CalibratedCamera, swept: SweptFrames) -> Remaining:
    """Read-out that frames of the sweep still show, against a picture by the camera at rest; where that cannot be
    aligned, nothing shows it."""
    open_to = READOUT.panorama_rad
    prior = FramePrior(still.at, open_to, open_to, open_to, open_to if still.zooms else 0.0)
    aligner = Aligner(found.panorama, found.camera, pixels=still.image.size)
    aligned = aligner.align(still.image, still.at, 4.0, None, prior)
    if aligned.agreement < ALIGNMENT.sure_agreement or not aligned.report.converged:
        return Remaining(0.0, 0.0)
    rate = _rate_at(still.at.pan_rad, found, swept)
    sigma_rad = 3.0 * float(np.sqrt(ALIGNMENT.doubt * aligned.covariance[4, 4]))
    return Remaining(-aligned.at.pan_shear_rad / rate, max(READOUT.least_shear_rad, sigma_rad) / abs(rate))


def in_zoom_run(frames: Frames, found: CalibratedCamera, zoomed: ZoomedFrames) -> Remaining | None:
    """Read-out that ``frames`` of the zoom run show: the shear of log focal over its change a frame, where the lens is
    as in the sweep. A lens is zoomed faster than a head is turned, and tells more. None where too few can be aligned.

    What the travel of the projection centre is wrong by looks like a shear, too, but grows with log focal from nothing
    at the sweep's; so do the errors of a panorama that is sheared itself. Both are a line's slope, and what is looked
    for its value there.
    """
    if len(zoomed.numbers) < READOUT.least_zoomed:
        return None
    rates = np.gradient(zoomed.log_focal, zoomed.numbers)
    fastest = float(np.abs(rates).max())
    moving = {int(number): index for index, number in enumerate(zoomed.numbers) if abs(rates[index]) > 0.5 * fastest}
    aligner, seen = None, []
    for number, image in frames:
        if number not in moving:
            continue
        log_focal, rate = zoomed.log_focal[moving[number]], rates[moving[number]]
        at = ViewPlace(zoomed.pan_rad, found.camera.tilt_rad, float(np.exp(log_focal)))
        aligner = aligner or Aligner(found.panorama, found.camera, pixels=image[..., 0].size // 3)
        aligned = aligner.align(image, at, 4.0, None, FramePrior(at, *([READOUT.panorama_rad] * 4)))
        if aligned.agreement >= ALIGNMENT.sure_agreement and aligned.report.converged:
            zoom = log_focal - np.log(found.camera.lens.reference_focal_px)
            seen.append((zoom, aligned.at.zoom_shear / rate, abs(rate) / np.sqrt(aligned.covariance[5, 5])))
    if len(seen) < READOUT.least_zoomed:
        return None
    zoom, share, certainty = np.array(seen).T
    line = np.polynomial.Polynomial.fit(zoom, share, 1, w=certainty)
    return Remaining(float(line(0.0)), READOUT.zoom_shear / fastest)


def _rate_at(looked_rad: float, found: CalibratedCamera, swept: SweptFrames) -> float:
    """Pan a frame period where a camera at rest ``looked``: a frame of the sweep has shown there what it had of
    shear."""
    pan_rad = found.panorama.sweep_pan_rad
    near = np.argsort(np.abs(wrapped(pan_rad - looked_rad)))[:5]
    rate = float(np.median(np.gradient(np.unwrap(pan_rad), swept.kept)[near]))
    return float(np.copysign(max(abs(rate), 1e-9), rate))
