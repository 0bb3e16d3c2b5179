"""The colours of the lower arms: what shows a forearm or a hand before the trunk.

A silhouette does not show them there, and what the skin looks like leads them on only from where they nearly are. But
forearms are mostly bare, and what is worn is seldom of the skin's colour; where it is, nothing is said. Which colours
are theirs and which the rest of the body's is learned at the keyframes, where the arms are where the hand has put them.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.segmentation.background_model import COLOUR_LEVELS, count_colours, log_shares
from pzcap.tracking.tuning import SKIN_COLOUR
from pzcap.types import SEGMENTS, Array, Image, Indices

UNKNOWN: Final = np.uint8(127)  # of 255
LOWER_ARM: Final = np.array([name.endswith(("forearm", "hand")) for name in SEGMENTS])  # (16,) Segments of one are True


class SkinColourModel:
    """Colours of the lower arms of one athlete, and of everything else."""

    def __init__(self) -> None:
        self._counts = np.zeros((2, *(COLOUR_LEVELS,) * 3), np.int64)  # of the rest, of lower arms
        self._table = np.full((COLOUR_LEVELS,) * 3, UNKNOWN)

    def learn(self, image: Image, segment: Indices, pixels: Array, facing: NDArray[np.float32]) -> None:
        """Learn one view (H, W, 3), in which points of the skin, each on a ``segment`` (V,), are seen at ``pixels``
        (V, 2) with a cosine ``facing`` (V,) to the ray, 0 where they are hidden."""
        column, row = np.rint(pixels).astype(np.int64).T
        height, width = image.shape[:2]
        clear = (facing > SKIN_COLOUR.least_facing) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
        for counts, part in zip(self._counts, (~LOWER_ARM, LOWER_ARM), strict=True):
            shown = clear & part[segment]
            if shown.any():
                colours = _luma_and_chroma(image[row[shown], column[shown]][None])
                colours[..., 0] //= SKIN_COLOUR.luma
                count_colours(colours, np.ones(colours.shape[:2], np.uint8), counts)
        if self._counts.any(axis=(1, 2, 3)).all():
            rest, arms = (log_shares(counts) for counts in self._counts)
            odds = np.clip(arms - rest, -SKIN_COLOUR.surest, SKIN_COLOUR.surest)
            self._table = np.asarray(np.rint(255.0 / (1.0 + np.exp(-odds))), np.uint8)

    def arms(self, image: Image, silhouette: Image) -> Image:
        """The probability (h, w), 0..255, that a pixel of ``image`` (h, w, 3) shows a lower arm, that of its being the
        athlete at all as in ``silhouette`` (h, w), 0..255."""
        found = np.empty(silhouette.shape, np.uint8)
        _look_up(_luma_and_chroma(image), silhouette, self._table, found)
        return np.asarray(cv2.GaussianBlur(found, (0, 0), SKIN_COLOUR.soft_px), np.uint8)


def _luma_and_chroma(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb), np.uint8)


@njit(cache=True, nogil=True)
def _look_up(colours: Image, silhouette: Image, table: Image, found: Image) -> None:
    """The ``table`` of colours, a palette, at each pixel's ``colours``, times the ``silhouette``."""
    height, width = silhouette.shape
    chroma = 256 // COLOUR_LEVELS
    luma = SKIN_COLOUR.luma * chroma
    for i in range(height):
        for j in range(width):
            here = table[colours[i, j, 0] // luma, colours[i, j, 1] // chroma, colours[i, j, 2] // chroma]
            found[i, j] = here * np.int64(silhouette[i, j]) // 255
