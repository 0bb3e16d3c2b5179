"""Where the skin stands in a view, and what of it is seen: projection, z-buffer, depth test, sampling."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.types import Array, Float32, Image

Stand = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
Face = tuple[float, float, float, float, float, float, float, float, float, float]

FAR: Final = np.float32(np.inf)
NOTHING: Final = np.uint8(0)


@njit(cache=True, nogil=True, inline="always")
def stand(world_T_cam: Array) -> Stand:
    """A camera's axes x, y, z and its centre, in the world: twelve numbers that a loop has at hand."""
    m = world_T_cam
    return (m[0, 0], m[1, 0], m[2, 0], m[0, 1], m[1, 1], m[2, 1], m[0, 2], m[1, 2], m[2, 2], m[0, 3], m[1, 3], m[2, 3])


@njit(cache=True, nogil=True, inline="always")
def ray(x: float, y: float, z: float, camera: Stand) -> tuple[float, float, float]:
    """A world point seen from a camera: across and down over its depth, and its depth."""
    dx, dy, dz = x - camera[9], y - camera[10], z - camera[11]
    depth = camera[6] * dx + camera[7] * dy + camera[8] * dz
    per_depth = 1.0 / depth
    across = (camera[0] * dx + camera[1] * dy + camera[2] * dz) * per_depth
    down = (camera[3] * dx + camera[4] * dy + camera[5] * dz) * per_depth
    return across, down, depth


@njit(cache=True, nogil=True, error_model="numpy")
def project(
    points: Array, world_T_cam: Array, focal: float, principal: Array, k1: float, pixels: Array, depth: Array
) -> None:
    """Pixels (N, 2) and depth (N,) of world points (N, 3). Points behind the camera get a depth of -1."""
    camera, column, row = stand(world_T_cam), principal[0], principal[1]
    for n in range(len(points)):
        x, y, z = ray(points[n, 0], points[n, 1], points[n, 2], camera)
        scale = focal * (1.0 + k1 * (x * x + y * y))
        before = z >= 0.1
        pixels[n, 0] = column + scale * x if before else 0.0
        pixels[n, 1] = row + scale * y if before else 0.0
        depth[n] = z if before else -1.0


@njit(cache=True, nogil=True)
def above(points: Array, normals: Array, world_T_cam: Array, height: Array) -> None:
    """How high (N,) a camera stands above the skin's tangent at each point: positive where the skin faces it."""
    x, y, z = world_T_cam[0, 3], world_T_cam[1, 3], world_T_cam[2, 3]
    for n in range(len(points)):
        dx, dy, dz = x - points[n, 0], y - points[n, 1], z - points[n, 2]
        height[n] = normals[n, 0] * dx + normals[n, 1] * dy + normals[n, 2] * dz


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})
def bounds(pixels: Array, depth: Array, out: Array) -> None:
    """Least and greatest column and row, ``out`` (4,) = left, top, right, bottom, of the points before the camera.

    Without any, right is left of left.
    """
    left = top = np.inf
    right = bottom = -np.inf
    for n in range(len(depth)):
        x, y, before = pixels[n, 0], pixels[n, 1], depth[n] > 0.0
        left, right = min(left, x if before else np.inf), max(right, x if before else -np.inf)
        top, bottom = min(top, y if before else np.inf), max(bottom, y if before else -np.inf)
    out[0], out[1], out[2], out[3] = left, top, right, bottom


@njit(cache=True, nogil=True, inline="always")
def pixel_gradient(
    x: float, y: float, depth: float, camera: Stand, focal: float, k1: float, du: float, dv: float
) -> tuple[float, float, float]:
    """Gradient with respect to the world point that `ray` has at ``x, y, depth``, of the function whose gradient in the
    image is ``(du, dv)``."""
    r2 = x * x + y * y
    # d(u, v)/d(x, y) of the lens, then d(x, y)/d(camera point)
    along = focal * (1.0 + k1 * r2)
    gx = du * (along + 2.0 * focal * k1 * x * x) + dv * (2.0 * focal * k1 * x * y)
    gy = dv * (along + 2.0 * focal * k1 * y * y) + du * (2.0 * focal * k1 * x * y)
    a, b, c = gx / depth, gy / depth, -(gx * x + gy * y) / depth
    return (
        camera[0] * a + camera[3] * b + camera[6] * c,
        camera[1] * a + camera[4] * b + camera[7] * c,
        camera[2] * a + camera[5] * b + camera[8] * c,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def rasterise(
    pixels: Array,
    depth: Array,
    faces: NDArray[np.int64],
    segment: NDArray[np.int64],
    group: NDArray[np.uint8],
    left: int,
    top: int,
    scale: float,
    z_buffer: Float32,
    cover: NDArray[np.uint8],
) -> None:
    """Nearest depth at every pixel of a window, infinity where there is no body; and in ``cover`` the bits of all the
    parts of the body that lie there, ``group`` holding that of each ``segment`` (V,).

    Pixel ``(i, j)`` of the window stands at ``(left, top) + (j, i) * scale`` of the image. Depth is interpolated
    linearly over a triangle, which for triangles of centimetres seen from metres is exact to a millimetre.
    """
    height, width = z_buffer.shape
    z_buffer[:] = np.inf
    cover[:] = 0
    corners = np.empty((len(pixels), 3))  # column, row and depth
    for n in range(len(pixels)):
        corners[n, 0] = (pixels[n, 0] - left) / scale if depth[n] > 0.0 else np.nan
        corners[n, 1] = (pixels[n, 1] - top) / scale
        corners[n, 2] = depth[n]
    for f in range(len(faces)):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        x0, y0, z0 = corners[i0, 0], corners[i0, 1], corners[i0, 2]
        x1, y1, z1 = corners[i1, 0] - x0, corners[i1, 1] - y0, corners[i1, 2] - z0
        x2, y2, z2 = corners[i2, 0] - x0, corners[i2, 1] - y0, corners[i2, 2] - z0
        area = x1 * y2 - x2 * y1
        # image y points down: a face seen from outside runs clockwise in these coordinates
        if not area < -1e-9:
            continue
        first = max(int(np.ceil(x0 + min(x1, x2, 0.0))), 0)
        columns = min(int(np.floor(x0 + max(x1, x2, 0.0))) + 1, width) - first
        upper = max(int(np.ceil(y0 + min(y1, y2, 0.0))), 0)
        rows = min(int(np.floor(y0 + max(y1, y2, 0.0))) + 1, height) - upper
        bit = group[segment[i0]]
        face = (x0, y0, z0, x1, y1, z1, x2, y2, z2, 1.0 / area)
        if columns <= 2 and rows <= 2 and first + 2 <= width and upper + 2 <= height:
            # most are smaller than a pixel: to ask which pixels they hold costs more than to try
            for row in range(2):
                for column in range(2):
                    _fill(upper + row, first + column, face, bit, z_buffer, cover)
            continue
        for row in range(upper, upper + rows):
            for column in range(first, first + columns):
                _fill(row, column, face, bit, z_buffer, cover)


@njit(cache=True, nogil=True, inline="always")
def _fill(row: int, column: int, face: Face, bit: int, z_buffer: Float32, cover: NDArray[np.uint8]) -> None:
    """Draw a face at a pixel, if that lies on it: its first corner, the ways to the others, and one over its area."""
    x0, y0, z0, x1, y1, z1, x2, y2, z2, per_area = face
    dx, dy = column - x0, row - y0
    w1, w2 = (dx * y2 - x2 * dy) * per_area, (x1 * dy - dx * y1) * per_area
    inside = min(w1, w2, 1.0 - w1 - w2) >= -1e-9
    z = np.float32(z0 + w1 * z1 + w2 * z2)
    cover[row, column] |= bit if inside else NOTHING
    z_buffer[row, column] = min(z_buffer[row, column], z if inside else FAR)


@njit(cache=True, nogil=True, error_model="numpy")
def visible(
    points: Array,
    height: Array,
    pixels: Array,
    depth: Array,
    world_T_cam: Array,
    z_buffer: Float32,
    left: int,
    top: int,
    scale: float,
    tolerance: float,
    facing: Float32,
) -> None:
    """Cosine between normal and ray of every point that a camera sees, 0 for the hidden ones.

    ``height`` (N,) is as `above` has it.
    """
    rows, columns = z_buffer.shape
    x, y, z = world_T_cam[0, 3], world_T_cam[1, 3], world_T_cam[2, 3]
    for n in range(len(points)):
        facing[n] = 0.0
        if height[n] <= 0.0 or depth[n] < 0.0:
            continue
        column = int(np.rint((pixels[n, 0] - left) / scale))
        row = int(np.rint((pixels[n, 1] - top) / scale))
        if column < 0 or row < 0 or column >= columns or row >= rows:
            continue
        if depth[n] > z_buffer[row, column] + tolerance:
            continue
        dx, dy, dz = x - points[n, 0], y - points[n, 1], z - points[n, 2]
        facing[n] = height[n] / np.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True, nogil=True, inline="always")
def bilinear(image: Image, x: float, y: float) -> float:
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    upper = image[row, column] * (1.0 - fx) + image[row, column + 1] * fx
    lower = image[row + 1, column] * (1.0 - fx) + image[row + 1, column + 1] * fx
    return upper * (1.0 - fy) + lower * fy


@njit(cache=True, nogil=True, inline="always")
def sloped(image: Image, x: float, y: float) -> tuple[float, float, float]:
    """What `bilinear` has at ``(x, y)``, and by how much it grows across and down, from a pixel before to one after."""
    j, i = int(x), int(y)
    fx, fy = x - j, y - i
    ex, ey = 1.0 - fx, 1.0 - fy
    above = ex * image[i - 1, j] + fx * image[i - 1, j + 1]
    upper = ex * image[i, j] + fx * image[i, j + 1]
    lower = ex * image[i + 1, j] + fx * image[i + 1, j + 1]
    below = ex * image[i + 2, j] + fx * image[i + 2, j + 1]
    left = ey * (ex * image[i, j - 1] + fx * image[i, j]) + fy * (ex * image[i + 1, j - 1] + fx * image[i + 1, j])
    right = ey * (ex * image[i, j + 1] + fx * image[i, j + 2]) + fy * (
        ex * image[i + 1, j + 1] + fx * image[i + 1, j + 2]
    )
    return ey * upper + fy * lower, 0.5 * (right - left), 0.5 * (ey * (lower - above) + fy * (below - upper))
