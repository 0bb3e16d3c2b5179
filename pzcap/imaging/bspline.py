"""Grey images between their pixels: how they are kept for that, and the spline that runs through them.

Two images are compared after both were smoothed by the same amount, one at its own pixels and the other between its
pixels. Cubic B-splines leave no more behind than a hundredth of what they interpolate (Unser, 1999), and themselves
smooth by a third of a square pixel; discrete Gaussians (Lindeberg, 1990), whose variances are exact and add up, do the
rest. Other interpolation blurs edges by where they lie in their pixel, and so biases what is aligned by them.

Amounts are angles: towards the sides of a frame its pixels look ever closer together. Smoothed by as many of them, a
place is sharper there, and two frames come to lie a thousandth of a pixel beside each other; so frames are smoothed
more towards their sides (`Flat`).
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ive

from pzcap.types import Array, Float32, Image

SMOOTHING = 0.64  # variance, square pixels: of what is compared
SPLINE = 1.0 / 3.0  # of which the spline brings about so much
PIXEL = 1.0 / 12.0  # variance of a pixel itself, a square
LEAST_SHRINK = 0.4  # nothing is made finer than 2.5 times: `softened` would have to sharpen it
STEPS = 64.0  # to a grey level

POLE = np.sqrt(3.0) - 2.0
DIRECT = POLE ** np.abs(np.arange(-9, 10))
DIRECT /= DIRECT.sum()  # makes an image the coefficients of the spline that runs through it

Stored = NDArray[np.uint16]
"""(H, W) a grey image in STEPS to a grey level, smoothed by SMOOTHING - SPLINE: these are a spline's coefficients."""
Flat = tuple[float, float]
"""Of a frame, focal length and column of the principal point, pixels. A panorama is the same all over, and has none."""


def softened(image: Image | Float32, shrink: float = 1.0, flat: Flat | None = None) -> Float32:
    """A grey image (H, W), smoothed as one that is ``shrink`` times smaller is where `cubic` looks at it.

    It keeps its pixels: an image that is made smaller by a fraction has its edges moved by up to a tenth of a pixel.
    """
    variance = SMOOTHING * shrink**2 + PIXEL * (shrink**2 - 1.0)
    return _evened(smoothed(image, variance), shrink**2 * (SMOOTHING + PIXEL), flat)


def stored(image: Image | Float32, flat: Flat | None = None, smoothing: float = SMOOTHING) -> Stored:
    """A grey image (H, W), ready for `cubic`."""
    soft = _evened(smoothed(image, smoothing - SPLINE), smoothing + PIXEL, flat)
    return np.asarray(np.clip(np.rint(soft * STEPS), 0, 65535), np.uint16)


def softened_further(image: Stored, shrink: float, flat: Flat | None = None, smoothing: float = SMOOTHING) -> Float32:
    """`softened` of what is stored already."""
    more = (shrink**2 - 1.0) * (smoothing + PIXEL)
    soft = _evened(smoothed(image, more + SPLINE), more, flat)
    return np.asarray(soft / np.float32(STEPS), np.float32)


def _evened(image: Float32, variance: float, flat: Flat | None) -> Float32:
    """A frame (H, W), in the middle smoothed by so much, its pixels' own PIXEL included, smoothed more towards its
    sides: by as much everywhere, measured on the cylinder that it looks at.

    Roll, tilt and distortion are slight, and left out.
    """
    if flat is None:
        return image
    outward: Array = 1.0 + ((np.arange(image.shape[1], dtype=np.float64) - flat[1]) / flat[0]) ** 2  # secant, squared
    half = 0.5 * variance
    out = image.copy()
    _diffuse(image, (half * (outward**2 - 1.0)).astype(np.float32), (half * (outward - 1.0)).astype(np.float32), out)
    return out


@njit(cache=True, nogil=True)
def _diffuse(image: Float32, across: Float32, down: Float32, out: Float32) -> None:
    """One step of heat flow, by so much in each column (W,); the outermost pixels stay."""
    two = np.float32(2.0)
    for i in range(1, image.shape[0] - 1):
        above, row, below = image[i - 1], image[i], image[i + 1]
        for j in range(1, image.shape[1] - 1):
            twice = two * row[j]
            out[i, j] = row[j] + across[j] * (row[j - 1] + row[j + 1] - twice) + down[j] * (above[j] + below[j] - twice)


def smoothed(image: Image | Stored | Float32, variance: float) -> Float32:
    reach = int(np.ceil(4.0 * np.sqrt(variance))) + 1
    kernel = ive(np.abs(np.arange(-reach, reach + 1)), variance)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101), np.float32)


@njit(cache=True, nogil=True)
def cubic(image: Stored, x: float, y: float) -> tuple[bool, float, float, float]:
    """A flag that (x, y) lies far enough inside an image; its grey level there, and the derivatives along x and y."""
    i, j = int(np.floor(y)), int(np.floor(x))
    if i < 1 or j < 1 or i + 2 >= image.shape[0] or j + 2 >= image.shape[1]:
        return False, 0.0, 0.0, 0.0
    across, along_x = spline(x - j)
    down, along_y = spline(y - i)
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


def warped(image: Image | Float32, columns: Float32, rows: Float32) -> Float32:
    """Sample the spline through a colour image (H, W, 3) at columns and rows (h, w): (h, w, 3). It ends a pixel inside.

    OpenCV's own interpolation rounds places to 1/32 pixel, and its bicubic one (a = -0.75) keeps no slope: a small
    shift comes out -2 a = 1.5 times as large, and frames of a zoom run that it puts right a ten-thousandth.
    """
    coefficients = cv2.sepFilter2D(image, cv2.CV_32F, DIRECT, DIRECT, borderType=cv2.BORDER_REFLECT_101)
    out = np.empty((*columns.shape, 3), np.float32)
    _warp(np.asarray(coefficients, np.float32), columns, rows, out)
    return out


def resampled(image: Image, columns: Float32, rows: Float32) -> Image:
    """`warped` in whole grey levels."""
    return np.asarray(cv2.convertScaleAbs(np.maximum(warped(image, columns, rows), 0.0)), np.uint8)


@njit(cache=True, nogil=True)
def _warp(coefficients: Float32, columns: Float32, rows: Float32, out: Float32) -> None:
    """`warped` of a spline's ``coefficients`` (H, W, 3), into ``out`` (h, w, 3); single precision and unsigned indices
    take two thirds of the time."""
    height, width, _ = coefficients.shape
    least, right, bottom = np.float32(1.0), np.float32(width - 2.001), np.float32(height - 2.001)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            x, y = min(max(columns[i, j], least), right), min(max(rows[i, j], least), bottom)
            left, top = int(x), int(y)
            across, down = spline(x - left)[0], spline(y - top)[0]
            blue, green, red = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for k in range(4):
                row, share = coefficients[np.uint64(top + k - 1)], np.float32(down[k])
                for m in range(4):
                    weight, pixel = share * np.float32(across[m]), np.uint64(left + m - 1)
                    blue += weight * row[pixel, 0]
                    green += weight * row[pixel, 1]
                    red += weight * row[pixel, 2]
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = blue, green, red


@njit(cache=True, nogil=True)
def at_pixels(image: Stored, pixels: NDArray[np.int16]) -> Array:
    """(N,) `cubic` at pixels (N, 2) well inside an image."""
    out = np.empty(len(pixels))
    for n in range(len(pixels)):
        out[n] = cubic(image, float(pixels[n, 0]), float(pixels[n, 1]))[1]
    return out


@njit(cache=True, nogil=True)
def spline(a: float) -> tuple[tuple[float, float, float, float], tuple[float, float, float, float]]:
    """Weights of the four pixels around a place that lies ``a`` beyond the second, and their derivatives."""
    b = 1.0 - a
    return (
        b * b * b / 6.0,
        (3.0 * a - 6.0) * a * a / 6.0 + 2.0 / 3.0,
        (3.0 * b - 6.0) * b * b / 6.0 + 2.0 / 3.0,
        a * a * a / 6.0,
    ), (-0.5 * b * b, (1.5 * a - 2.0) * a, (2.0 - 1.5 * b) * b, 0.5 * a * a)
