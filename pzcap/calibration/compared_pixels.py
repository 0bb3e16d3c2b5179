"""The pixels that photometric bundle adjustment compares: some hundred on edges of a pair of frames that overlap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.tuning import PHOTOMETRIC
from pzcap.geometry import camera as geometry
from pzcap.imaging.bspline import Stored, at_pixels, softened_further
from pzcap.types import Array, Float32


class Overlap(NamedTuple):
    """Pixels of one frame that another sees."""

    ends: tuple[int, int]  # the first and the second frame
    points_px: NDArray[np.int16]  # (N, 2) in the first frame
    grey: Float32  # (N,) there


class ComparedPixels(NamedTuple):
    """The pixels of all overlaps, for kernels."""

    ends: NDArray[np.int64]  # (L, 2) frames of each overlap
    bounds: NDArray[np.int64]  # (L + 1,) where each overlap's pixels begin
    points: NDArray[np.int16]  # (N, 2) in the first frame
    grey: Float32  # (N,) there
    gains: Array  # (L, 2) of each overlap: gain and shading, brought up to date
    residual: Float32  # (N,) written; inf where the second frame does not show the pixel
    row: Float32  # (N,) written; in the second frame
    overlap_cost: Array  # (L,) written; squared distance, grey levels, of the second frame by this overlap alone


def overlap_of(
    frames: Stored, edges: Sequence[NDArray[np.int16]], state: CalibrationParameters, pair: tuple[int, int], most: int,
    smoothing: float,
) -> Overlap | None:  # fmt: skip
    """Choose ``most`` pixels of a pair of frames to compare, the finer frame smoothed to the other's resolution; None
    if they overlap too little. ``edges`` are those of the unsmoothed frames."""
    first, second = pair
    views = state.view(first), state.view(second)
    shrink = views[0].focal_px / views[1].focal_px
    if shrink < 0.999:
        first, second, views, shrink = second, first, (views[1], views[0]), 1.0 / shrink
    border, edge = _border_px(smoothing), np.array(frames.shape[:0:-1]) - 1
    fine, chosen = None, edges[first]
    if shrink > 1.001:
        fine = softened_further(frames[first], shrink, (views[0].focal_px, views[0].principal_px[0]), smoothing)
        chosen = edge_pixels(fine, most, smoothing)
    directions = geometry.pixel_to_direction(views[0], chosen.astype(np.float64))
    seen, front = geometry.direction_to_pixel(views[1], *directions)
    inside = front & np.all((seen >= border) & (seen <= edge - border), axis=1)
    which = np.flatnonzero(inside)
    which = which[:: max(1, len(which) // most)]
    if len(which) < most // 10:
        return None
    points = chosen[which]
    grey = at_pixels(frames[first], points) if fine is None else fine[points[:, 1], points[:, 0]]
    return Overlap((first, second), points, np.asarray(grey, np.float32))


def edge_pixels(image: Stored | Float32, most: int, smoothing: float) -> NDArray[np.int16]:
    """Pixels (N, 2) of the strongest edges, the same number in every tile, and some times ``most`` in all; none so near
    to the border that an image smoothed by ``smoothing`` pixels does not know them."""
    border = _border_px(smoothing)
    inner = image[border : image.shape[0] - border, border : image.shape[1] - border].astype(np.float32)
    strength = np.hypot(cv2.Sobel(inner, cv2.CV_32F, 1, 0), cv2.Sobel(inner, cv2.CV_32F, 0, 1))
    tile = PHOTOMETRIC.tile_px
    rows, columns = (side // tile for side in strength.shape)
    tiles = strength[: rows * tile, : columns * tile].reshape(rows, tile, columns, tile).swapaxes(1, 2)
    strongest = min(max(round(PHOTOMETRIC.choice * most / (rows * columns)), 1), tile**2 - 1)
    best = np.sort(np.argpartition(-tiles.reshape(rows, columns, tile**2), strongest, axis=2)[:, :, :strongest], axis=2)
    row = np.arange(rows)[:, None, None] * tile + best // tile
    column = np.arange(columns)[None, :, None] * tile + best % tile
    return (np.stack([column.ravel(), row.ravel()], axis=1) + border).astype(np.int16)


def compared_pixels(overlaps: Sequence[Overlap], every: int = 1) -> ComparedPixels:
    """One of so many pixels of all overlaps, with first values of what is found of each."""
    ends, points, greys = zip(*((one.ends, one.points_px[::every], one.grey[::every]) for one in overlaps), strict=True)
    bounds, grey = np.cumsum([0, *map(len, greys)]), np.concatenate(greys)
    gains, beside = np.tile([1.0, 0.0], (len(overlaps), 1)), np.zeros(len(overlaps))
    residual, row = np.zeros_like(grey), np.zeros_like(grey)
    return ComparedPixels(np.array(ends), bounds, np.vstack(points), grey, gains, residual, row, beside)


def _border_px(smoothing: float) -> int:
    return round(PHOTOMETRIC.border * smoothing)
