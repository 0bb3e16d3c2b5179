"""The comb of interlaced video: two fields, of two instants, in the rows of one picture.

A camera that pans moves the odd rows of such a picture by so many pixels against the even ones. A row d between two
others whose mean is m is, to first order, m(x - s), so that

    s = -sum (d - m) m' / sum m'^2,        m' the slope of m along the row,

of odd rows between even ones; of even rows between odd ones the comb has the other sign, and what a picture's own
slanting edges do has the same. Half the difference is the comb alone.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from pzcap.imaging.tuning import COMB
from pzcap.types import Array, Float32, Image


def comb_px(image: Image) -> float:
    """Pixels by which the odd rows of a picture (H, W[, 3]) have moved to the right against the even ones; 0 of a bare
    one."""
    plane = image if image.ndim == 2 else image[..., 1]
    tops = np.arange(4, len(plane) - 8, COMB.every) // 2 * 2
    even, odd, next_even, next_odd = (_soft(plane[tops + k]) for k in range(4))
    return 0.5 * (_moved(odd, even, next_even) - _moved(next_even, odd, next_odd))


def _soft(rows: Image) -> Float32:
    """Each row smoothed by itself."""
    return np.asarray(cv2.GaussianBlur(rows.astype(np.float32), (0, 1), sigmaX=COMB.soft_px), np.float32)


def _moved(row: Float32, above: Float32, below: Float32) -> float:
    mean = 0.5 * (above + below)
    slope, departure = 0.5 * (mean[:, 2:] - mean[:, :-2]), (row - mean)[:, 1:-1]
    steep = float(np.vdot(slope, slope))
    return -float(np.vdot(departure, slope)) / steep if steep > 0.0 else 0.0


class Comb(NamedTuple):
    """Share of the comb that fields half a frame period apart would show, and its standard deviation."""

    share: float
    sigma: float

    @property
    def is_woven(self) -> bool:
        """True of pictures of two fields, whichever is first."""
        return abs(self.share) > max(COMB.share, COMB.sigmas * self.sigma)

    def cure(self, name: str) -> str:
        """The command that makes a file of woven pictures say what it is."""
        first = "tff" if self.share > 0.0 else "bff"  # the upper field, or the lower one
        return f"ffmpeg -i {name} -c:v libx264 -x264-params {first}=1 -crf 10 -c:a copy OUT"


def comb_of(found_px: Array, turned_px: Array) -> Comb | None:
    """The comb of N pictures by `comb_px` (N,) of each, and the pixels (N,) by which the scene moves to the right in a
    frame period there. None where the camera pans too little to tell."""
    found, expected = found_px, 0.5 * turned_px
    told = (np.abs(expected) > COMB.panned_px) & (np.abs(expected) < 2.0 * COMB.soft_px)
    if told.sum() < COMB.least:
        return None
    found, expected = found[told], expected[told]
    weight = float(expected @ expected)
    share = float(found @ expected) / weight
    return Comb(share, float(np.sqrt(np.sum((found - share * expected) ** 2) / (len(found) - 1) / weight)))
