"""Where a frame may be if its features do not say: the whole of it, shrunk, is correlated with the whole panorama.

Far from the sweep's zoom a frame is too small on the panorama for features to be found in it. A few dozen pixels across
are enough to tell it from every other place, and so few that all pans and zooms are tried in a tenth of a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pzcap.calibration.sweep import grey
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View, wrapped
from pzcap.types import Array, Image, Panorama, PanZoomCamera

ACROSS = 56  # pixels of the shrunk panorama that a frame is wide, at most; at least half as many
ZOOM_STEP = 0.05  # of log focal: edges of the nearest one are off by less than a pixel of these
CORRELATED = 0.4  # what correlates less is no place
FLAT = 1.0  # grey levels: a frame of less contrast shows nothing, and correlates with anything
PLACES = 3  # given, at most


@dataclass(frozen=True, slots=True)
class Place:
    """Where a frame may be."""

    pan_rad: float
    tilt_rad: float
    focal_px: float
    correlation: float


class Correlator:
    """Finds frames of one camera by correlation with its panorama, at focal lengths from one to another; with
    ``free_tilt`` at other tilts than the camera's, too."""

    def __init__(
        self, panorama: Panorama, camera: PanZoomCamera, focals_px: tuple[float, float], *, free_tilt: bool = False
    ) -> None:
        self._panorama = panorama
        self._camera = camera
        self._free_tilt = free_tilt
        self._focals = np.exp(np.arange(np.log(focals_px[0]), np.log(focals_px[1]), ZOOM_STEP))
        image = grey(panorama.image)
        image = np.where(panorama.valid, image, np.uint8(np.median(image[panorama.valid])))
        if panorama.full_turn:  # goes on beyond its end, so that no frame lies across a seam
            image = np.hstack([image, image[:, : image.shape[1] // 4]])
        widest = camera.lens.width * panorama.px_per_rad / focals_px[0]
        self._levels = [_shrunk(image, 2**halvings) for halvings in range(_halvings(widest) + 1)]

    def places(self, image: Image) -> list[Place]:
        """Those most like ``image`` (H, W[, 3]), the likeliest first; none where it is like no place at all."""
        frame = grey(image)
        found = [place for focal in self._focals if (place := self._at(frame, float(focal))) is not None]
        apart: list[Place] = []
        for place in sorted(found, key=lambda place: -place.correlation):
            near = self._camera.lens.width / 8 / place.focal_px
            if all(abs(wrapped(place.pan_rad - other.pan_rad)) > near for other in apart):
                apart.append(place)
        return apart[:PLACES]

    def _at(self, frame: Image, focal_px: float) -> Place | None:
        """The pan at which ``frame`` (H, W), if taken with a focal length, is most like the panorama."""
        panorama, camera = self._panorama, self._camera
        finer = focal_px / panorama.px_per_rad  # pixels of the frame to one of the panorama
        halvings = _halvings(camera.lens.width / finer)
        level, cell = self._levels[halvings], 2**halvings
        view = geometry.view_at(camera, 0.0, camera.tilt_rad, focal_px)
        top, bottom, left, right = self._box(view) * panorama.px_per_rad
        # columns count from azimuth 0, which the pan brings anywhere, rows from the top of the panorama
        columns = np.arange(np.ceil(-left / cell), np.floor(-right / cell) + 1)
        first, last = ((panorama.origin_px[1] - edge + 0.5) / cell - 0.5 for edge in (top, bottom))
        rows = np.arange(max(np.ceil(first), 0), min(np.floor(last), len(level) - 1) + 1)
        if min(len(rows), len(columns)) < ACROSS // 8 or len(columns) > level.shape[1]:
            return None
        slopes = (panorama.origin_px[1] - ((rows + 0.5) * cell - 0.5)) / panorama.px_per_rad
        azimuths = -columns * cell / panorama.px_per_rad
        pixels, _ = geometry.direction_to_pixel(view, *np.meshgrid(azimuths, slopes))
        small = _shrunk(frame, max(finer * cell, 1.0))
        scale = np.array(small.shape[::-1]) / np.array(frame.shape[::-1])
        pixels = ((pixels + 0.5) * scale - 0.5).astype(np.float32)
        seen = cv2.remap(small, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if seen.std() < FLAT:
            return None
        above = 0 if self._free_tilt else int(rows[0])
        within = level if self._free_tilt else level[above : above + len(rows)]
        likeness = cv2.matchTemplate(within, seen, cv2.TM_CCOEFF_NORMED)
        _, best, _, (column, row) = cv2.minMaxLoc(likeness)
        if best < CORRELATED:
            return None
        pan = (panorama.origin_px[0] - ((column - columns[0] + 0.5) * cell - 0.5)) / panorama.px_per_rad
        raised = (rows[0] - above - row) * cell / panorama.px_per_rad
        return Place(float(pan), float(np.arctan(np.tan(camera.tilt_rad) + raised)), focal_px, best)

    def _box(self, view: View) -> Array:
        """(4,) the slopes and azimuths between which ``view`` sees everything: top, bottom, left, right."""
        x, y = self._camera.lens.width - 1.0, self._camera.lens.height - 1.0
        points = np.array([[[0, 0], [x / 2, 0], [x, 0]], [[0, y], [x / 2, y], [x, y]]])
        azimuth, slope = geometry.pixel_to_direction(view, points)
        return np.array([slope[0].min(), slope[1].max(), azimuth[:, 0].min(), azimuth[:, 2].max()])


def _halvings(width: float) -> int:
    """How often so many pixels are halved until they are no more than ACROSS."""
    return max(0, int(np.ceil(np.log2(width / ACROSS))))


def _shrunk(image: Image, times: float) -> Image:
    """``image`` (H, W) so many times smaller; of whole times, whole pixels only."""
    rows, columns = (int(size / times) for size in image.shape)
    if times == int(times):
        image = image[: rows * int(times), : columns * int(times)]
    return np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
