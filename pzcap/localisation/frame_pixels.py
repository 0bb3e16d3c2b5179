"""Pixels of a frame that are compared with the panorama: few of them, on edges, since a bare wall tells nothing."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.geometry import lens as lenses
from pzcap.imaging.bspline import softened
from pzcap.imaging.pyramid import Level
from pzcap.localisation.tuning import ALIGNMENT
from pzcap.types import Array, Float32, Image, Lens, Mask


@dataclass(frozen=True, slots=True, eq=False)
class FramePixels:
    points: Array  # (N, 2)
    grey: Array  # (N,)
    shading: Array  # (N, K) as in `shading`

    def thinned(self, every: int) -> FramePixels:
        return FramePixels(self.points[::every], self.grey[::every], self.shading[::every])


def level_pixels(
    frame: Image, hidden: Mask | None, lens: Lens, focal_px: float, px_per_rad: float, level: Level
) -> FramePixels:
    """The pixels of a ``frame`` (H, W) that are compared with a ``level`` of a panorama of ``px_per_rad``: the steepest
    in each of as many cells as the level wants, none of those that are ``hidden`` (H, W); as smooth as the level."""
    shrink = focal_px / px_per_rad * level.scale  # the frame is so much finer than the level
    # It is made smaller by whole times only, and smoothed for the rest (`softened`); by none if it had too few pixels.
    times = max(int(min(shrink, np.sqrt(frame.size / level.pixels))), 1)
    size = (lens.width // times, lens.height // times)
    small = cv2.resize(frame[: size[1] * times, : size[0] * times], size, interpolation=cv2.INTER_AREA)
    flat = focal_px / times, (lenses.at(lens, focal_px)[0][0] + 0.5) / times - 0.5
    soft = softened(np.asarray(small, np.uint8), shrink / times, flat)
    chosen = _steepest(soft, max(1, round(np.sqrt(soft.size / level.pixels))))
    if hidden is not None:
        column, row = (chosen * times + times // 2).T
        chosen = chosen[~hidden[row, column]]
    observed = soft[chosen[:, 1], chosen[:, 0]].astype(np.float64)
    points = (chosen.astype(np.float64) + 0.5) * times - 0.5
    return FramePixels(points, observed, shading(points, lens, focal_px)[:, : 3 if level.scale == 1 else 2])


def shading(points: Array, lens: Lens, focal_px: float) -> Array:
    """The functions (N, 3) of points (N, 2) that gain and vignetting are made of: r^0, r^2 and r^4, with r the distance
    from the principal point, as it is the lens that darkens corners."""
    across, down = (points - lenses.at(lens, focal_px)[0]).T
    squared = (across * across + down * down) * 4.0 / (lens.width**2 + lens.height**2)
    return np.stack([np.ones_like(squared), squared, squared * squared], axis=1)


@njit(cache=True, nogil=True)
def _steepest(image: Float32, cell: int) -> NDArray[np.int64]:
    """Pixels (N, 2) of the steepest edge in each cell of so many pixels across, among every second row."""
    border = ALIGNMENT.border_px
    rows, columns = (image.shape[0] - 2 * border) // cell, (image.shape[1] - 2 * border) // cell
    chosen = np.empty((rows * columns, 2), np.int64)
    steepness = np.empty(columns * cell, np.float32)
    steepest = np.empty(columns, np.float32)
    for row in range(rows):
        steepest[:] = -1.0
        for i in range(border + row * cell, border + (row + 1) * cell, 2):
            above, here, below = image[i - 1], image[i], image[i + 1]
            for n in range(columns * cell):
                j = border + n
                across, down = here[j + 1] - here[j - 1], below[j] - above[j]
                steepness[n] = across * across + down * down
            for column in range(columns):
                for n in range(column * cell, (column + 1) * cell):
                    if steepness[n] > steepest[column]:
                        steepest[column] = steepness[n]
                        chosen[row * columns + column, 0], chosen[row * columns + column, 1] = border + n, i
    return chosen
