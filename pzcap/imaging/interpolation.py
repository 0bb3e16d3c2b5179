"""Values and slopes of an image between its pixels, for compiled kernels."""

from __future__ import annotations

from numba import njit

from pzcap.types import Image


@njit(cache=True, nogil=True, inline="always")
def bilinear(image: Image, x: float, y: float) -> float:
    """Bilinear interpolation of ``image`` at column ``x`` and row ``y``."""
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    upper = image[row, column] * (1.0 - fx) + image[row, column + 1] * fx
    lower = image[row + 1, column] * (1.0 - fx) + image[row + 1, column + 1] * fx
    return upper * (1.0 - fy) + lower * fy


@njit(cache=True, nogil=True, inline="always")
def bilinear_with_gradient(image: Image, x: float, y: float) -> tuple[float, float, float]:
    """`bilinear` at ``(x, y)``, and its central differences over two pixels, across and down."""
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
