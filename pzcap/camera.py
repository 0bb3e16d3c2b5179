"""The pan-zoom camera: head, lens and (pan, tilt, focal) to pixels, rays and derivatives.

All the geometry of a camera on a head stands here, once. A direction of the *head* frame is given by its azimuth ``a``
(positive to the left of the reference view) and its slope ``h`` (height over horizontal distance), the coordinates of
the cylinder of `pzcap.cylinder`: the vector ``(cos a, sin a, h)``. With ``alpha = a - pan`` it has camera coordinates

    X =  cos(roll) x + sin(roll) y          x = -sin(alpha)
    Y = -sin(roll) x + cos(roll) y          y =  sin(tilt) cos(alpha) - cos(tilt) h
    Z =  z                                  z =  cos(tilt) cos(alpha) + sin(tilt) h

which is ``(Rz(pan) Ry(-tilt) HEAD_R_CAM Rz(roll))^T`` times the vector; the lens of `pzcap.types` takes it to a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.types import Array, Camera, Lens, PanZoomCamera

HEAD_R_CAM: Final[Array] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera axes in the head frame at pan, tilt and roll 0."""


ON_AXIS: Final[Array] = np.zeros(2)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What takes a direction of the head frame to a pixel: orientation on the head, and the lens at one zoom."""

    pan_rad: float
    tilt_rad: float
    roll_rad: float
    focal_px: float
    principal_px: Array  # (2,)
    k1: float


PARAMETERS: Final[tuple[str, ...]] = ("pan", "tilt", "log_focal", "roll", "principal_x", "principal_y", "k1")
"""Columns of `derivatives`."""


def lens_at(lens: Lens, focal_px: float) -> tuple[Array, float]:
    """Principal point (2,) in pixels and k1 of ``lens`` zoomed to ``focal_px``."""
    powers = np.log(focal_px / lens.reference_focal_px) ** np.arange(max(len(lens.principal_px), len(lens.k1)))
    return powers[: len(lens.principal_px)] @ lens.principal_px, float(powers[: len(lens.k1)] @ lens.k1)


def lens_slope(lens: Lens, focal_px: float) -> tuple[Array, float]:
    """Derivative of `lens_at` with respect to log focal: (2,) pixels, and k1."""
    order = max(len(lens.principal_px), len(lens.k1))
    powers = np.log(focal_px / lens.reference_focal_px) ** np.arange(order)
    slopes = np.concatenate([[0.0], np.arange(1, order) * powers[: order - 1]])
    return slopes[: len(lens.principal_px)] @ lens.principal_px, float(slopes[: len(lens.k1)] @ lens.k1)


def view_at(camera: PanZoomCamera, pan_rad: float, tilt_rad: float, focal_px: float) -> View:
    """The view of ``camera`` panned, tilted and zoomed."""
    principal_px, k1 = lens_at(camera.lens, focal_px)
    return View(pan_rad, tilt_rad, camera.roll_rad, focal_px, principal_px, k1)


def at(camera: PanZoomCamera, pan_rad: float, tilt_rad: float, focal_px: float) -> Camera:
    """The camera of an instant: ``world_T_cam = world_T_head Rz(pan) T(offset) Ry(-tilt) HEAD_R_CAM Rz(roll)``."""
    principal_px, k1 = lens_at(camera.lens, focal_px)
    world_T_cam = camera.world_T_head @ head_T_cam(pan_rad, tilt_rad, camera.roll_rad, camera.offset_m)
    return Camera(camera.lens.width, camera.lens.height, world_T_cam, focal_px, principal_px, k1)


def head_T_cam(pan_rad: float, tilt_rad: float, roll_rad: float, offset_m: Array = ON_AXIS) -> Array:
    """(4, 4) camera coordinates to head coordinates."""
    cos_p, sin_p = np.cos(pan_rad), np.sin(pan_rad)
    cos_t, sin_t = np.cos(tilt_rad), np.sin(tilt_rad)
    cos_r, sin_r = np.cos(roll_rad), np.sin(roll_rad)
    pan = np.array([[cos_p, -sin_p, 0.0], [sin_p, cos_p, 0.0], [0.0, 0.0, 1.0]])
    tilt = np.array([[cos_t, 0.0, -sin_t], [0.0, 1.0, 0.0], [sin_t, 0.0, cos_t]])
    roll = np.array([[cos_r, -sin_r, 0.0], [sin_r, cos_r, 0.0], [0.0, 0.0, 1.0]])
    transform = np.eye(4)
    transform[:3, :3] = pan @ tilt @ HEAD_R_CAM @ roll
    transform[:3, 3] = pan[:, :2] @ offset_m
    return transform


def mount(reference: Camera, lens: Lens, tilt_rad: float, roll_rad: float, offset_m: Array = ON_AXIS) -> PanZoomCamera:
    """The pan-zoom camera whose reference pose (pan 0) is ``reference``."""
    world_T_head = reference.world_T_cam @ np.linalg.inv(head_T_cam(0.0, tilt_rad, roll_rad, offset_m))
    return PanZoomCamera(lens, world_T_head, tilt_rad, roll_rad, offset_m)


# --------------------------------------------------------------------------------------------------------------
# Lens


def distort(xy: Array, k1: float) -> Array:
    """Normalised image coordinates (..., 2) as the lens bends them: ``(1 + k1 r^2) (x, y)``.

    Beyond the radius where that would fold back (barrel distortion, far outside any image) the factor stays what it
    is there, so that nothing out of view comes back into it.
    """
    squared = np.sum(xy * xy, axis=-1, keepdims=True)
    if k1 < 0:
        squared = np.minimum(squared, -1.0 / (3.0 * k1))
    return (1.0 + k1 * squared) * xy


def undistort(xy: Array, k1: float) -> Array:
    """The inverse of `distort` by Newton's method on the radius; (..., 2) to (..., 2)."""
    distorted = np.sqrt(np.sum(xy * xy, axis=-1, keepdims=True))
    if k1 < 0:
        distorted = np.minimum(distorted, 2.0 / 3.0 / np.sqrt(-3.0 * k1) * (1 - 1e-9))
    radius = distorted
    for _ in range(8):
        radius = radius - (radius * (1.0 + k1 * radius**2) - distorted) / (1.0 + 3.0 * k1 * radius**2)
    return xy / (1.0 + k1 * radius**2)


# --------------------------------------------------------------------------------------------------------------
# World points and rays


def project(camera: Camera, points_m: Array) -> tuple[Array, Array]:
    """World points (N, 3) to pixels (N, 2) and depths (N,) in metres along the optical axis.

    A point is seen where its depth is positive; behind the camera the pixel is meaningless but finite.
    """
    rotation, centre = camera.world_T_cam[:3, :3], camera.world_T_cam[:3, 3]
    seen = (points_m - centre) @ rotation
    depth = seen[:, 2]
    xy = seen[:, :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)[:, None]
    return camera.principal_px + camera.focal_px * distort(xy, camera.k1), depth


def rays(camera: Camera, points_px: Array) -> Array:
    """Pixels (N, 2) to unit directions in the world (N, 3)."""
    xy = undistort((points_px - camera.principal_px) / camera.focal_px, camera.k1)
    directions = np.column_stack([xy, np.ones(len(xy))]) @ camera.world_T_cam[:3, :3].T
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


# --------------------------------------------------------------------------------------------------------------
# Directions of the head frame


def see(view: View, azimuth_rad: Array, slope: Array) -> tuple[Array, Array]:
    """Directions (...) of the head frame to pixels (..., 2) and whether they are in front of the camera (...)."""
    xy, front = _normalised(view, azimuth_rad, slope)
    return view.principal_px + view.focal_px * distort(xy, view.k1), front


def look(view: View, points_px: Array) -> tuple[Array, Array]:
    """Pixels (..., 2) to directions of the head frame: azimuth (...) in (-pi, pi] around the pan, and slope (...)."""
    xy = undistort((points_px - view.principal_px) / view.focal_px, view.k1)
    cos_r, sin_r = np.cos(view.roll_rad), np.sin(view.roll_rad)
    cos_t, sin_t = np.cos(view.tilt_rad), np.sin(view.tilt_rad)
    x = cos_r * xy[..., 0] - sin_r * xy[..., 1]
    y = sin_r * xy[..., 0] + cos_r * xy[..., 1]
    forward = cos_t + sin_t * y
    left, up = -x, sin_t - cos_t * y
    return view.pan_rad + np.arctan2(left, forward), up / np.hypot(left, forward)


def derivatives(view: View, azimuth_rad: Array, slope: Array) -> tuple[Array, Array]:
    """Derivatives of `see` for directions (N,).

    Returns the derivatives with respect to ``PARAMETERS`` (N, 2, 7) and to (azimuth, slope) (N, 2, 2), in pixels
    per radian, per unit of log focal, per pixel and per unit of k1.
    """
    alpha = azimuth_rad - view.pan_rad
    cos_a, sin_a = np.cos(alpha), np.sin(alpha)
    cos_t, sin_t = np.cos(view.tilt_rad), np.sin(view.tilt_rad)
    cos_r, sin_r = np.cos(view.roll_rad), np.sin(view.roll_rad)
    y, z = sin_t * cos_a - cos_t * slope, cos_t * cos_a + sin_t * slope
    # d(x, y, z) before roll, one row a variable: azimuth, slope, tilt
    before = np.empty((len(alpha), 3, 3))
    before[:, 0] = np.column_stack([-cos_a, -sin_t * sin_a, -cos_t * sin_a])
    before[:, 1] = (0.0, -cos_t, sin_t)
    before[:, 2] = np.column_stack([np.zeros_like(y), z, -y])
    camera_x, camera_y = -cos_r * sin_a + sin_r * y, sin_r * sin_a + cos_r * y
    x_n, y_n = camera_x / z, camera_y / z
    turned_x = cos_r * before[:, :, 0] + sin_r * before[:, :, 1]
    turned_y = -sin_r * before[:, :, 0] + cos_r * before[:, :, 1]
    d_normalised = np.empty((len(alpha), 2, 4))  # azimuth, slope, tilt, roll
    d_normalised[:, 0, :3] = (turned_x - x_n[:, None] * before[:, :, 2]) / z[:, None]
    d_normalised[:, 1, :3] = (turned_y - y_n[:, None] * before[:, :, 2]) / z[:, None]
    d_normalised[:, 0, 3], d_normalised[:, 1, 3] = y_n, -x_n

    squared = x_n * x_n + y_n * y_n
    factor = 1.0 + view.k1 * squared
    lens = np.empty((len(alpha), 2, 2))  # d(distorted) / d(normalised)
    lens[:, 0, 0] = factor + 2.0 * view.k1 * x_n * x_n
    lens[:, 1, 1] = factor + 2.0 * view.k1 * y_n * y_n
    lens[:, 0, 1] = lens[:, 1, 0] = 2.0 * view.k1 * x_n * y_n
    d_pixel = view.focal_px * (lens @ d_normalised)

    result = np.zeros((len(alpha), 2, len(PARAMETERS)))
    result[:, :, 0] = -d_pixel[:, :, 0]
    result[:, :, 1] = d_pixel[:, :, 2]
    result[:, 0, 2], result[:, 1, 2] = view.focal_px * factor * x_n, view.focal_px * factor * y_n
    result[:, :, 3] = d_pixel[:, :, 3]
    result[:, 0, 4] = result[:, 1, 5] = 1.0
    result[:, 0, 6], result[:, 1, 6] = view.focal_px * squared * x_n, view.focal_px * squared * y_n
    return result, d_pixel[:, :, :2]


def pan_zoom_derivatives(camera: PanZoomCamera, view: View, azimuth_rad: Array, slope: Array) -> Array:
    """Derivatives (N, 2, 2) of pixels with respect to (pan, log focal), the lens changing with the zoom."""
    full, _ = derivatives(view, azimuth_rad, slope)
    principal, k1 = lens_slope(camera.lens, view.focal_px)
    result = np.empty((len(full), 2, 2))
    result[:, :, 0] = full[:, :, 0]
    result[:, :, 1] = full[:, :, 2] + principal + k1 * full[:, :, 6]
    return result


def parallax(alpha_rad: Array, slope: Array, inverse_distance: Array, offset_m: Array) -> tuple[Array, Array]:
    """What azimuth and slope (...) change by from the pan axis to a projection centre beside it.

    ``alpha_rad`` is the azimuth relative to the pan, ``inverse_distance`` (1 / m) that of what is seen, horizontally,
    ``offset_m`` (2,) how far the centre is forward and to the left of the axis. To first order: a few millimetres
    against metres.
    """
    forward, left = inverse_distance * offset_m[0], inverse_distance * offset_m[1]
    sin_a, cos_a = np.sin(alpha_rad), np.cos(alpha_rad)
    return forward * sin_a - left * cos_a, slope * (forward * cos_a + left * sin_a)


def moved(view: View, step: Array) -> View:
    """``view`` after adding ``step`` (7,) in the order of ``PARAMETERS``."""
    return View(
        view.pan_rad + float(step[0]),
        view.tilt_rad + float(step[1]),
        view.roll_rad + float(step[3]),
        view.focal_px * float(np.exp(step[2])),
        view.principal_px + step[4:6],
        view.k1 + float(step[6]),
    )


def _normalised(view: View, azimuth_rad: Array, slope: Array) -> tuple[Array, Array]:
    """Directions to normalised image coordinates before distortion (..., 2) and whether they are in front (...)."""
    alpha = azimuth_rad - view.pan_rad
    cos_a, sin_a = np.cos(alpha), np.sin(alpha)
    cos_t, sin_t = np.cos(view.tilt_rad), np.sin(view.tilt_rad)
    cos_r, sin_r = np.cos(view.roll_rad), np.sin(view.roll_rad)
    y, z = sin_t * cos_a - cos_t * slope, cos_t * cos_a + sin_t * slope
    front = z > 1e-6
    safe = np.where(front, z, 1.0)
    return np.stack([(-cos_r * sin_a + sin_r * y) / safe, (sin_r * sin_a + cos_r * y) / safe], axis=-1), front
