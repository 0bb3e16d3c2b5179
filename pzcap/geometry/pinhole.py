"""The camera as compiled kernels take it: projection of world points, and its derivative.

A world point ``X`` is ``(x, y, z)`` in camera axes, ``cam_R_world (X - centre)``; its normalised coordinates
``(x / z, y / z)`` are bent by the lens (`pzcap.geometry.lens`) and scaled by the focal length to a pixel.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from pzcap.geometry.lens import Distortion, distort_point, jacobian_at
from pzcap.types import Array, Camera

Vector = tuple[float, float, float]


NEAREST_M: Final = 0.1  # depth from which on a point is before the camera


class Pinhole(NamedTuple):
    """A camera as plain numbers, which a loop keeps in registers."""

    rotation: tuple[float, float, float, float, float, float, float, float, float]
    """``cam_R_world``, row by row: the camera's axes x, y, z in the world."""
    centre: Vector  # world, metres
    focal: float
    principal: tuple[float, float]
    distortion: Distortion


@lru_cache(maxsize=64)  # a view's is asked for by every kernel
def pinhole(camera: Camera) -> Pinhole:
    """``camera`` for kernels."""
    (x0, y0, z0, c0), (x1, y1, z1, c1), (x2, y2, z2, c2), _ = camera.world_T_cam.tolist()
    rotation, centre = (x0, x1, x2, y0, y1, y2, z0, z1, z2), (c0, c1, c2)
    u, v = camera.principal_px.tolist()
    distortion = Distortion(float(camera.k1), float(camera.k2), float(camera.p1), float(camera.p2))
    return Pinhole(rotation, centre, float(camera.focal_px), (u, v), distortion)


@njit(cache=True, nogil=True, inline="always")
def ray(x: float, y: float, z: float, camera: Pinhole) -> Vector:
    """Normalised coordinates of a world point, across and down, and its depth."""
    r, c = camera.rotation, camera.centre
    dx, dy, dz = x - c[0], y - c[1], z - c[2]
    depth = r[6] * dx + r[7] * dy + r[8] * dz
    per_depth = 1.0 / depth
    return (r[0] * dx + r[1] * dy + r[2] * dz) * per_depth, (r[3] * dx + r[4] * dy + r[5] * dz) * per_depth, depth


@njit(cache=True, nogil=True)
def relative_to(frame: Array, camera: Pinhole) -> Pinhole:
    """The ``camera`` as it stands in a ``frame`` (4, 4), ``world_T_frame``: it takes points of that frame."""
    r, c = camera.rotation, camera.centre
    x, y, z = c[0] - frame[0, 3], c[1] - frame[1, 3], c[2] - frame[2, 3]
    ax, ay, az = frame[0, 0], frame[1, 0], frame[2, 0]  # the frame's axes in the world
    bx, by, bz = frame[0, 1], frame[1, 1], frame[2, 1]
    cx, cy, cz = frame[0, 2], frame[1, 2], frame[2, 2]
    rotation = (
        r[0] * ax + r[1] * ay + r[2] * az, r[0] * bx + r[1] * by + r[2] * bz, r[0] * cx + r[1] * cy + r[2] * cz,
        r[3] * ax + r[4] * ay + r[5] * az, r[3] * bx + r[4] * by + r[5] * bz, r[3] * cx + r[4] * cy + r[5] * cz,
        r[6] * ax + r[7] * ay + r[8] * az, r[6] * bx + r[7] * by + r[8] * bz, r[6] * cx + r[7] * cy + r[8] * cz,
    )  # fmt: skip
    centre = x * ax + y * ay + z * az, x * bx + y * by + z * bz, x * cx + y * cy + z * cz
    return Pinhole(rotation, centre, camera.focal, camera.principal, camera.distortion)


@njit(cache=True, nogil=True, inline="always")
def to_pixel(across: float, down: float, camera: Pinhole) -> tuple[float, float]:
    """Pixel of normalised coordinates."""
    x, y = distort_point(across, down, camera.distortion)
    return camera.principal[0] + camera.focal * x, camera.principal[1] + camera.focal * y


@njit(cache=True, nogil=True, inline="always")
def pixel_gradient(across: float, down: float, depth: float, camera: Pinhole, du: float, dv: float) -> Vector:
    """Gradient with respect to the world point that `ray` has at ``across, down, depth``, of a function whose gradient
    in the image is ``(du, dv)``."""
    r, (xx, xy, yy) = camera.rotation, jacobian_at(across, down, camera.distortion)
    gx, gy = camera.focal * (du * xx + dv * xy), camera.focal * (du * xy + dv * yy)
    a, b, c = gx / depth, gy / depth, -(gx * across + gy * down) / depth
    return r[0] * a + r[3] * b + r[6] * c, r[1] * a + r[4] * b + r[7] * c, r[2] * a + r[5] * b + r[8] * c


@njit(cache=True, nogil=True, error_model="numpy")
def project(points: Array, camera: Pinhole, pixels: Array, depth: Array) -> None:
    """Fill in ``pixels`` (N, 2) and ``depth`` (N,) of world ``points`` (N, 3). Behind the camera the depth is -1."""
    for n in range(len(points)):
        across, down, z = ray(points[n, 0], points[n, 1], points[n, 2], camera)
        u, v = to_pixel(across, down, camera)
        before = z >= NEAREST_M
        pixels[n, 0] = u if before else 0.0
        pixels[n, 1] = v if before else 0.0
        depth[n] = z if before else -1.0


def projected(points: Array, camera: Camera) -> tuple[Array, Array]:
    """Pixels (N, 2), a coordinate after the other in memory, and depth (N,) of world ``points`` (N, 3)."""
    pixels, depth = np.empty((len(points), 2), order="F"), np.empty(len(points))
    project(points, pinhole(camera), pixels, depth)
    return pixels, depth
