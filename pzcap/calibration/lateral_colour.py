"""Lateral colour of a lens (`pzcap.imaging.colour`), measured in the frames of a sweep.

Where a colour is set apart radially by a share ``s`` of the radius, it has at every upright edge of the grey values Y,
beside a picture's middle by x, a fringe ``-s x dY/dx`` more than these. What a surface's own colour adds there has the
shape of the edge, not of its derivative: in each small window a mean and a multiple of Y are taken out of both, and
``s`` is what is left of the one over what is left of the other, by least squares over all windows of all frames. What
that leaves of a surface's colour cancels, since a sweep sees it on either side; level edges, as of the floor, are
always below the middle, and would not. Video has chroma at half the resolution, and it is done there.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.calibration.calibrate import Footage
from pzcap.calibration.sweep import Frames, MappedFrames
from pzcap.calibration.tuning import LATERAL
from pzcap.imaging.colour import LUMA, colours_aligned
from pzcap.types import Array, Float32, Image

_FROM_CHROMA = np.array([1.772, 1.402])  # blue and red less the grey values, in units of the chroma Cb and Cr (BT.601)


def aligned(footage: Footage, stretches: Array) -> Footage:
    """The ``footage`` of a camera with the colours of all its frames aligned by ``stretches`` (3,)."""

    def align(_: int, image: Image) -> Image:
        return colours_aligned(image, stretches)

    zoom = None if footage.zoom is None else MappedFrames(footage.zoom, align)
    return footage._replace(
        reference_image=align(0, footage.reference_image), sweep=MappedFrames(footage.sweep, align), zoom=zoom
    )


def measure(frames: Frames) -> Array:
    """Stretches (3,) of blue, green and red by which the lens of a sweep's ``frames`` sets colours apart; zeros where
    that is less than matters, or not sure. In grey values they cancel."""
    sums: list[tuple[Array, float]] = []
    corner_px = 0.0
    for number, image in frames:
        if number % LATERAL.every == 0:
            sums.append(_fringes(image))
            corner_px = float(np.hypot(*image.shape[:2])) / 2
    fringes, edges = np.array([each for each, _ in sums]), np.array([each for _, each in sums])
    if np.count_nonzero(edges) < LATERAL.least_frames:
        return np.zeros(3)
    found = fringes.sum(axis=0) / edges.sum()
    sigma = np.sqrt(np.sum((fringes - found * edges[:, None]) ** 2, axis=0)) / edges.sum()
    if np.all(np.abs(found) < np.maximum(LATERAL.sigmas * sigma, LATERAL.least_px / corner_px)):
        return np.zeros(3)
    blue, red = found / LATERAL.kept
    return np.array([blue, -(LUMA[0] * blue + LUMA[2] * red) / LUMA[1], red])


def _fringes(image: Image) -> tuple[Array, float]:
    """Products (2,) of fringes of blue and red with those that a stretch of 1 would leave, and the square of these,
    summed over the edges of a frame (H, W, 3)."""
    luma, *chroma = (_halved(plane) for plane in np.moveaxis(cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb), 2, 0))
    across, width = np.gradient(luma, axis=1), luma.shape[1]
    beside = (np.arange(width) - (width - 1) / 2).astype(np.float32)
    mean = _around(luma)
    variance = _around(luma**2) - mean**2 + LATERAL.flat

    def left(plane: Float32) -> Float32:
        """The part of a ``plane`` that a mean and a multiple of the grey values, in each window, do not explain."""
        usual = _around(plane)
        multiple = (_around(plane * luma) - usual * mean) / variance
        return np.asarray(plane - usual - multiple * (luma - mean), np.float32)

    edge = np.s_[LATERAL.window : -LATERAL.window, LATERAL.window : -LATERAL.window]
    steep = np.abs(across[edge]) > LATERAL.steep
    unit = -left(beside * across)[edge][steep]
    red, blue = (left(plane)[edge][steep] for plane in chroma)
    products = [float(np.vdot(scale * plane, unit)) for scale, plane in zip(_FROM_CHROMA, (blue, red), strict=True)]
    return np.array(products), float(np.vdot(unit, unit))


def _halved(plane: NDArray[np.integer[Any]]) -> Float32:
    half = cv2.resize(plane.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(half, (0, 0), 1.0), np.float32)


def _around(plane: Float32) -> Float32:
    """Mean of the window about each pixel."""
    return np.asarray(cv2.boxFilter(plane, -1, (LATERAL.window, LATERAL.window)), np.float32)
