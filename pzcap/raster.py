"""Where the skin stands in a view, and what of it is seen: projection, z-buffer, depth test, sampling."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.types import Array

Float32 = NDArray[np.float32]


@njit(cache=True, nogil=True)
def project(
    points: Array, world_T_cam: Array, focal: float, principal: Array, k1: float, pixels: Array, depth: Array
) -> None:
    """Pixels (N, 2) and depth (N,) of world points (N, 3). Points behind the camera get a depth of -1."""
    for n in range(len(points)):
        dx = points[n, 0] - world_T_cam[0, 3]
        dy = points[n, 1] - world_T_cam[1, 3]
        dz = points[n, 2] - world_T_cam[2, 3]
        z = world_T_cam[0, 2] * dx + world_T_cam[1, 2] * dy + world_T_cam[2, 2] * dz
        if z < 0.1:
            depth[n] = -1.0
            pixels[n, 0] = 0.0
            pixels[n, 1] = 0.0
            continue
        x = (world_T_cam[0, 0] * dx + world_T_cam[1, 0] * dy + world_T_cam[2, 0] * dz) / z
        y = (world_T_cam[0, 1] * dx + world_T_cam[1, 1] * dy + world_T_cam[2, 1] * dz) / z
        scale = focal * (1.0 + k1 * (x * x + y * y))
        pixels[n, 0] = principal[0] + scale * x
        pixels[n, 1] = principal[1] + scale * y
        depth[n] = z


@njit(cache=True, nogil=True)
def bounds(pixels: Array, depth: Array, out: Array) -> None:
    """Least and greatest column and row, ``out`` (4,) = left, top, right, bottom, of the points before the camera.

    Without any, right is left of left.
    """
    out[0], out[1], out[2], out[3] = np.inf, np.inf, -np.inf, -np.inf
    for n in range(len(depth)):
        if depth[n] > 0.0:
            out[0] = min(out[0], pixels[n, 0])
            out[1] = min(out[1], pixels[n, 1])
            out[2] = max(out[2], pixels[n, 0])
            out[3] = max(out[3], pixels[n, 1])


@njit(cache=True, nogil=True)
def pixel_gradient(point: Array, world_T_cam: Array, focal: float, k1: float, du: float, dv: float, out: Array) -> None:
    """Gradient (3,) with respect to a world point of the function whose gradient in the image is ``(du, dv)``."""
    dx = point[0] - world_T_cam[0, 3]
    dy = point[1] - world_T_cam[1, 3]
    dz = point[2] - world_T_cam[2, 3]
    z = world_T_cam[0, 2] * dx + world_T_cam[1, 2] * dy + world_T_cam[2, 2] * dz
    x = (world_T_cam[0, 0] * dx + world_T_cam[1, 0] * dy + world_T_cam[2, 0] * dz) / z
    y = (world_T_cam[0, 1] * dx + world_T_cam[1, 1] * dy + world_T_cam[2, 1] * dz) / z
    r2 = x * x + y * y
    # d(u, v)/d(x, y) of the lens, then d(x, y)/d(camera point)
    along = focal * (1.0 + k1 * r2)
    gx = du * (along + 2.0 * focal * k1 * x * x) + dv * (2.0 * focal * k1 * x * y)
    gy = dv * (along + 2.0 * focal * k1 * y * y) + du * (2.0 * focal * k1 * x * y)
    a = gx / z
    b = gy / z
    c = -(gx * x + gy * y) / z
    for k in range(3):
        out[k] = world_T_cam[k, 0] * a + world_T_cam[k, 1] * b + world_T_cam[k, 2] * c


@njit(cache=True, nogil=True)
def rasterise(
    pixels: Array,
    depth: Array,
    faces: NDArray[np.int64],
    group: NDArray[np.uint8],
    left: int,
    top: int,
    scale: float,
    z_buffer: Float32,
    cover: NDArray[np.uint8],
) -> None:
    """Nearest depth at every pixel of a window, infinity where there is no body; and in ``cover`` the bits of all the
    parts of the body that lie there, ``group`` (V,) holding that of each point.

    Pixel ``(i, j)`` of the window stands at ``(left, top) + (j, i) * scale`` of the image. Depth is interpolated
    linearly over a triangle, which for triangles of centimetres seen from metres is exact to a millimetre.
    """
    height, width = z_buffer.shape
    z_buffer[:] = np.inf
    cover[:] = 0
    for f in range(len(faces)):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        if depth[i0] < 0 or depth[i1] < 0 or depth[i2] < 0:
            continue
        x0 = (pixels[i0, 0] - left) / scale
        y0 = (pixels[i0, 1] - top) / scale
        x1 = (pixels[i1, 0] - left) / scale
        y1 = (pixels[i1, 1] - top) / scale
        x2 = (pixels[i2, 0] - left) / scale
        y2 = (pixels[i2, 1] - top) / scale
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area >= -1e-9:  # image y points down: a face seen from outside runs clockwise in these coordinates
            continue
        column0 = max(int(np.ceil(min(x0, x1, x2))), 0)
        column1 = min(int(np.floor(max(x0, x1, x2))), width - 1)
        row0 = max(int(np.ceil(min(y0, y1, y2))), 0)
        row1 = min(int(np.floor(max(y0, y1, y2))), height - 1)
        for row in range(row0, row1 + 1):
            for column in range(column0, column1 + 1):
                w1 = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
                w2 = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
                if w1 < -1e-9 or w2 < -1e-9 or w1 + w2 > 1.0 + 1e-9:
                    continue
                cover[row, column] |= group[i0]
                z = depth[i0] + w1 * (depth[i1] - depth[i0]) + w2 * (depth[i2] - depth[i0])
                if z < z_buffer[row, column]:
                    z_buffer[row, column] = z


@njit(cache=True, nogil=True)
def visible(
    points: Array,
    normals: Array,
    pixels: Array,
    depth: Array,
    centre: Array,
    z_buffer: Float32,
    left: int,
    top: int,
    scale: float,
    tolerance: float,
    facing: Float32,
) -> None:
    """Cosine between normal and ray of every point that the camera at ``centre`` sees, 0 for the hidden ones."""
    height, width = z_buffer.shape
    for n in range(len(points)):
        facing[n] = 0.0
        if depth[n] < 0:
            continue
        column = int(np.rint((pixels[n, 0] - left) / scale))
        row = int(np.rint((pixels[n, 1] - top) / scale))
        if column < 0 or row < 0 or column >= width or row >= height:
            continue
        if depth[n] > z_buffer[row, column] + tolerance:
            continue
        dx = centre[0] - points[n, 0]
        dy = centre[1] - points[n, 1]
        dz = centre[2] - points[n, 2]
        cosine = (dx * normals[n, 0] + dy * normals[n, 1] + dz * normals[n, 2]) / np.sqrt(dx * dx + dy * dy + dz * dz)
        if cosine > 0.0:
            facing[n] = cosine


@njit(cache=True, nogil=True, inline="always")
def bilinear(image: Float32, x: float, y: float) -> float:
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    upper = image[row, column] * (1.0 - fx) + image[row, column + 1] * fx
    lower = image[row + 1, column] * (1.0 - fx) + image[row + 1, column + 1] * fx
    return upper * (1.0 - fy) + lower * fy


@njit(cache=True, nogil=True)
def sample(image: Float32, left: float, top: float, scale: float, pixels: Array, out: Float32) -> None:
    """Image values (N,) at full-resolution pixels (N, 2); negative where outside the window."""
    height, width = image.shape
    for n in range(len(pixels)):
        x = (pixels[n, 0] - left) / scale
        y = (pixels[n, 1] - top) / scale
        if x < 1.0 or y < 1.0 or x >= width - 2.0 or y >= height - 2.0:
            out[n] = -1.0
        else:
            out[n] = bilinear(image, x, y)
