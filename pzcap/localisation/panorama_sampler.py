"""Where the pixels of a frame look, and what the panorama shows there.

For `pzcap.localisation.photometric_alignment` with derivatives: a ray is computed once a focal length and tilt, and
then carried on linearly, while pans move it along the panorama as it is. For silhouettes the whole empty hall
(`warp_background`).
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from pzcap.geometry import camera as geometry
from pzcap.geometry import lens
from pzcap.geometry.cylinder import NODES, Hall, kernel_hall, near_at, smooth_map, to_unwrapped
from pzcap.geometry.lens import Distortion, distort_point, jacobian_at, undistort_point
from pzcap.imaging.bspline import Stored, box, cubic
from pzcap.types import Array, Image, Mask, Panorama, PanZoomCamera

VALUE, BY_PAN, BY_LOG_FOCAL, BY_TILT, KNOWN, COLUMN = range(6)
"""Columns of what is sampled: the panorama's grey, how it changes with pan, log focal and tilt at a fixed pixel of the
frame, 1 where the panorama is known, and the panorama's column and (6) row there."""

Window = tuple[int, int, int, int]
"""Part of a view: left, top, right, bottom; the last two lie outside."""


def warp_background(
    panorama: Panorama,
    camera: PanZoomCamera,
    pan_rad: float,
    tilt_rad: float,
    focal_px: float,
    window: Window | None = None,
) -> tuple[Image, Mask]:
    """The empty hall as ``camera`` sees it, (H, W, 3), and where the panorama knows it, (H, W).

    Where it does not, the image is black. With a ``window``, that part of the view alone.
    """
    left, top, right, bottom = window or (0, 0, camera.lens.width, camera.lens.height)

    def to_panorama(points_px: Array) -> Array:
        pixels = points_px.reshape(-1, 2) + np.array([left, top])
        azimuth, slope = looking(panorama, camera, pixels, pan_rad, tilt_rad, focal_px)[:, :2].T
        return to_unwrapped(panorama, pan_rad + azimuth, slope).reshape(points_px.shape)

    column, row = smooth_map(to_panorama, right - left, bottom - top)
    border = cv2.BORDER_WRAP if panorama.full_turn else cv2.BORDER_CONSTANT
    image = cv2.remap(panorama.image, column, row, cv2.INTER_LINEAR, borderMode=border)
    known = cv2.remap(panorama.valid.view(np.uint8), column, row, cv2.INTER_NEAREST, borderMode=border)
    # BORDER_WRAP wraps rows as well, and a cylinder does not
    inside = cv2.inRange(row, 0.0, float(panorama.image.shape[0] - 1))
    known = cv2.bitwise_and(known, inside)
    return np.asarray(cv2.bitwise_and(image, image, mask=known), np.uint8), known.view(np.bool_)


def looking(
    panorama: Panorama, camera: PanZoomCamera, points: Array, pan_rad: float, tilt_rad: float, focal_px: float
) -> Array:
    """(N, 6) where ``points`` (N, 2) of a frame look, as `directions` has it."""
    principal, distortion = lens.at(camera.lens, focal_px)
    principal_slope, by_log_focal = lens.slope(camera.lens, focal_px)
    view = np.array([tilt_rad, camera.roll_rad, focal_px, *principal, *principal_slope])
    beside = np.array([pan_rad, *geometry.view_at(camera, pan_rad, tilt_rad, focal_px).centre_m])
    return directions(points, view, distortion, by_log_focal, beside, kernel_hall(panorama.surroundings))


def boxes(camera: PanZoomCamera, points: Array, focal_px: float) -> Array:
    """(N, 2) half of the azimuths and of the slopes that the pixels at ``points`` (N, 2) of a frame cover.

    Roll, tilt and distortion are slight, and left out.
    """
    secant = np.hypot(1.0, (points[:, 0] - lens.at(camera.lens, focal_px)[0][0]) / focal_px)
    return np.asarray(np.stack([0.5 / secant**2, 0.5 / secant], axis=1) / focal_px)


@njit(cache=True, nogil=True, error_model="numpy")
def directions(
    points: Array, view: Array, distortion: Distortion, by_log_focal: Distortion, beside: Array, hall: Hall
) -> Array:
    """`camera.pixel_to_direction` for points (N, 2), at pan 0, as seen from the pan axis: (N, 6) azimuth and slope, and
    both by log focal, and both by tilt.

    ``view``: tilt, roll, focal length, principal point, and the latter's derivative by log focal; ``by_log_focal`` is
    that of the ``distortion``. ``beside``: pan, the projection centre beside the axis.
    """
    tilt, roll, focal, principal_x, principal_y, slope_x, slope_y = view
    cos_t, sin_t, cos_r, sin_r = np.cos(tilt), np.sin(tilt), np.cos(roll), np.sin(roll)
    pan, offset_x, offset_y, offset_z = beside
    nodes, shares = np.empty(NODES, np.int64), np.empty(NODES)
    out = np.empty((len(points), 6))
    by_focal = 1.0 / focal
    for n in range(len(points)):  # divisions are what takes the time here
        bent_x, bent_y = (points[n, 0] - principal_x) * by_focal, (points[n, 1] - principal_y) * by_focal
        x, y = undistort_point(bent_x, bent_y, distortion, 2)
        # the fixed pixel's ray as log focal grows: the lens's Jacobian^-1 (d bent - d coefficients)
        drift_x, drift_y = distort_point(x, y, by_log_focal)
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
        near = near_at(hall, pan + azimuth, slope, nodes, shares) if len(hall[1]) else 0.0
        to_x, to_y = near * offset_x, near * offset_y
        cos_a, sin_a = forward * by_level, left * by_level
        out[n, 0] = azimuth - to_x * sin_a + to_y * cos_a
        out[n, 1] = slope * (1.0 - to_x * cos_a - to_y * sin_a) + near * offset_z
        out[n, 2] = (forward * d_left - left * d_forward) * by_across
        out[n, 3] = (d_up - up * (forward * d_forward + left * d_left) * by_across) * by_level
        # tilting turns the ray's (forward, up) by itself
        out[n, 4] = left * up * by_across
        out[n, 5] = forward * (1.0 + up * up * by_across) * by_level
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def sample(image: Stored, known: Mask, directions: Array, change: Array, place: Array, half: Array) -> Array:
    """Samples of the image and their derivatives along directions (N, 6), `directions`, which have changed by
    ``change`` in log focal and tilt.

    ``place``: panorama column of the pan, row of slope 0, pixels to the radian, and how many of them make one of the
    image's across and down. ``half`` (N, 2): half of what a pixel covers of the image, across and down, if that is made
    of cells; empty: it is a spline. The columns of the result are VALUE and so on.
    """
    column_0, row_0, per_rad, scale_x, scale_y = place
    out = np.zeros((len(directions), 7))
    for n in range(len(directions)):
        azimuth, slope, azimuth_by_focal, slope_by_focal, azimuth_by_tilt, slope_by_tilt = directions[n]
        azimuth += azimuth_by_focal * change[0] + azimuth_by_tilt * change[1]
        slope += slope_by_focal * change[0] + slope_by_tilt * change[1]
        column, row = column_0 - azimuth * per_rad, row_0 - slope * per_rad
        out[n, COLUMN], out[n, COLUMN + 1] = column, row
        column, row = (column + 0.5) / scale_x, (row + 0.5) / scale_y
        if len(half):
            inside, value, by_column, by_row = box(image, column, row, half[n, 0], half[n, 1])
        else:
            inside, value, by_column, by_row = cubic(image, column - 0.5, row - 0.5)
        if not inside or not known[int(row), int(column)]:
            continue
        by_column *= -per_rad / scale_x
        by_row *= -per_rad / scale_y
        out[n, VALUE] = value
        out[n, BY_PAN] = by_column
        out[n, BY_LOG_FOCAL] = by_column * azimuth_by_focal + by_row * slope_by_focal
        out[n, BY_TILT] = by_column * azimuth_by_tilt + by_row * slope_by_tilt
        out[n, KNOWN] = 1.0
    return out
