"""Coarse search for a frame: the whole of it, shrunk, is correlated with the whole panorama.

Far from the sweep's zoom a frame is too small on the panorama for features to be found in it. A few dozen pixels across
are enough to tell it from every other place, and so few that all pans and zooms are tried in a tenth of a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View, wrapped
from pzcap.imaging.colour import grey
from pzcap.localisation.tuning import SEARCH
from pzcap.types import Array, Float32, Image, Panorama, PanZoomCamera


@dataclass(frozen=True, slots=True)
class Place:
    """A place where a frame may be."""

    pan_rad: float
    tilt_rad: float
    focal_px: float
    correlation: float


class Correlator:
    """Finds frames of one camera by correlation with its panorama, at focal lengths from one to another, and with
    ``free_tilt`` at other tilts than the camera's."""

    def __init__(
        self, panorama: Panorama, camera: PanZoomCamera, focals_px: tuple[float, float], *, free_tilt: bool = False
    ) -> None:
        self._panorama, self._camera, self._free_tilt = panorama, camera, free_tilt
        self._focals = np.exp(np.arange(np.log(focals_px[0]), np.log(focals_px[1]), SEARCH.zoom_step))
        image = grey(panorama.image)
        image = np.where(panorama.valid, image, np.uint8(np.median(image[panorama.valid])))
        if panorama.full_turn:  # goes on beyond its end, so that no frame lies across a seam
            image = np.hstack([image, image[:, : image.shape[1] // 4]])
        widest = camera.lens.width * panorama.px_per_rad / focals_px[0]
        halved = range(_halvings(widest) + 1)
        self._levels = [_shrunk(image, 2**halvings).astype(np.float32) for halvings in halved]

    def places(self, image: Image) -> list[Place]:
        """The places that correlate most with ``image`` (H, W[, 3]), the best first; none where no place does."""
        frame = grey(image)
        found = [place for focal in self._focals if (place := self._best_pan(frame, float(focal))) is not None]
        apart: list[Place] = []
        for place in sorted(found, key=lambda place: -place.correlation):
            near = self._camera.lens.width / 8 / place.focal_px
            if all(abs(wrapped(place.pan_rad - other.pan_rad)) > near for other in apart):
                apart.append(place)
        return apart[:3]

    def _best_pan(self, frame: Image, focal_px: float) -> Place | None:
        """The place that correlates most with ``frame`` (H, W), if that was taken with a focal length."""
        panorama, camera = self._panorama, self._camera
        finer = focal_px / panorama.px_per_rad  # pixels of the frame to one of the panorama
        halvings = _halvings(camera.lens.width / finer)
        level, cell = self._levels[halvings], 2**halvings
        view = geometry.view_at(camera, 0.0, camera.tilt_rad, focal_px)
        top, bottom, left, right = self._field_of_view(view) * panorama.px_per_rad
        # columns count from the view's azimuth 0, rows from the top of the panorama
        columns = np.arange(np.ceil(-left / cell), np.floor(-right / cell) + 1)
        first, last = ((panorama.origin_px[1] - edge + 0.5) / cell - 0.5 for edge in (top, bottom))
        rows = np.arange(max(np.ceil(first), 0), min(np.floor(last), len(level) - 1) + 1)
        if min(len(rows), len(columns)) < SEARCH.width_px // 8 or len(columns) > level.shape[1]:
            return None
        slopes = (panorama.origin_px[1] - ((rows + 0.5) * cell - 0.5)) / panorama.px_per_rad
        azimuths = -columns * cell / panorama.px_per_rad
        pixels, _ = geometry.direction_to_pixel(view, *np.meshgrid(azimuths, slopes))
        small = _shrunk(frame, max(finer * cell, 1.0)).astype(np.float32)
        scale = np.array(small.shape[::-1]) / np.array(frame.shape[::-1])
        pixels = ((pixels + 0.5) * scale - 0.5).astype(np.float32)
        seen = cv2.remap(small, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if seen.std() < SEARCH.least_contrast:
            return None
        above = 0 if self._free_tilt else int(rows[0])
        within = level if self._free_tilt else level[above : above + len(rows)]
        correlation = _correlation(within, np.asarray(seen, np.float32))
        _, best, _, (column, row) = cv2.minMaxLoc(correlation)
        if best < SEARCH.least_correlation:
            return None
        pan = (panorama.origin_px[0] - ((column - columns[0] + 0.5) * cell - 0.5)) / panorama.px_per_rad
        raised = (rows[0] - above - row) * cell / panorama.px_per_rad
        return Place(float(pan), float(np.arctan(np.tan(camera.tilt_rad) + raised)), focal_px, best)

    def _field_of_view(self, view: View) -> Array:
        """The slopes and azimuths (4,) of the rectangle inside ``view``: top, bottom, left, right."""
        x, y = self._camera.lens.width - 1.0, self._camera.lens.height - 1.0
        points = np.array([[[0, 0], [x / 2, 0], [x, 0]], [[0, y], [x / 2, y], [x, y]]])
        azimuth, slope = geometry.pixel_to_direction(view, points)
        return np.array([slope[0].min(), slope[1].max(), azimuth[:, 0].min(), azimuth[:, 2].max()])


def _correlation(within: Float32, seen: Float32) -> Float32:
    """Correlation of ``seen`` (h, w) with each part of ``within`` (H, W), both less the mean of each of their rows: the
    bands of mains light are no likeness, nor are floor and wall, which all parts show: (H - h + 1, W - w + 1)."""
    height, width = seen.shape
    own = seen - seen.mean(axis=1, keepdims=True)

    def sums(image: Float32 | Array, size: tuple[int, int]) -> Array:
        return np.asarray(cv2.boxFilter(image, cv2.CV_64F, size, anchor=(0, 0), normalize=False), np.float64)

    squares = sums(within * within, (width, height)) - sums(sums(within, (width, 1)) ** 2, (1, height)) / width
    rows, columns = within.shape[0] - height + 1, within.shape[1] - width + 1
    variance = np.maximum(squares[:rows, :columns], SEARCH.least_contrast**2 * own.size) * np.sum(own**2)
    return np.asarray(cv2.matchTemplate(within, own, cv2.TM_CCORR) / np.sqrt(variance), np.float32)


def _halvings(width: float) -> int:
    """Halvings of a frame ``width`` pixels wide until it is narrow enough."""
    return max(0, int(np.ceil(np.log2(width / SEARCH.width_px))))


def _shrunk(image: Image, times: float) -> Image:
    """``image`` (H, W) made smaller; by an integer, from whole pixels only."""
    rows, columns = (int(size / times) for size in image.shape)
    if times == int(times):
        image = image[: rows * int(times), : columns * int(times)]
    return np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
