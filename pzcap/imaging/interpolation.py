"""Values and slopes of an image between its pixels, for compiled kernels.

Places have to lie well inside: one pixel from the right and bottom edges, for slopes two, and one from the others.
Indices are unsigned, since Numba counts signed ones that are negative from the end, which takes time at every pixel.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pzcap.types import Image


@njit(cache=True, nogil=True, inline="always")
def bilinear(image: Image, x: float, y: float) -> float:
    """Bilinear interpolation of ``image`` at column ``x`` and row ``y``."""
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    left, right, top, bottom = np.uint64(column), np.uint64(column + 1), np.uint64(row), np.uint64(row + 1)
    upper = image[top, left] * (1.0 - fx) + image[top, right] * fx
    lower = image[bottom, left] * (1.0 - fx) + image[bottom, right] * fx
    return upper * (1.0 - fy) + lower * fy


@njit(cache=True, nogil=True, inline="always")
def bilinear_with_gradient(image: Image, x: float, y: float) -> tuple[float, float, float]:
    """`bilinear` at ``(x, y)``, and its central differences over two pixels, across and down."""
    j, i = int(x), int(y)
    fx, fy = x - j, y - i
    ex, ey = 1.0 - fx, 1.0 - fy
    j0, j1, j2, j3 = np.uint64(j - 1), np.uint64(j), np.uint64(j + 1), np.uint64(j + 2)
    i0, i1, i2, i3 = np.uint64(i - 1), np.uint64(i), np.uint64(i + 1), np.uint64(i + 2)
    above = ex * image[i0, j1] + fx * image[i0, j2]
    upper = ex * image[i1, j1] + fx * image[i1, j2]
    lower = ex * image[i2, j1] + fx * image[i2, j2]
    below = ex * image[i3, j1] + fx * image[i3, j2]
    left = ey * (ex * image[i1, j0] + fx * image[i1, j1]) + fy * (ex * image[i2, j0] + fx * image[i2, j1])
    right = ey * (ex * image[i1, j2] + fx * image[i1, j3]) + fy * (ex * image[i2, j2] + fx * image[i2, j3])
    return ey * upper + fy * lower, 0.5 * (right - left), 0.5 * (ey * (lower - above) + fy * (below - upper))
