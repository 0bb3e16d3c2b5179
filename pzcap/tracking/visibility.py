"""Visible points of the skin: z-buffer and depth test."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.body.skeleton import LIMBS
from pzcap.geometry.pinhole import Vector
from pzcap.segmentation.others import BEFORE
from pzcap.types import SEGMENTS, Array, Float32, Image, Indices

Face = tuple[float, float, float, float, float, float, float, float, float, float]

_FAR: Final = np.float32(np.inf)
_NOTHING: Final = np.uint8(0)
HEAD: Final = np.uint8(32)
GROUP: Final[NDArray[np.uint8]] = np.array(
    [next((2 << k for k, limb in enumerate(LIMBS) if s in limb), 1) for s in range(len(SEGMENTS))], np.uint8
)
GROUP[SEGMENTS.index("head")] |= HEAD
"""(16,) One bit a part of the body: the trunk with the head, then each limb; the head has one besides."""
ARMS: Final = GROUP[LIMBS[0][0]] | GROUP[LIMBS[1][0]]


class SkinPoints(NamedTuple):
    """The skin of a posed body, in the world."""

    points: Array  # (V, 3)
    normals: Array  # (V, 3)
    segment: Indices  # (V,) that each point is fixed to


class ProjectedSkin(NamedTuple):
    """The skin of a posed body in one view, hidden points included."""

    pixels: Array  # (V, 2), a coordinate after the other in memory
    depth: Array  # (V,) -1 behind the camera
    above: Array  # (V,) metres by which the camera stands above the tangent plane: negative where the skin faces away


class ZBuffer(NamedTuple):
    """Cover of a window of a view by a body. Pixel ``(i, j)`` stands at ``(left, top) + (j, i) * scale``."""

    depth: Float32  # (h, w) of the nearest face, infinite where there is none
    cover: NDArray[np.uint8]  # (h, w) bits of all parts of the body that lie there
    left: int
    top: int
    scale: float


def empty_z_buffer(window: tuple[int, int, int, int], scale: float) -> ZBuffer:
    """A z-buffer for a ``window`` (left, top, width, height), pixels of the view; a pixel is ``scale`` of these."""
    left, top, width, height = window
    shape = int(height // scale) + 1, int(width // scale) + 1
    return ZBuffer(np.empty(shape, np.float32), np.empty(shape, np.uint8), left, top, scale)


@njit(cache=True, nogil=True)
def camera_above(points: Array, normals: Array, centre: Vector, above: Array) -> None:
    """Fill in ``above`` (V,) as `ProjectedSkin` has it, the camera being at ``centre``."""
    for n in range(len(points)):
        dx, dy, dz = centre[0] - points[n, 0], centre[1] - points[n, 1], centre[2] - points[n, 2]
        above[n] = normals[n, 0] * dx + normals[n, 1] * dy + normals[n, 2] * dz


def bounds(pixels: Array, depth: Array) -> tuple[Array, Array] | None:
    """Left-top and right-bottom corner of the points before the camera; None without any."""
    low, high = _corners(pixels, depth)
    return (low, high) if low[0] <= high[0] else None


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz", "reassoc"})
def _corners(pixels: Array, depth: Array) -> tuple[Array, Array]:
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(2):
        least, most = np.inf, -np.inf
        for n in range(len(pixels)):
            least = min(least, pixels[n, k] if depth[n] > 0.0 else np.inf)
            most = max(most, pixels[n, k] if depth[n] > 0.0 else -np.inf)
        low[k], high[k] = least, most
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def rasterise(pixels: Array, depth: Array, faces: Indices, bits: NDArray[np.uint8], z_buffer: ZBuffer) -> None:
    """Fill in ``z_buffer``; ``bits`` (V,) tells which part of the body a vertex belongs to.

    Depth is interpolated linearly over a triangle, which for triangles of centimetres seen from metres is exact to a
    millimetre.
    """
    nearest, cover, left, top, scale = z_buffer
    height, width = nearest.shape
    nearest[:] = np.inf
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
        last = min(int(np.floor(x0 + max(x1, x2, 0.0))), width - 1)
        if last < first:  # most are smaller than a pixel, and lie between two
            continue
        upper = max(int(np.ceil(y0 + min(y1, y2, 0.0))), 0)
        lower = min(int(np.floor(y0 + max(y1, y2, 0.0))), height - 1)
        face = (x0, y0, z0, x1, y1, z1, x2, y2, z2, 1.0 / area)
        for row in range(upper, lower + 1):
            for column in range(first, last + 1):
                _fill(row, column, face, bits[i0], nearest, cover)


@njit(cache=True, nogil=True, inline="always")
def _fill(row: int, column: int, face: Face, bit: int, nearest: Float32, cover: NDArray[np.uint8]) -> None:
    """Draw ``face`` (its first corner, the vectors to the others, and one over its area) at a pixel that lies on it."""
    x0, y0, z0, x1, y1, z1, x2, y2, z2, per_area = face
    dx, dy = column - x0, row - y0
    w1, w2 = (dx * y2 - x2 * dy) * per_area, (x1 * dy - dx * y1) * per_area
    inside = min(w1, w2, 1.0 - w1 - w2) >= -1e-9
    z = np.float32(z0 + w1 * z1 + w2 * z2)
    cover[row, column] |= bit if inside else _NOTHING
    nearest[row, column] = min(nearest[row, column], z if inside else _FAR)


@njit(cache=True, nogil=True, error_model="numpy")
def visible(
    points: Array, seen: ProjectedSkin, centre: Vector, z_buffer: ZBuffer, tolerance: float, facing: Float32
) -> None:
    """Fill in ``facing`` (V,): the cosine between normal and ray of the points that the camera at ``centre`` sees, 0 of
    the hidden ones, which lie more than ``tolerance`` metres behind the z-buffer."""
    nearest, left, top, scale = z_buffer.depth, z_buffer.left, z_buffer.top, z_buffer.scale
    rows, columns = nearest.shape
    for n in range(len(points)):
        facing[n] = 0.0
        if seen.above[n] <= 0.0 or seen.depth[n] < 0.0:
            continue
        column = int(np.rint((seen.pixels[n, 0] - left) / scale))
        row = int(np.rint((seen.pixels[n, 1] - top) / scale))
        if column < 0 or row < 0 or column >= columns or row >= rows:
            continue
        if seen.depth[n] > nearest[row, column] + tolerance:
            continue
        dx, dy, dz = centre[0] - points[n, 0], centre[1] - points[n, 1], centre[2] - points[n, 2]
        facing[n] = seen.above[n] / np.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True, nogil=True)
def hide_behind(people: Image, seen: ProjectedSkin, left: int, top: int, facing: Float32) -> None:
    """Zero ``facing`` (V,) of the points that somebody stands before, as ``people`` (h / 2, w / 2) of half pixels say,
    whose corner is at ``(left, top)`` of the view."""
    for n in range(len(facing)):
        i, j = int((seen.pixels[n, 1] - top) / 2.0), int((seen.pixels[n, 0] - left) / 2.0)
        if 0 <= i < people.shape[0] and 0 <= j < people.shape[1] and people[i, j] == BEFORE:
            facing[n] = 0.0
