"""Alignment of a frame with the super-resolved panorama (`pzcap.extras.superresolution`), where there is one."""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
from numba import njit

from pzcap.geometry import lens as lenses
from pzcap.imaging.bspline import STEPS, Stored, smoothed
from pzcap.localisation.frame_pixels import FramePixels, shading
from pzcap.localisation.panorama_sampler import (
    BY_LOG_FOCAL,
    BY_PAN,
    BY_PAN_SHEAR,
    BY_ROLL,
    BY_TILT,
    BY_ZOOM_SHEAR,
    COLUMN,
    KNOWN,
    Rays,
    ViewPlace,
)
from pzcap.localisation.photometric_alignment import Aligner, Fit, Limits, NothingToCompare
from pzcap.localisation.tuning import ALIGNMENT
from pzcap.types import Array, Image, Mask, Panorama, PanZoomCamera


class SuperresolvedTuning(NamedTuple):
    """Fit to the super-resolved panorama, where there is one."""

    steps: int = 12
    """Gauss-Newton steps, at most."""
    settled_px: float = 0.0005
    """Pixels of the frame. A smaller step ends the fit."""
    least_noise: float = 0.2
    """Grey levels. Residuals have no smaller standard deviation: pixels are predicted so exactly."""
    smoothing_px2: float = 1.0
    """Variance, square pixels of the frame, by which frame and prediction are smoothed."""


SUPERRESOLVED: Final = SuperresolvedTuning()


class SuperresolvedAligner(Aligner):
    """An `Aligner` whose last fit is to the super-resolved panorama, where there is one, by all pixels of the frame."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, *, pixels: int = 4000) -> None:
        super().__init__(panorama, camera, pixels=pixels)
        self._fine: Stored | None = None
        if panorama.fine.size:
            down, across = np.array(panorama.fine.shape) // np.array(panorama.image.shape[:2])
            margin = self.sampler.margin
            beyond = (0, 0, margin * across, margin * across, cv2.BORDER_WRAP)
            self._fine = np.asarray(cv2.copyMakeBorder(panorama.fine, *beyond), np.uint16)
            known = cv2.copyMakeBorder(panorama.valid.astype(np.uint8), 0, 0, margin, margin, cv2.BORDER_WRAP)
            known = cv2.resize(known, self._fine.shape[::-1], interpolation=cv2.INTER_NEAREST)
            self._known = cv2.erode(known, np.ones((9, 9), np.uint8)) > 0
            self._cells = np.array([across, down], np.float64)  # to a pixel of the panorama

    def refined(self, fit: Fit, frame: Image, hidden: Mask | None) -> Fit:
        """``fit`` refined on the super-resolved panorama; as it is where that fails."""
        if self._fine is None or not fit.solution.report.converged:
            return fit
        limits = Limits(SUPERRESOLVED.steps, SUPERRESOLVED.settled_px, SUPERRESOLVED.least_noise)
        try:
            finer = self._fit_cells(self._fine, fit, frame, hidden, limits)
        except NothingToCompare:
            return fit
        return finer if finer.solution.report.converged else fit

    def _fit_cells(self, fine: Stored, fit: Fit, frame: Image, hidden: Mask | None, limits: Limits) -> Fit:
        """Compare all pixels of a ``frame`` (H, W), but those near its border or ``hidden`` (H, W), with the mean of
        the super-resolved panorama over the square that each covers.

        Frame and prediction are smoothed alike. The prediction is smoothed last, so that it contains what the frame's
        pixels are too coarse for as the frame does.
        """
        border, focal_px = ALIGNMENT.border_px, fit.solution.state.at.focal_px
        inner = slice(border, -border)
        soft = smoothed(frame, SUPERRESOLVED.smoothing_px2)[inner, inner]
        visible = np.ones(soft.shape, np.uint8) if hidden is None else (~hidden[inner, inner]).astype(np.uint8)
        reach = np.ones((7, 7), np.uint8)  # of the smoothing; what it takes from further off is negligible
        rows, columns = np.mgrid[border : frame.shape[0] - border, border : frame.shape[1] - border]
        points = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
        half = half_extents(self.camera, points, focal_px) * self.sampler.px_per_rad * self._cells

        def look(rays: Rays, at: ViewPlace) -> Array:
            samples = self._sampled(fine, half, rays, at)
            for column in range(KNOWN):  # value and derivatives
                image = samples[:, column].reshape(soft.shape).astype(np.float32)
                samples[:, column] = smoothed(image, SUPERRESOLVED.smoothing_px2).ravel()
            known = (samples[:, KNOWN].reshape(soft.shape) > 0).astype(np.uint8) & visible
            samples[:, KNOWN] = cv2.erode(known, reach, borderType=cv2.BORDER_CONSTANT, borderValue=0).ravel()
            return samples

        pixels = FramePixels(points, soft.ravel().astype(np.float64), shading(points, self.camera.lens, focal_px))
        return self.fit(look, pixels, fit.solution.state, fit.cost.prior, limits)

    def _sampled(self, fine: Stored, half: Array, rays: Rays, at: ViewPlace) -> Array:
        """Samples (N, SAMPLE), as `PanoramaSampler.sample` has them, of the means over boxes of cells, ``half``
        (N, 2) of which they extend to either side."""
        samples = self.sampler.sample(self.sampler.levels[-1], rays, at)  # for where they are
        samples[:, KNOWN] = _means(fine, self._known, (samples[:, COLUMN:] + 0.5) * self._cells, half, samples)
        by_azimuth, by_slope = (samples[:, 1:3] * (-self.sampler.px_per_rad * self._cells)).T
        samples[:, BY_PAN] = by_azimuth
        for column, k in ((BY_LOG_FOCAL, 2), (BY_TILT, 4), (BY_ROLL, 6)):
            samples[:, column] = by_azimuth * rays.directions[:, k] + by_slope * rays.directions[:, k + 1]
        samples[:, BY_PAN_SHEAR] = by_azimuth * rays.row_time
        samples[:, BY_ZOOM_SHEAR] = samples[:, BY_LOG_FOCAL] * rays.row_time
        return samples


def half_extents(camera: PanZoomCamera, points: Array, focal_px: float) -> Array:
    """Half of the azimuths and of the slopes (N, 2) that the pixels at ``points`` (N, 2) of a frame cover.

    Roll, tilt and distortion are slight, and left out.
    """
    secant = np.hypot(1.0, (points[:, 0] - lenses.at(camera.lens, focal_px)[0][0]) / focal_px)
    return np.asarray(np.stack([0.5 / secant**2, 0.5 / secant], axis=1) / focal_px)


@njit(cache=True, nogil=True, error_model="numpy")
def _means(fine: Stored, known: Mask, places: Array, half: Array, out: Array) -> Array:
    """Write into ``out`` (N, 3 or more) the mean grey level over ``half`` (N, 2) of the cells to either side of
    ``places`` (N, 2), and its derivatives across and down; 1 (N,) where these cells are known."""
    found = np.zeros(len(places))
    for n in range(len(places)):
        column, row = places[n]
        inside, value, by_column, by_row = box(fine, column, row, half[n, 0], half[n, 1])
        usable = inside and known[int(row), int(column)]
        out[n, 0], out[n, 1], out[n, 2] = (value, by_column, by_row) if usable else (0.0, 0.0, 0.0)
        found[n] = 1.0 if usable else 0.0
    return found


@njit(cache=True, nogil=True)
def box(image: Stored, x: float, y: float, half_x: float, half_y: float) -> tuple[bool, float, float, float]:
    """A flag that a box about (x, y) lies inside an image of cells, of which the first spans 0 to 1; the mean grey
    level in it, and the derivatives along x and y."""
    left, right, top, bottom = x - half_x, x + half_x, y - half_y, y + half_y
    first, last = int(np.floor(left)), int(np.floor(right))
    upper, lower = int(np.floor(top)), int(np.floor(bottom))
    if first < 0 or upper < 0 or last >= image.shape[1] or lower >= image.shape[0]:
        return False, 0.0, 0.0, 0.0
    value, by_x, by_y = 0.0, 0.0, 0.0
    for i in range(upper, lower + 1):
        row = 0.0
        for j in range(first, last + 1):
            row += (min(right, j + 1.0) - max(left, float(j))) * image[i, j]
        down = min(bottom, i + 1.0) - max(top, float(i))
        value += down * row
        by_x += down * (float(image[i, last]) - float(image[i, first]))
        by_y += (row if i == lower else 0.0) - (row if i == upper else 0.0)
    share = 1.0 / (STEPS * (right - left) * (bottom - top))
    return True, value * share, by_x * share, by_y * share
