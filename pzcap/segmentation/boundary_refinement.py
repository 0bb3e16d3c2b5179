"""Boundary of the body on the sharp frame.

The evidence of `pzcap.segmentation.background_model` is as blurred as the panorama, which leaves a band about the body
undecided. There a pixel is compared with the colours nearby that are certainly body, with what the hall shows nearby,
and with mixtures of the two, since the pixels on the boundary show both: it is body if it is so by half or more. Then
each pixel takes the mean of itself and its neighbours, weighted more the less the frame changes between them: a random
walk with a prior (Grady 2005), which settles where the frame has an edge. It works on luma and chroma, which are nearly
independent; footage has chroma at half the resolution, so luma counts for more.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.segmentation.background_model import shrink
from pzcap.segmentation.tuning import BOUNDARY
from pzcap.types import Float32, Image


class _NearbyColours(NamedTuple):
    """Statistics of the colours near a pixel, half as fine."""

    mean: Float32  # (h/2, w/2, 3) of the body's colours
    variance: Float32  # (h/2, w/2, 3)
    share: Float32  # (h/2, w/2) of the window that is body
    hall_variance: Float32  # (h/2, w/2, 3) mean square of frame minus hall, where that is seen


def refine(image: Image, background: Image, log_odds: Float32, hint: Float32, solid: Image) -> Float32:
    """Probability of body (h, w), both even.

    ``image`` and ``background`` are (h, w, 3), black where it is unknown; ``log_odds`` (h, w) are those of body by the
    blurred colours, ``hint`` (h, w) the part of them, and of anything else, that counts beside the sharp colours;
    ``solid`` (h, w) is 1 where the body is at first guess, else 0.
    """
    band = np.ones((5, 5), np.uint8)  # about the first guess's boundary: undecided
    inner, outer = np.asarray(cv2.erode(solid, band), np.uint8), np.asarray(cv2.dilate(solid, band), np.uint8)
    frame, hall = (np.asarray(cv2.cvtColor(one, cv2.COLOR_BGR2YCrCb), np.uint8) for one in (image, background))
    colours = _nearby_colours(frame, hall, inner, outer)
    undecided = np.empty((solid.size, 2), np.int32)
    probability, count = _initial(frame, hall, log_odds, hint, inner, outer, colours, undecided)
    _random_walk(frame, probability, undecided[:count])
    return probability


def _nearby_colours(frame: Image, hall: Image, inner: Image, outer: Image) -> _NearbyColours:
    half, empty = shrink(frame, 2).astype(np.float32), shrink(hall, 2).astype(np.float32)
    body = inner[::2, ::2].astype(np.float32)
    clear = ((outer[::2, ::2] == 0) & (hall[::2, ::2, 0] > 0)).astype(np.float32)
    share, mean, square = (_box(one) for one in (body, half * body[..., None], half * half * body[..., None]))
    mean /= np.maximum(share, 1e-6)[..., None]
    square = np.maximum(square / np.maximum(share, 1e-6)[..., None] - mean * mean, 0.0)
    missed = _box((half - empty) ** 2 * clear[..., None]) / np.maximum(_box(clear), 1e-6)[..., None]
    return _NearbyColours(mean, square, share, np.asarray(missed, np.float32))


def _box(values: Float32) -> Float32:
    return np.asarray(cv2.blur(values, (7, 7)), np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _initial(
    frame: Image, hall: Image, log_odds: Float32, hint: Float32, inner: Image, outer: Image, colours: _NearbyColours,
    undecided: NDArray[np.int32],
) -> tuple[Float32, int]:  # fmt: skip
    """Each pixel's own probability (h, w), and the number of the ``undecided``: filled in, row and column."""
    probability = np.zeros(log_odds.shape, np.float32)
    height, width = log_odds.shape
    count, largest = 0, BOUNDARY.largest_log_odds
    for i in range(height):
        for j in range(width):
            if outer[i, j] == 0:
                continue
            own, certain = log_odds[i, j], inner[i, j] > 0 and log_odds[i, j] > BOUNDARY.unsure
            n, m = i // 2, j // 2
            if colours.share[n, m] > BOUNDARY.least_share and hall[i, j, 0] > 0:
                mixed = BOUNDARY.independence * _mixture_log_odds(
                    frame[i, j], hall[i, j], colours.mean[n, m], colours.variance[n, m], colours.hall_variance[n, m]
                )
                certain = certain and mixed > BOUNDARY.doubt
                own = hint[i, j] + min(max(mixed, -largest), largest)
            if certain:
                probability[i, j] = 1.0
                continue
            probability[i, j] = 1.0 / (1.0 + np.exp(-own))
            if 0 < i < height - 1 and 0 < j < width - 1:
                undecided[count, 0], undecided[count, 1] = i, j
                count += 1
    return probability, count


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _mixture_log_odds(here: Image, wall: Image, body: Float32, variance: Float32, hall_variance: Float32) -> float:
    """Log-odds that a pixel (3,) is body by half or more: the hall has the colour ``wall`` there, with
    ``hall_variance``, and the body about the colour ``body``, with ``variance``."""
    hall, athlete = BOUNDARY.least_likelihood, BOUNDARY.least_likelihood
    for part in BOUNDARY.parts:
        squares, volume = 0.0, 1.0
        for c in range(3):
            empty = float(wall[c])
            mixed = part * part * variance[c] + (1.0 - part) ** 2 * hall_variance[c] + BOUNDARY.colour_variance
            squares += (float(here[c]) - empty - part * (body[c] - empty)) ** 2 / mixed
            volume *= mixed
        likelihood = np.exp(-0.5 * squares) / np.sqrt(volume)
        if part > 0.5:
            athlete += likelihood
        else:
            hall += likelihood
    return float(np.log(athlete / hall))


@njit(cache=True, nogil=True, error_model="numpy")
def _random_walk(frame: Image, probability: Float32, undecided: NDArray[np.int32]) -> None:
    """Settle the ``undecided`` pixels (N, 2): each is the mean of its own probability and its neighbours', by ties."""
    count = len(undecided)
    own, ties = np.empty(count, np.float32), np.empty((count, 8), np.float32)  # with the weights of the mean
    alike = np.empty((3, 256))  # factors of a tie, for each step of each colour
    for c in range(3):
        for apart in range(256):
            alike[c, apart] = np.exp(-((BOUNDARY.edge_weight[c] * apart) ** 2) / BOUNDARY.edge_variance)
    steps = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
    for n in range(count):
        i, j = undecided[n]
        whole = 1.0
        for k in range(8):
            y, x = i + steps[k][0], j + steps[k][1]
            tie = 0.7 if k in (0, 2, 5, 7) else 1.0
            for c in range(3):
                tie *= alike[c, abs(np.int64(frame[i, j, c]) - np.int64(frame[y, x, c]))]
            ties[n, k] = tie
            whole += tie
        own[n] = probability[i, j] / whole
        for k in range(8):
            ties[n, k] /= whole
    for sweep in range(4):  # Gauss-Seidel, overrelaxed
        for m in range(count):
            n = m if sweep % 2 == 0 else count - 1 - m
            i, j = undecided[n]
            mean = own[n]
            for k in range(8):
                mean += ties[n, k] * probability[i + steps[k][0], j + steps[k][1]]
            moved = probability[i, j] + np.float32(1.1) * (mean - probability[i, j])
            probability[i, j] = min(max(moved, np.float32(0.0)), np.float32(1.0))
