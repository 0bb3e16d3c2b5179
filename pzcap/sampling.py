"""Grey images between their pixels: how they are kept for that, and the cubic that goes through them.

A frame's noise is smoothed a little first. That leaves an image which a cubic follows between its pixels: linear
interpolation would shift and blur edges by where they lie in their pixel, and so bias what is aligned by them.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

SMOOTHING = 0.8  # pixels
STEPS = 64.0  # to a grey level

Stored = NDArray[np.uint16]
"""(H, W) a smoothed grey image, in STEPS to a grey level."""


def softened(image: NDArray[np.uint8] | NDArray[np.float32], shrink: float = 1.0) -> NDArray[np.float32]:
    """A grey image (H, W), smoothed as it would be were it ``shrink`` times smaller.

    It keeps its pixels: an image that is made smaller by a fraction has its edges moved by up to a tenth of a pixel.
    """
    return np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), _smoothing(shrink)), np.float32)


def stored(image: NDArray[np.uint8] | NDArray[np.float32]) -> Stored:
    """A grey image (H, W), smoothed and in STEPS."""
    return np.asarray(np.clip(np.rint(softened(image) * STEPS), 0, 65535), np.uint16)


def smoothed_further(image: Stored, shrink: float) -> Stored:
    """A stored image, smoothed as it would be were it ``shrink`` times smaller."""
    further = np.sqrt(_smoothing(shrink) ** 2 - SMOOTHING**2)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), further), np.uint16)


def _smoothing(shrink: float) -> float:
    """Standard deviation in pixels; a pixel itself, a square, has a variance of 1/12."""
    return float(np.sqrt((SMOOTHING * shrink) ** 2 + (shrink**2 - 1.0) / 12.0))


@njit(cache=True, nogil=True)
def cubic(image: Stored, x: float, y: float) -> tuple[bool, float, float, float]:
    """Whether (x, y) lies far enough inside an image; its grey level there, and the derivatives along x and y (Keys,
    1981)."""
    i, j = int(np.floor(y)), int(np.floor(x))
    if i < 1 or j < 1 or i + 2 >= image.shape[0] or j + 2 >= image.shape[1]:
        return False, 0.0, 0.0, 0.0
    across, along_x = _keys(x - j)
    down, along_y = _keys(y - i)
    value, by_x, by_y = 0.0, 0.0, 0.0
    for k in range(4):
        row, slope = 0.0, 0.0
        for m in range(4):
            grey = float(image[i + k - 1, j + m - 1])
            row += across[m] * grey
            slope += along_x[m] * grey
        value += down[k] * row
        by_x += down[k] * slope
        by_y += along_y[k] * row
    return True, value / STEPS, by_x / STEPS, by_y / STEPS


@njit(cache=True, nogil=True)
def _keys(a: float) -> tuple[tuple[float, float, float, float], tuple[float, float, float, float]]:
    """Weights of the four pixels around a place that lies ``a`` beyond the second, and their derivatives."""
    return (
        ((1.0 - 0.5 * a) * a - 0.5) * a,
        (1.5 * a - 2.5) * a * a + 1.0,
        ((2.0 - 1.5 * a) * a + 0.5) * a,
        (0.5 * a - 0.5) * a * a,
    ), (
        (2.0 - 1.5 * a) * a - 0.5,
        (4.5 * a - 5.0) * a,
        (4.0 - 4.5 * a) * a + 0.5,
        (1.5 * a - 1.0) * a,
    )
