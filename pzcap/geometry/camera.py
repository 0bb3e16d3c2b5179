"""The pan-zoom camera: head, lens and (pan, tilt, focal) to pixels, rays and derivatives.

All the geometry of a camera on a head stands here, once. A direction of the *head* frame is given by its azimuth ``a``
(positive to the left of the reference view) and its slope ``h`` (height over horizontal distance), the coordinates of
the cylinder (`pzcap.geometry.cylinder`): the vector ``(cos a, sin a, h)``. With ``alpha = a - pan`` it is in the camera

    X =  cos(roll) x + sin(roll) y          x = -sin(alpha)
    Y = -sin(roll) x + cos(roll) y          y =  sin(tilt) cos(alpha) - cos(tilt) h
    Z =  z                                  z =  cos(tilt) cos(alpha) + sin(tilt) h

which is ``(Rz(pan) Ry(-tilt) HEAD_R_CAM Rz(roll))^T`` times the vector; the lens of `pzcap.types` takes it to a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numba import njit
from numba.extending import register_jitable
from scipy.spatial.transform import Rotation

from pzcap.geometry import lens
from pzcap.geometry.lens import Distortion, by_coefficients, distort_point, jacobian_at, undistort_point
from pzcap.types import Array, Camera, Localisation, PanZoomCamera, PanZoomTrack

HEAD_R_CAM: Final[Array] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera axes in the head frame at pan, tilt and roll 0."""

ON_AXIS: Final[Array] = np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera on its head at one instant, and its lens at one zoom: it takes a direction to a pixel."""

    pan_rad: float
    tilt_rad: float
    roll_rad: float
    focal_px: float
    principal_px: Array  # (2,)
    distortion: Distortion
    centre_m: Array = field(default_factory=lambda: ON_AXIS)  # (3,) of projection: forward, left, up from the pan axis

    def vector(self) -> Array:
        """(VIEW + 7,) the view as `direction_to_pixel_with_derivatives` takes it: after k2, p1 and p2 come cosine and
        sine of tilt and of roll, which kernels would else compute for every pixel."""
        return np.array([
            self.pan_rad, self.tilt_rad, self.focal_px, self.roll_rad, *self.principal_px, self.distortion.k1,
            *self.centre_m, *self.distortion[1:],
            np.cos(self.tilt_rad), np.sin(self.tilt_rad), np.cos(self.roll_rad), np.sin(self.roll_rad),
        ])  # fmt: skip


VIEW: Final = 10
"""Numbers of `View.vector` that calibration takes derivatives by: from the pan to the projection centre."""
PARAMETERS: Final[tuple[str, ...]] = ("pan", "tilt", "log_focal", "roll", "principal_x", "principal_y", "k1")
"""Columns of `derivatives`."""


def view_at(camera: PanZoomCamera, pan_rad: float, tilt_rad: float, focal_px: float, rolled_rad: float = 0.0) -> View:
    """The view of ``camera`` panned, tilted and zoomed, and rolled beyond its own roll."""
    principal_px, distortion = lens.at(camera.lens, focal_px)
    travel_m = camera.travel_m * np.log(focal_px / camera.lens.reference_focal_px)
    centre_m = centre(camera.offset_m, travel_m, tilt_rad)
    return View(pan_rad, tilt_rad, camera.roll_rad + rolled_rad, focal_px, principal_px, distortion, centre_m)


def centre(offset: Array, travel: float, tilt_rad: float) -> Array:
    """(3,) the projection centre: beside the pan axis by ``offset`` (2,), and ``travel`` on along the optical axis."""
    return np.array([offset[0] + travel * np.cos(tilt_rad), offset[1], travel * np.sin(tilt_rad)])


def at(camera: PanZoomCamera, pan_rad: float, tilt_rad: float, focal_px: float, rolled_rad: float = 0.0) -> Camera:
    """The camera of an instant, rolled beyond its own roll:
    ``world_T_cam = world_T_head Rz(pan) T(centre) Ry(-tilt) HEAD_R_CAM Rz(roll)``."""
    view = view_at(camera, pan_rad, tilt_rad, focal_px, rolled_rad)
    world_T_cam = camera.world_T_head @ head_T_cam(pan_rad, tilt_rad, view.roll_rad, view.centre_m)
    size = camera.lens.width, camera.lens.height
    return Camera(*size, world_T_cam, focal_px, view.principal_px, *view.distortion)


def of_track(camera: PanZoomCamera, track: PanZoomTrack, frame: int) -> Camera:
    """The ``camera`` in a frame of its ``track``, where that is valid."""
    place = (track.pan_rad[frame], track.tilt_rad[frame], track.focal_px[frame], track.roll_rad[frame])
    return at(camera, *map(float, place))


def of_frame(camera: PanZoomCamera, found: Localisation) -> Camera:
    """The ``camera`` in the middle row of a frame that was ``found``."""
    return at(camera, found.pan_rad, found.tilt_rad, found.focal_px, found.roll_rad)


def head_T_cam(pan_rad: float, tilt_rad: float, roll_rad: float, centre_m: Array = ON_AXIS) -> Array:
    """(4, 4) camera coordinates to head coordinates; ``centre_m`` (3,) as in `View`."""
    vectors = np.array([[0.0, 0.0, pan_rad], [0.0, -tilt_rad, 0.0], [0.0, 0.0, roll_rad]])
    pan, tilt, roll = Rotation.from_rotvec(vectors).as_matrix()
    transform = np.eye(4)
    transform[:3, :3] = pan @ tilt @ HEAD_R_CAM @ roll
    transform[:3, 3] = pan @ centre_m
    return transform


def mount(reference: Camera, camera: PanZoomCamera) -> PanZoomCamera:
    """``camera``, its head put where its reference pose (pan 0) is ``reference``."""
    view = view_at(camera, 0.0, camera.tilt_rad, reference.focal_px)
    there = head_T_cam(0.0, camera.tilt_rad, camera.roll_rad, view.centre_m)
    return replace(camera, world_T_head=reference.world_T_cam @ np.linalg.inv(there))


# --------------------------------------------------------------------------------------------------------------
# World points and rays


def project(camera: Camera, points_m: Array) -> tuple[Array, Array]:
    """World points (N, 3) to pixels (N, 2) and depths (N,) in metres along the optical axis. Where the depth is not
    positive, behind the camera, the pixel is meaningless but finite."""
    rotation, centre = camera.world_T_cam[:3, :3], camera.world_T_cam[:3, 3]
    seen = (points_m - centre) @ rotation
    depth = seen[:, 2]
    xy = seen[:, :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)[:, None]
    return camera.principal_px + camera.focal_px * lens.distort(xy, lens.of(camera)), depth


def rays(camera: Camera, points_px: Array) -> Array:
    """Pixels (N, 2) to unit directions in the world (N, 3)."""
    xy = lens.undistort((points_px - camera.principal_px) / camera.focal_px, lens.of(camera))
    directions = np.column_stack([xy, np.ones(len(xy))]) @ camera.world_T_cam[:3, :3].T
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


# --------------------------------------------------------------------------------------------------------------
# Directions of the head frame


def wrapped(angle_rad: Array | float) -> Array:
    """Angles brought into [-pi, pi)."""
    return np.asarray(np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi)


def direction_to_pixel(view: View, azimuth_rad: Array, slope: Array) -> tuple[Array, Array]:
    """Directions (...) of the head frame to pixels (..., 2) and whether they are in front of the camera (...)."""
    xy, front = _normalised(view, azimuth_rad, slope)
    return view.principal_px + view.focal_px * lens.distort(xy, view.distortion), front


def pixel_to_direction(view: View, points_px: Array) -> tuple[Array, Array]:
    """Pixels (..., 2) to directions of the head frame: azimuth (...) in (-pi, pi] around the pan, and slope (...)."""
    xy = lens.undistort((points_px - view.principal_px) / view.focal_px, view.distortion)
    tilt, roll = view.tilt_rad, view.roll_rad
    azimuth, slope = _direction(xy[..., 0], xy[..., 1], np.cos(tilt), np.sin(tilt), np.cos(roll), np.sin(roll))
    return view.pan_rad + azimuth, slope


@register_jitable
def _direction(x: Any, y: Any, cos_t: float, sin_t: float, cos_r: float, sin_r: float) -> tuple[Any, Any]:
    """Azimuth from the pan, and slope, of undistorted coordinates; of numbers in kernels and of arrays."""
    left, down = -(cos_r * x - sin_r * y), sin_r * x + cos_r * y
    forward, up = cos_t + sin_t * down, sin_t - cos_t * down
    return np.arctan2(left, forward), up / np.sqrt(forward * forward + left * left)


def derivatives(view: View, azimuth_rad: Array, slope: Array) -> tuple[Array, Array]:
    """Derivatives of `direction_to_pixel` for directions (N,) by ``PARAMETERS`` (N, 2, 7) and by (azimuth, slope)
    (N, 2, 2): pixels per radian, per unit of log focal, per pixel and per unit of k1."""
    seen = np.empty((len(azimuth_rad), 2, SEEN))
    _see_all(view.vector(), azimuth_rad, slope, seen)
    return seen[:, :, BY_PARAMETERS], seen[:, :, BY_DIRECTION]


SEEN: Final = 13
BY_PARAMETERS: Final = slice(1, 8)
BY_DIRECTION: Final = slice(8, 10)
HIGHER: Final = 3
"""`direction_to_pixel_with_derivatives` writes SEEN columns for each coordinate: the pixel (0), its derivatives by
PARAMETERS, by azimuth and slope, and last by the HIGHER coefficients of the lens: k2, p1 and p2."""


@njit(cache=True, nogil=True)
def direction_to_pixel_with_derivatives(view: Array, azimuth: float, slope: float, seen: Array) -> None:
    """`direction_to_pixel` and its derivatives for one direction in front of the camera, into ``seen`` (2, SEEN). For
    other kernels; ``view`` is `View.vector`."""
    pan, _, focal, _, principal_x, principal_y, k1 = view[:7]
    k2, p1, p2, cos_t, sin_t, cos_r, sin_r = view[VIEW:]
    distortion = Distortion(k1, k2, p1, p2)
    cos_a, sin_a = np.cos(azimuth - pan), np.sin(azimuth - pan)
    y, z = sin_t * cos_a - cos_t * slope, cos_t * cos_a + sin_t * slope
    x_n, y_n = (-cos_r * sin_a + sin_r * y) / z, (sin_r * sin_a + cos_r * y) / z
    x_d, y_d = distort_point(x_n, y_n, distortion)
    lens_xx, lens_xy, lens_yy = jacobian_at(x_n, y_n, distortion)
    lens_xx, lens_xy, lens_yy = focal * lens_xx, focal * lens_xy, focal * lens_yy
    k1_x, k1_y, squared, p1_x, p1_y, p2_x = by_coefficients(x_n, y_n)

    seen[0, 0], seen[1, 0] = principal_x + focal * x_d, principal_y + focal * y_d
    # d(x, y, z) before roll by azimuth, slope and tilt, where they go among the columns of ``seen``
    for column, d_x, d_y, d_z in (
        (8, -cos_a, -sin_t * sin_a, -cos_t * sin_a), (9, 0.0, -cos_t, sin_t), (2, 0.0, z, -y)
    ):  # fmt: skip
        d_x_n = (cos_r * d_x + sin_r * d_y - x_n * d_z) / z
        d_y_n = (-sin_r * d_x + cos_r * d_y - y_n * d_z) / z
        seen[0, column] = lens_xx * d_x_n + lens_xy * d_y_n
        seen[1, column] = lens_xy * d_x_n + lens_yy * d_y_n
    for row, along, bent, by_k1, by_p1, by_p2 in (
        (0, lens_xx * y_n - lens_xy * x_n, x_d, k1_x, p1_x, p2_x),
        (1, lens_xy * y_n - lens_yy * x_n, y_d, k1_y, p1_y, p1_x),
    ):  # fmt: skip
        seen[row, 1] = -seen[row, 8]  # pan
        seen[row, 3] = focal * bent  # log focal
        seen[row, 4] = along  # roll
        seen[row, 5], seen[row, 6] = 1.0 - row, float(row)  # principal point
        seen[row, 7] = focal * by_k1  # k1
        seen[row, 10], seen[row, 11], seen[row, 12] = focal * squared * by_k1, focal * by_p1, focal * by_p2


@njit(cache=True, nogil=True)
def pixel_to_direction_kernel(view: Array, u: float, v: float) -> tuple[float, float]:
    """`pixel_to_direction` for one pixel: azimuth and slope. For other kernels; ``view`` is `View.vector`."""
    pan, _, focal, _, principal_x, principal_y, k1 = view[:7]
    k2, p1, p2, cos_t, sin_t, cos_r, sin_r = view[VIEW:]
    x, y = undistort_point((u - principal_x) / focal, (v - principal_y) / focal, Distortion(k1, k2, p1, p2), 3)
    azimuth, slope = _direction(x, y, cos_t, sin_t, cos_r, sin_r)
    return pan + azimuth, slope


@njit(cache=True, nogil=True)
def _see_all(view: Array, azimuth: Array, slope: Array, seen: Array) -> None:
    for n in range(len(azimuth)):
        direction_to_pixel_with_derivatives(view, azimuth[n], slope[n], seen[n])


def pan_zoom_derivatives(camera: PanZoomCamera, view: View, azimuth_rad: Array, slope: Array) -> Array:
    """Derivatives (N, 2, 3) of pixels with respect to (pan, log focal, tilt), the lens changing with the zoom."""
    full, _ = derivatives(view, azimuth_rad, slope)
    principal, by_log_focal = lens.slope(camera.lens, view.focal_px)
    xy, _ = _normalised(view, azimuth_rad, slope)
    bending = view.focal_px * (lens.jacobian_by_coefficients(xy) @ np.array(by_log_focal))
    return np.stack([full[:, :, 0], full[:, :, 2] + principal + bending, full[:, :, 1]], axis=-1)


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
