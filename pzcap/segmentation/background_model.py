"""What the colours of a frame say about body or hall, at half its resolution.

Per pixel three explanations compete, each with its likelihood: the hall (the frame made as soft as it is, with noise
that grows where the picture is steep, and heavy tails); the hall in shadow (on the floor alone: darker by one factor
over a small window); and the body (the colours of what is surely body in this frame, or any colour).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeVar, cast

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.types import Array, Camera, Float32, Image, Mask

Pixels = TypeVar("Pixels", Image, Float32)

LARGEST: Final = 8.0
"""No pixel alone says more, for or against, than these log-odds."""
FREEDOM: Final = 4.0  # of the t-distribution of what the hall differs by: compression and edges err far at times
PEAK: Final = -2.6  # its log-density at 0, of three colours of variance 1
TYPICAL: Final = 2.78  # median of the squared difference over the variance of a colour, if that is right
LEVELS: Final = 32  # of each colour in a palette
ANY_COLOUR: Final = 0.2  # share of colours that the body may have besides those seen
EVENLY: Final = np.float32(3.0 * np.log(256))  # less the log-density of a colour that may be any
SHADOW_WINDOW: Final = (3, 3)  # half pixels over which a shadow is even


@dataclass(frozen=True, slots=True)
class ForegroundConfig:
    """Defaults suit 8-bit video; the noise is scaled to the footage automatically."""

    noise: float = 1.8
    """Grey levels by which the frame and an even hall differ."""
    camera_error_px: float = 0.22
    """With parallax that the panorama does not have."""
    prior_log_odds: float = -1.0
    """Of body anywhere, nothing predicted."""
    floor_range_m: float = 25.0
    """Where shadows are expected."""
    shadow_log_odds: float = -2.5
    """Of shadow against none, there."""
    shadow_light: float = 0.65
    """That a shadow leaves."""
    shadow_spread: float = 0.3
    """Of its logarithm."""
    prediction_sigma_px: float = 1.0
    """Of a predicted outline where the pose is right."""
    prediction_for: float = 3.5
    """Log-odds that a prediction speaks with at most, for the body."""
    prediction_against: float = 1.5
    """And against it."""


def shrink(values: Pixels, by: int) -> Pixels:
    """(H, W, ...) at so many times less the resolution; last rows or columns that fill no pixel are left out."""
    height, width = values.shape[0] // by, values.shape[1] // by
    whole = values[: by * height, : by * width]
    return cast(Pixels, cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def halve(values: Pixels) -> Pixels:
    """(H, W, ...) at half the resolution; an odd last row or column is left out."""
    return shrink(values, 2)


def double(values: Float32) -> Float32:
    """Undo `halve`: (h, w) to (2 h, 2 w)."""
    height, width = values.shape
    return np.asarray(cv2.resize(values, (2 * width, 2 * height), interpolation=cv2.INTER_LINEAR), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A frame at half its resolution and as soft as the hall, and how likely the hall makes its colours."""

    frame: Image  # (h, w, 3)
    likelihood: Float32  # (h, w) log-density of what is seen, if it is the hall, lit or in shadow
    known: Image  # (h, w) 1 where the hall is known

    def judge(self, where: Image | None = None) -> Float32:
        """Log-odds of body (h, w) within +-LARGEST. ``where`` (h, w) is not 0 in what is surely body: that is what
        colours the body has. Without it, it may have any colour."""
        palette = np.zeros((LEVELS,) * 3, np.float32)
        if where is not None:
            counts = np.zeros(palette.shape, np.int64)
            count_colours(self.frame, where, counts)
            palette = log_shares(counts)
        log_odds = np.empty(self.likelihood.shape, np.float32)
        _judge(self.frame, self.likelihood, self.known, palette, log_odds)
        return log_odds


def compare(
    image: Image,
    background: Image,
    known: Mask,
    camera: Camera,
    corner: tuple[int, int],
    blur_px: float,
    config: ForegroundConfig,
) -> Compared:
    """How well the empty hall explains a view, or a part of it whose top-left pixel stands at ``corner`` (x, y).

    ``background`` (H, W, 3) counts where it is ``known`` (H, W). ``blur_px`` is how soft (sigma) it is.
    """
    frame, hall, sure = _blurred(halve(image), blur_px / 2), halve(background), halve(known.astype(np.uint8))
    steep_x, steep_y = (np.asarray(g, np.int16) for g in cv2.spatialGradient(cv2.cvtColor(hall, cv2.COLOR_BGR2GRAY)))
    variance, squares = np.empty(sure.shape, np.float32), np.empty((*sure.shape, 3), np.float32)
    _differences(frame, hall, steep_x, steep_y, config.noise, config.camera_error_px / 2, variance, squares)
    # heavy compression or a camera that is further off makes everything noisier alike
    sampled = (squares[::2, ::2, 2] / variance[::2, ::2])[sure[::2, ::2] > 0]
    if sampled.size:
        variance *= np.float32(max(float(np.median(sampled)) / TYPICAL, 1.0))
    windowed = np.asarray(cv2.blur(squares, SHADOW_WINDOW), np.float32)
    shadow = np.array([config.shadow_log_odds, np.log(config.shadow_light), config.shadow_spread])
    floor = floor_plane(camera, config.floor_range_m) @ np.array(
        [[2.0, 0.0, corner[0] + 0.5], [0.0, 2.0, corner[1] + 0.5], [0.0, 0.0, 1.0]]
    )
    likelihood = np.empty(sure.shape, np.float32)
    _explain(frame, hall, variance, squares, windowed, floor, shadow, likelihood)
    return Compared(frame, likelihood, sure)


def floor_plane(camera: Camera, reach_m: float) -> Array:
    """Coefficients (3,) of column, row and 1: negative where a pixel's ray meets the floor within reach."""
    turn = camera.world_T_cam[2, :3]
    slope = turn[:2] / camera.focal_px
    return np.array([*slope, turn[2] - slope @ camera.principal_px + camera.world_T_cam[2, 3] / reach_m])


def _blurred(image: Image, sigma: float) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8) if sigma > 0.3 else image


@njit(cache=True, nogil=True)
def _differences(
    frame: Image, hall: Image, steep_x: NDArray[np.int16], steep_y: NDArray[np.int16], noise: float, error: float,
    variance: Float32, squares: Float32,
) -> None:  # fmt: skip
    """A colour's variance; the products that a shadow's ratio needs, and the squared difference."""
    height, width = variance.shape
    for i in range(height):
        for j in range(width):
            steep = (float(steep_x[i, j]) ** 2 + float(steep_y[i, j]) ** 2) / 64.0
            variance[i, j] = noise * noise + steep * error * error
            cross, own, apart = 0.0, 0.0, 0.0
            for c in range(3):
                f, b = float(frame[i, j, c]), float(hall[i, j, c])
                cross += f * b
                own += b * b
                apart += (f - b) ** 2
            squares[i, j, 0], squares[i, j, 1], squares[i, j, 2] = cross, own, apart


@njit(cache=True, nogil=True, error_model="numpy")
def _explain(
    frame: Image, hall: Image, variance: Float32, squares: Float32, windowed: Float32, floor: Array, shadow: Array,
    likelihood: Float32,
) -> None:  # fmt: skip
    """Log-density of what is seen, by the better of the two: the hall as it is, or darkened as by a shadow."""
    height, width = likelihood.shape
    exponent = -0.5 * (FREEDOM + 3.0)
    for i in range(height):
        for j in range(width):
            spread = variance[i, j]
            best = exponent * np.log(1.0 + squares[i, j, 2] / (FREEDOM * spread))
            cross, own = windowed[i, j, 0], windowed[i, j, 1]
            if best < shadow[0] and 0.2 * own < cross < own and floor[0] * j + floor[1] * i + floor[2] < 0.0:
                light = cross / own
                apart = 0.0
                for c in range(3):
                    apart += (float(frame[i, j, c]) - light * float(hall[i, j, c])) ** 2
                usual = (np.log(light) - shadow[1]) / shadow[2]
                dark = exponent * np.log(1.0 + apart / (FREEDOM * spread)) + shadow[0] - 0.5 * usual * usual
                best = max(best, dark)
            likelihood[i, j] = best + PEAK - 1.5 * np.log(spread)


@njit(cache=True, nogil=True)
def count_colours(frame: Image, where: Image, counts: NDArray[np.int64]) -> None:
    """Add to ``counts`` (LEVELS, LEVELS, LEVELS) each colour of ``frame`` (h, w, 3) ``where`` (h, w) is not 0."""
    height, width = where.shape
    cell = 256 // LEVELS
    for i in range(height):
        for j in range(width):
            if where[i, j] > 0:
                counts[frame[i, j, 0] // cell, frame[i, j, 1] // cell, frame[i, j, 2] // cell] += 1


@njit(cache=True, nogil=True)
def log_shares(counts: NDArray[np.int64]) -> Float32:
    """The share of each colour among those counted, over that of an even distribution: the logarithm. A colour counts
    for the cells around its own as well: half as much on either side."""
    total = counts.sum()
    shares = np.zeros((LEVELS, LEVELS, LEVELS))
    last = LEVELS - 1
    for a in range(LEVELS):
        for b in range(LEVELS):
            for c in range(LEVELS):
                if counts[a, b, c] == 0:
                    continue
                for da in range(-1, 2):
                    for db in range(-1, 2):
                        for dc in range(-1, 2):
                            near = 1.0 / (8 << (abs(da) + abs(db) + abs(dc)))
                            at = min(max(a + da, 0), last), min(max(b + db, 0), last), min(max(c + dc, 0), last)
                            shares[at] += near * counts[a, b, c]
    palette = np.full((LEVELS, LEVELS, LEVELS), np.float32(np.log(ANY_COLOUR)))
    for a in range(LEVELS):
        for b in range(LEVELS):
            for c in range(LEVELS):
                if shares[a, b, c] > 0.0:
                    seen = (1.0 - ANY_COLOUR) * shares[a, b, c] / total * LEVELS**3
                    palette[a, b, c] = np.log(ANY_COLOUR + seen)
    return palette


@njit(cache=True, nogil=True)
def _judge(frame: Image, likelihood: Float32, known: Image, palette: Float32, log_odds: Float32) -> None:
    """Log-odds of body, given the ``palette`` of its colours: none where the hall is unknown."""
    height, width = likelihood.shape
    cell = 256 // LEVELS
    for i in range(height):
        for j in range(width):
            if known[i, j] == 0:
                log_odds[i, j] = 0.0
                continue
            body = palette[frame[i, j, 0] // cell, frame[i, j, 1] // cell, frame[i, j, 2] // cell]
            log_odds[i, j] = min(max(body - EVENLY - likelihood[i, j], -LARGEST), LARGEST)
