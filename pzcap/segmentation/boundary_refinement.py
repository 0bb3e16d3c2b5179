"""Where exactly the body ends: its outline, drawn on the sharp frame.

The evidence of `pzcap.segmentation.background_model` is as soft as the panorama, which leaves a band round the body
undecided. There a pixel is compared with the colours nearby that are surely body and with what the hall shows nearby,
and with mixtures of the two, since the pixels that the outline passes through show both: it is body if it is so by half
or more. Then it asks its neighbours, the more so the less the frame changes between them: a random walk with a prior
(Grady 2005), which settles where the frame has an edge. It works on luma and chroma, which are nearly independent;
footage has chroma at half the resolution, so luma counts for more.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.segmentation.background_model import halve
from pzcap.types import Float32, Image

BAND: Final = np.ones((5, 5), np.uint8)
"""What is within two pixels of the first guess's outline is undecided."""
UNSURE: Final = 1.5
"""So is the inside where the evidence says less than these log-odds."""
DOUBT: Final = 1.0
"""And so is what looks like the hall on the sharp frame by these: a gap too narrow for the soft evidence."""
NEARBY: Final = (7, 7)  # window of the colours nearby, in pixels of half the resolution
FEW: Final = 0.01  # share of that window which is body: with less, nothing is known of its colours
PARTS: Final = (0.0, 0.25, 0.75, 1.0)
"""Of a pixel that may be body: more than half makes it so."""
COLOUR_VARIANCE: Final = 50.0  # of luma and chroma, added to what is measured nearby
LEAST: Final = 1e-6  # of a likelihood: a colour that is neither's says nothing
SURENESS: Final = 0.7  # of a neighbourhood's colours: neighbours err together
SAY: Final = 3.0  # log-odds that they speak with at most
EDGE_WEIGHT: Final = np.array([2.5, 1.0, 1.0])  # how much a step of luma and chroma separates neighbours
EDGE_SCALE: Final = 1000.0
TIE: Final = 1.0  # between neighbours of equal colour, against each pixel's own say
SWEEPS: Final = 4
OVERSHOOT: Final = 1.1  # of a sweep's steps: gets there sooner


def draw(image: Image, background: Image, log_odds: Float32, hint: Float32, solid: Image) -> Float32:
    """Probability of body (h, w), both even, given what the colours say softly.

    ``image`` and ``background`` are (h, w, 3), ``log_odds`` (h, w) those of body, ``hint`` (h, w) what of them and of
    anything else counts where the sharp colours speak, ``solid`` (h, w) 1 where it is at first guess, else 0. Black
    background counts as unknown.
    """
    inner, outer = np.asarray(cv2.erode(solid, BAND), np.uint8), np.asarray(cv2.dilate(solid, BAND), np.uint8)
    frame, hall = (np.asarray(cv2.cvtColor(one, cv2.COLOR_BGR2YCrCb), np.uint8) for one in (image, background))
    colours = _nearby(frame, hall, inner, outer)
    probability = np.empty(solid.shape, np.float32)
    undecided = np.empty((solid.size, 2), np.int32)
    count = _start(frame, hall, log_odds, hint, inner, outer, *colours, probability, undecided)
    _walk(frame, probability, undecided[:count])
    return probability


def _nearby(frame: Image, hall: Image, inner: Image, outer: Image) -> tuple[Float32, Float32, Float32, Float32]:
    """Half as fine: mean and variance (h/2, w/2, 3) of the body's colours nearby, how much of it there is (h/2, w/2),
    and the mean square (h/2, w/2, 3) of what the hall differs by from the frame nearby."""
    half, empty = halve(frame).astype(np.float32), halve(hall).astype(np.float32)
    body = inner[::2, ::2].astype(np.float32)
    clear = ((outer[::2, ::2] == 0) & (hall[::2, ::2, 0] > 0)).astype(np.float32)
    share, mean, square = (_box(one) for one in (body, half * body[..., None], half * half * body[..., None]))
    mean /= np.maximum(share, 1e-6)[..., None]
    square = np.maximum(square / np.maximum(share, 1e-6)[..., None] - mean * mean, 0.0)
    missed = _box((half - empty) ** 2 * clear[..., None]) / np.maximum(_box(clear), 1e-6)[..., None]
    return mean, square, share, np.asarray(missed, np.float32)


def _box(values: Float32) -> Float32:
    return np.asarray(cv2.blur(values, NEARBY), np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _start(
    frame: Image, hall: Image, log_odds: Float32, hint: Float32, inner: Image, outer: Image, mean: Float32,
    square: Float32, share: Float32, missed: Float32, probability: Float32, undecided: NDArray[np.int32],
) -> int:  # fmt: skip
    """Each pixel's own probability, and which are ``undecided`` (row and column); their number is returned."""
    height, width = log_odds.shape
    count = 0
    for i in range(height):
        for j in range(width):
            if outer[i, j] == 0:
                probability[i, j] = 0.0
                continue
            say, sure = log_odds[i, j], inner[i, j] > 0 and log_odds[i, j] > UNSURE
            n, m = i // 2, j // 2
            if share[n, m] > FEW and hall[i, j, 0] > 0:
                colours = SURENESS * _mixed(frame[i, j], hall[i, j], mean[n, m], square[n, m], missed[n, m])
                sure = sure and colours > DOUBT
                say = hint[i, j] + min(max(colours, -SAY), SAY)
            if sure:
                probability[i, j] = 1.0
                continue
            probability[i, j] = 1.0 / (1.0 + np.exp(-say))
            if 0 < i < height - 1 and 0 < j < width - 1:
                undecided[count, 0], undecided[count, 1] = i, j
                count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _mixed(here: Image, empty: Image, body: Float32, spread: Float32, missed: Float32) -> float:
    """Log-odds that a pixel (3,) is body by half or more: the hall shows ``empty`` there, with a variance of
    ``missed``, and the body has about the colour ``body``, with one of ``spread``."""
    hall, athlete = LEAST, LEAST
    for part in PARTS:
        squares, volume = 0.0, 1.0
        for c in range(3):
            wall = float(empty[c])
            variance = part * part * spread[c] + (1.0 - part) ** 2 * missed[c] + COLOUR_VARIANCE
            squares += (float(here[c]) - wall - part * (body[c] - wall)) ** 2 / variance
            volume *= variance
        likelihood = np.exp(-0.5 * squares) / np.sqrt(volume)
        if part > 0.5:
            athlete += likelihood
        else:
            hall += likelihood
    return float(np.log(athlete / hall))


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(frame: Image, probability: Float32, undecided: NDArray[np.int32]) -> None:
    """Settle the ``undecided`` pixels (N, 2): each is the mean of its own say and its neighbours', by their ties."""
    count = len(undecided)
    own, ties = np.empty(count, np.float32), np.empty((count, 8), np.float32)  # shares: one with all its ties
    alike = np.empty((3, 256))  # how little a step of each colour separates neighbours
    for c in range(3):
        for apart in range(256):
            alike[c, apart] = np.exp(-((EDGE_WEIGHT[c] * apart) ** 2) / EDGE_SCALE)
    steps = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
    for n in range(count):
        i, j = undecided[n]
        whole = 1.0
        for k in range(8):
            y, x = i + steps[k][0], j + steps[k][1]
            tie = TIE * (0.7 if k in (0, 2, 5, 7) else 1.0)
            for c in range(3):
                tie *= alike[c, abs(np.int64(frame[i, j, c]) - np.int64(frame[y, x, c]))]
            ties[n, k] = tie
            whole += tie
        own[n] = probability[i, j] / whole
        for k in range(8):
            ties[n, k] /= whole
    for sweep in range(SWEEPS):
        for m in range(count):
            n = m if sweep % 2 == 0 else count - 1 - m
            i, j = undecided[n]
            mean = own[n]
            for k in range(8):
                mean += ties[n, k] * probability[i + steps[k][0], j + steps[k][1]]
            moved = probability[i, j] + np.float32(OVERSHOOT) * (mean - probability[i, j])
            probability[i, j] = min(max(moved, np.float32(0.0)), np.float32(1.0))
