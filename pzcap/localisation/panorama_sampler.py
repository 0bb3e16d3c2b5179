"""Sampling of the panorama at the pixels of a frame.

`photometric_alignment` needs grey values with their derivatives (`PanoramaSampler`): a pixel's direction is computed
once a focal length and tilt, and then extrapolated linearly, while a pan shifts it along the panorama exactly.
`pzcap.segmentation` needs the whole empty hall (`warp_background`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numba import njit

from pzcap.geometry import camera as geometry
from pzcap.geometry import lens
from pzcap.geometry.camera import VIEW
from pzcap.geometry.cylinder import NODES, Hall, axis_direction, kernel_hall, smooth_map, to_unwrapped, whole_turns
from pzcap.geometry.lens import Distortion, distort_point, jacobian_at, undistort_point
from pzcap.imaging.bspline import Stored, cubic
from pzcap.imaging.colour import grey
from pzcap.imaging.pyramid import Level, halved
from pzcap.imaging.row_bands import row_time
from pzcap.localisation.tuning import ALIGNMENT, LEVELS
from pzcap.types import Array, Image, Localisation, Mask, Panorama, PanZoomCamera

VALUE, BY_PAN, BY_LOG_FOCAL, BY_TILT, BY_ROLL, BY_PAN_SHEAR, BY_ZOOM_SHEAR, KNOWN, COLUMN = range(9)
SAMPLE: Final = 10
"""Columns of samples (N, SAMPLE): the panorama's grey value, its derivatives by what `ViewPlace.stepped` steps at a
fixed pixel of the frame, 1 where the panorama is known, and the panorama's column and (9) row there."""

Window = tuple[int, int, int, int]  # part of a view: left, top, right, bottom; the last two lie outside


class ViewPlace(NamedTuple):
    """Place of a frame: pan, tilt and zoom of its middle row, and how its other rows depart from these.

    With a rolling shutter rows are exposed one after the other while the camera turns: row v of H has the pan
    ``pan_rad + pan_shear_rad tau`` and the log focal ``log(focal_px) + zoom_shear tau``, tau = (v + 1/2) / H - 1/2.
    """

    pan_rad: float
    tilt_rad: float
    focal_px: float
    roll_rad: float = 0.0  # beyond the camera's own
    pan_shear_rad: float = 0.0  # from the top edge to the bottom edge
    zoom_shear: float = 0.0  # of log focal

    def stepped(self, step: Array, largest_zoom: float) -> ViewPlace:
        """After a step of the first (2 to 6) of: pan, log focal, limited to ``largest_zoom``, tilt, roll, both
        shears."""
        zoom = float(np.exp(np.clip(step[1], -largest_zoom, largest_zoom)))
        tilt, roll, pan_shear, zoom_shear = np.pad(step[2:], (0, 6 - len(step))).tolist()
        return ViewPlace(
            self.pan_rad + float(step[0]), self.tilt_rad + tilt, self.focal_px * zoom, self.roll_rad + roll,
            self.pan_shear_rad + pan_shear, self.zoom_shear + zoom_shear,
        )  # fmt: skip


def place_of(found: Localisation) -> ViewPlace:
    """The place where a frame was found."""
    return ViewPlace(found.pan_rad, found.tilt_rad, found.focal_px, found.roll_rad, *found.shear.tolist())


def warp_background(
    panorama: Panorama, camera: PanZoomCamera, at: ViewPlace, window: Window | None = None, every: int = 1
) -> tuple[Image, Mask]:
    """The empty hall as ``camera`` sees it (H, W, 3) when all rows are exposed at once, black where the panorama does
    not know it, and a mask (H, W) of where it does. With a ``window``, of that part of the view alone; with ``every``,
    in pixels of so many of the view's, of a panorama that is as coarse."""
    left, top, right, bottom = window or (0, 0, camera.lens.width, camera.lens.height)
    pan_rad = at.pan_rad + float(whole_turns(panorama, at.pan_rad))

    def to_panorama(points_px: Array) -> Array:
        pixels = every * points_px.reshape(-1, 2) + 0.5 * (every - 1) + np.array([left, top])
        azimuth, slope = axis_directions(panorama, camera, pixels, at)[:, :2].T
        return to_unwrapped(panorama, pan_rad + azimuth, slope).reshape(points_px.shape)

    column, row = smooth_map(to_panorama, (right - left) // every, (bottom - top) // every)
    border = cv2.BORDER_WRAP if panorama.full_turn else cv2.BORDER_CONSTANT
    image = cv2.remap(panorama.image, column, row, cv2.INTER_LINEAR, borderMode=border)
    known = cv2.remap(panorama.valid.view(np.uint8), column, row, cv2.INTER_NEAREST, borderMode=border)
    # BORDER_WRAP wraps rows as well, and a cylinder does not
    known = cv2.bitwise_and(known, cv2.inRange(row, 0.0, float(panorama.image.shape[0] - 1)))
    return np.asarray(cv2.bitwise_and(image, image, mask=known), np.uint8), known.view(np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Directions of some pixels of a frame, with derivatives, at one pan, tilt and focal length."""

    at: ViewPlace
    directions: Array  # (N, 8) as in `axis_directions`
    row_time: Array  # (N,) as in `row_bands.row_time`

    def far_from(self, at: ViewPlace) -> bool:
        """True if the directions are not linear as far as ``at``."""
        return bool(max(np.abs(self.change_to(at))) > ALIGNMENT.linear)

    def change_to(self, at: ViewPlace) -> tuple[float, float, float]:
        """Change of log focal, of tilt and of roll."""
        zoomed = float(np.log(at.focal_px / self.at.focal_px))
        return zoomed, at.tilt_rad - self.at.tilt_rad, at.roll_rad - self.at.roll_rad


class PanoramaSampler:
    """Panorama of one camera in the resolutions of `LEVELS`; about ``pixels`` of a frame are compared on the finest."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, pixels: int) -> None:
        self._panorama = panorama
        self._camera = camera
        # a full turn goes on beyond its ends, so that no frame lies across a seam
        self.margin = panorama.image.shape[1] // 4 // 8 * 8 if panorama.full_turn else 0
        border = (0, 0, self.margin, self.margin, cv2.BORDER_WRAP)
        image = cv2.copyMakeBorder(grey(panorama.image), *border).astype(np.float32)
        known = cv2.copyMakeBorder(panorama.valid.astype(np.uint8), *border).astype(np.float32)
        self.px_per_rad = panorama.px_per_rad
        self.levels: list[Level] = [halved(image, known, level.halvings, level.pixels or pixels) for level in LEVELS]

    def rays(self, points: Array, at: ViewPlace) -> Rays:
        """Directions of ``points`` (N, 2) of a frame."""
        when = row_time(points[:, 1], self._camera.lens.height)
        return Rays(at, axis_directions(self._panorama, self._camera, points, at), when)

    def sample(self, level: Level, rays: Rays, at: ViewPlace) -> Array:
        """Samples (N, SAMPLE) of a ``level`` along ``rays`` (N), which are extrapolated to ``at``."""
        panorama = self._panorama
        pan_rad = at.pan_rad + float(whole_turns(panorama, at.pan_rad))
        column = panorama.origin_px[0] - pan_rad * panorama.px_per_rad
        if panorama.full_turn:
            column = np.mod(column, panorama.image.shape[1])
        origin = float(column) + self.margin, float(panorama.origin_px[1])
        change = *rays.change_to(at), at.pan_shear_rad, at.zoom_shear
        scale = panorama.px_per_rad, level.scale
        return _sample(level.image, level.known, rays.directions, rays.row_time, change, origin, scale)

    def panorama_px(self, samples: Array) -> Array:
        """Panorama pixels (N, 2) where ``samples`` (N, SAMPLE) were taken."""
        places = samples[:, COLUMN:] - np.array([self.margin, 0.0])
        if self._panorama.full_turn:
            places[:, 0] = np.mod(places[:, 0], self._panorama.image.shape[1])
        return np.asarray(places)


def axis_directions(panorama: Panorama, camera: PanZoomCamera, points: Array, at: ViewPlace) -> Array:
    """Directions (N, 8) of ``points`` (N, 2) of a frame, all exposed at once, relative to its pan, as they are seen
    from the pan axis: azimuth and slope, both by log focal, both by tilt, and both by roll."""
    view = geometry.view_at(camera, at.pan_rad, at.tilt_rad, at.focal_px, at.roll_rad)
    by_log_focal = lens.slope(camera.lens, at.focal_px)
    return _axis_directions(points, view.vector(), view.distortion, *by_log_focal, kernel_hall(panorama.surroundings))


@njit(cache=True, nogil=True, error_model="numpy")
def _axis_directions(
    points: Array, view: Array, distortion: Distortion, principal_slope: Array, distortion_slope: Distortion, hall: Hall
) -> Array:
    """`axis_directions`: `pzcap.geometry.camera.pixel_to_direction` at pan 0 with its derivatives, and the parallax.

    ``view`` is `View.vector`; slopes are derivatives of the lens by log focal.
    """
    pan, tilt, focal, roll, principal_x, principal_y = view[:6]
    slope_x, slope_y = principal_slope
    centre = view[VIEW - 3], view[VIEW - 2], view[VIEW - 1]
    cos_t, sin_t, cos_r, sin_r = np.cos(tilt), np.sin(tilt), np.cos(roll), np.sin(roll)
    nodes, shares = np.empty(NODES, np.int64), np.empty(NODES)
    out = np.empty((len(points), 8))
    by_focal = 1.0 / focal
    for n in range(len(points)):  # divisions are what takes the time here
        bent_x, bent_y = (points[n, 0] - principal_x) * by_focal, (points[n, 1] - principal_y) * by_focal
        x, y = undistort_point(bent_x, bent_y, distortion, 2)
        # the fixed pixel's ray as log focal grows: the lens's Jacobian^-1 (d bent - d coefficients)
        drift_x, drift_y = distort_point(x, y, distortion_slope)
        push_x = -bent_x - slope_x * by_focal - (drift_x - x)
        push_y = -bent_y - slope_y * by_focal - (drift_y - y)
        xx, xy, yy = jacobian_at(x, y, distortion)
        by_determinant = 1.0 / (xx * yy - xy * xy)
        d_x, d_y = (yy * push_x - xy * push_y) * by_determinant, (xx * push_y - xy * push_x) * by_determinant

        left, down = -(cos_r * x - sin_r * y), sin_r * x + cos_r * y
        d_left, d_down = -(cos_r * d_x - sin_r * d_y), sin_r * d_x + cos_r * d_y
        forward, up = cos_t + sin_t * down, sin_t - cos_t * down
        d_forward, d_up = sin_t * d_down, -cos_t * d_down
        by_across = 1.0 / (forward * forward + left * left)
        by_level = np.sqrt(by_across)
        azimuth, slope = np.arctan2(left, forward), up * by_level
        if len(hall[1]):
            toward = pan, forward * by_level, left * by_level
            azimuth, slope, _ = axis_direction(hall, azimuth, slope, toward, centre, nodes, shares)
        out[n, 0], out[n, 1] = azimuth, slope
        out[n, 2] = (forward * d_left - left * d_forward) * by_across
        out[n, 3] = (d_up - up * (forward * d_forward + left * d_left) * by_across) * by_level
        # tilting turns the ray's (forward, up) by itself
        out[n, 4] = left * up * by_across
        out[n, 5] = forward * (1.0 + up * up * by_across) * by_level
        # rolling turns (left, down) by itself: d_left = down, d_down = -left
        out[n, 6] = (forward * down + left * left * sin_t) * by_across
        out[n, 7] = (cos_t * left - up * left * (down - forward * sin_t) * by_across) * by_level
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(
    image: Stored, known: Mask, directions: Array, row_time: Array, change: tuple[float, float, float, float, float],
    origin: tuple[float, float], scales: tuple[float, float],
) -> Array:  # fmt: skip
    """Samples (N, SAMPLE) of a level along ``directions`` (N, 8), `axis_directions`, of pixels exposed at ``row_time``
    (N,), after a ``change`` of log focal, tilt and roll, and with a shear of pan and log focal. ``origin`` is the
    panorama's column of the pan, which may lie beyond its end, and row of slope 0; ``scales`` are the panorama's pixels
    to a radian, and to one of the level's."""
    px_per_rad, scale = scales
    zoomed, tilted, rolled, pan_shear, zoom_shear = change
    out = np.zeros((len(directions), SAMPLE))
    for n in range(len(directions)):
        azimuth, slope, azimuth_by_focal, slope_by_focal, azimuth_by_tilt, slope_by_tilt = directions[n, :6]
        azimuth_by_roll, slope_by_roll = directions[n, 6], directions[n, 7]
        zoom = zoomed + zoom_shear * row_time[n]
        azimuth += azimuth_by_focal * zoom + azimuth_by_tilt * tilted + azimuth_by_roll * rolled
        azimuth += pan_shear * row_time[n]
        slope += slope_by_focal * zoom + slope_by_tilt * tilted + slope_by_roll * rolled
        column, row = origin[0] - azimuth * px_per_rad, origin[1] - slope * px_per_rad
        out[n, COLUMN], out[n, COLUMN + 1] = column, row
        column, row = (column + 0.5) / scale, (row + 0.5) / scale
        inside, value, by_column, by_row = cubic(image, column - 0.5, row - 0.5)
        if not inside or not known[int(row), int(column)]:
            continue
        by_column *= -px_per_rad / scale
        by_row *= -px_per_rad / scale
        by_focal = by_column * azimuth_by_focal + by_row * slope_by_focal
        out[n, VALUE] = value
        out[n, BY_PAN] = by_column
        out[n, BY_LOG_FOCAL] = by_focal
        out[n, BY_TILT] = by_column * azimuth_by_tilt + by_row * slope_by_tilt
        out[n, BY_ROLL] = by_column * azimuth_by_roll + by_row * slope_by_roll
        out[n, BY_PAN_SHEAR] = by_column * row_time[n]
        out[n, BY_ZOOM_SHEAR] = by_focal * row_time[n]
        out[n, KNOWN] = 1.0
    return out
