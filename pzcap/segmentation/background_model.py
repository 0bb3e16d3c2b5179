"""Likelihoods of a frame's colours under body and hall, at half its resolution.

Three explanations of a pixel compete: the hall (blurred like the frame, with noise that grows where the picture is
steep, and heavy tails); the hall in shadow (on the floor alone: darker by one factor over a small window); and the body
(the colours of what is certainly body in this frame, or any colour).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeVar, cast

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.segmentation.tuning import BACKGROUND
from pzcap.types import Array, Camera, Float32, Image, Mask

Pixels = TypeVar("Pixels", Image, Float32)

COLOUR_LEVELS: Final = 32  # of each colour in a palette (COLOUR_LEVELS, COLOUR_LEVELS, COLOUR_LEVELS)
_LOG_COLOURS: Final = np.float32(3.0 * np.log(256))
_SHADOW_LIGHT: Final = float(np.log(BACKGROUND.shadow_light))


@dataclass(frozen=True, slots=True)
class ForegroundConfig:
    """Defaults suit 8-bit video; the noise is scaled to the footage automatically."""

    noise: float = 1.8
    """Grey levels, standard deviation of a colour between frame and hall where the picture is even."""
    prior_log_odds: float = -1.0
    """Log-odds of body anywhere while nothing is predicted: it covers less than the hall does."""
    prediction_sigma_px: float = 1.0
    """Pixels, error of a predicted outline where the pose is right: that of the body's shape."""
    others: bool = True
    """Take foreground that is far from the expected body and larger than a limb for somebody else: unknown."""


def shrink(values: Pixels, by: int) -> Pixels:
    """(H, W, ...) at so many times less the resolution; last rows or columns that fill no pixel are left out."""
    height, width = values.shape[0] // by, values.shape[1] // by
    whole = values[: by * height, : by * width]
    return cast(Pixels, cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def double(values: Float32) -> Float32:
    """(h, w) at twice the resolution, (2 h, 2 w)."""
    height, width = values.shape
    return np.asarray(cv2.resize(values, (2 * width, 2 * height), interpolation=cv2.INTER_LINEAR), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A frame at half its resolution and as blurred as the hall, with the likelihood of its colours under the hall."""

    frame: Image  # (h, w, 3)
    likelihood: Float32  # (h, w) log-density of the frame under the hall, lit or in shadow
    known: Image  # (h, w) 1 where the hall is known

    def log_odds(self, body: Image | None = None) -> Float32:
        """Log-odds of body (h, w), which has the colours of what is certainly body, where ``body`` (h, w) is not 0;
        without that it may have any."""
        palette = np.zeros((COLOUR_LEVELS,) * 3, np.float32)
        if body is not None:
            counts = np.zeros(palette.shape, np.int64)
            count_colours(self.frame, body, counts)
            palette = log_shares(counts)
        log_odds = np.empty(self.likelihood.shape, np.float32)
        _body_log_odds(self.frame, self.likelihood, self.known, palette, log_odds)
        return log_odds


def compare(
    image: Image, background: Image, known: Mask, camera: Camera, corner: tuple[int, int], blur_px: float,
    config: ForegroundConfig,
) -> Compared:  # fmt: skip
    """Likelihood under the empty hall of a view, or of a part of it whose top-left pixel stands at ``corner`` (x, y).

    ``background`` (H, W, 3) counts where it is ``known`` (H, W). ``blur_px`` is its blur (sigma).
    """
    frame, hall, sure = (shrink(one, 2) for one in (image, background, known.astype(np.uint8)))
    if blur_px > 0.6:
        frame = np.asarray(cv2.GaussianBlur(frame, (0, 0), blur_px / 2), np.uint8)
    steep_x, steep_y = (np.asarray(g, np.int16) for g in cv2.spatialGradient(cv2.cvtColor(hall, cv2.COLOR_BGR2GRAY)))
    variance, squares = np.empty(sure.shape, np.float32), np.empty((*sure.shape, 3), np.float32)
    _colour_differences(frame, hall, steep_x, steep_y, config.noise, BACKGROUND.camera_error_px / 2, variance, squares)
    # heavy compression or a camera that is further off makes everything noisier alike
    sampled = (squares[::2, ::2, 2] / variance[::2, ::2])[sure[::2, ::2] > 0]
    if sampled.size:
        variance *= np.float32(max(float(np.median(sampled)) / BACKGROUND.median, 1.0))
    windowed = np.asarray(cv2.blur(squares, (3, 3)), np.float32)  # a shadow is even over so much
    floor = floor_plane(camera, BACKGROUND.floor_range_m) @ np.array(
        [[2.0, 0.0, corner[0] + 0.5], [0.0, 2.0, corner[1] + 0.5], [0.0, 0.0, 1.0]]
    )
    likelihood = np.empty(sure.shape, np.float32)
    _hall_likelihood(frame, hall, variance, squares, windowed, floor, likelihood)
    return Compared(frame, likelihood, sure)


def floor_plane(camera: Camera, reach_m: float) -> Array:
    """Coefficients (3,) of column, row and 1 whose sum is negative where a pixel's ray meets the floor within reach."""
    turn = camera.world_T_cam[2, :3]
    slope = turn[:2] / camera.focal_px
    return np.array([*slope, turn[2] - slope @ camera.principal_px + camera.world_T_cam[2, 3] / reach_m])


@njit(cache=True, nogil=True)
def _colour_differences(
    frame: Image, hall: Image, steep_x: NDArray[np.int16], steep_y: NDArray[np.int16], noise: float, error: float,
    variance: Float32, squares: Float32,
) -> None:  # fmt: skip
    """Fill in a colour's ``variance`` (h, w) and ``squares`` (h, w, 3): the products of frame and hall and of the hall
    with itself, whose ratio is a shadow's light, and the squared difference."""
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
def _hall_likelihood(
    frame: Image, hall: Image, variance: Float32, squares: Float32, windowed: Float32, floor: Array,
    likelihood: Float32,
) -> None:  # fmt: skip
    """Fill in the log-density of the frame under the better of the two: the hall as it is, or in shadow on its
    ``floor`` (3,), which is that of `floor_plane`, of half pixels."""
    freedom, shadow = BACKGROUND.freedom, BACKGROUND.shadow_log_odds
    height, width = likelihood.shape
    exponent = -0.5 * (freedom + 3.0)
    for i in range(height):
        for j in range(width):
            spread = variance[i, j]
            best = exponent * np.log(1.0 + squares[i, j, 2] / (freedom * spread))
            cross, own = windowed[i, j, 0], windowed[i, j, 1]
            if best < shadow and 0.2 * own < cross < own and floor[0] * j + floor[1] * i + floor[2] < 0.0:
                light = cross / own
                apart = 0.0
                for c in range(3):
                    apart += (float(frame[i, j, c]) - light * float(hall[i, j, c])) ** 2
                usual = (np.log(light) - _SHADOW_LIGHT) / BACKGROUND.shadow_spread
                dark = exponent * np.log(1.0 + apart / (freedom * spread)) + shadow - 0.5 * usual * usual
                best = max(best, dark)
            likelihood[i, j] = best + BACKGROUND.peak - 1.5 * np.log(spread)


@njit(cache=True, nogil=True)
def count_colours(frame: Image, where: Image, counts: NDArray[np.int64]) -> None:
    """Add to ``counts`` each colour of ``frame`` (h, w, 3) ``where`` (h, w) is not 0."""
    height, width = where.shape
    cell = 256 // COLOUR_LEVELS
    for i in range(height):
        for j in range(width):
            if where[i, j] > 0:
                counts[frame[i, j, 0] // cell, frame[i, j, 1] // cell, frame[i, j, 2] // cell] += 1


@njit(cache=True, nogil=True)
def log_shares(counts: NDArray[np.int64]) -> Float32:
    """Logarithm of each colour's share among those counted, over that of an even distribution. A colour counts for the
    cells around its own as well: half as much on either side."""
    total = counts.sum()
    shares = np.zeros(counts.shape)
    last = COLOUR_LEVELS - 1
    for a in range(COLOUR_LEVELS):
        for b in range(COLOUR_LEVELS):
            for c in range(COLOUR_LEVELS):
                if counts[a, b, c] == 0:
                    continue
                for da in range(-1, 2):
                    for db in range(-1, 2):
                        for dc in range(-1, 2):
                            near = 1.0 / (8 << (abs(da) + abs(db) + abs(dc)))
                            at = min(max(a + da, 0), last), min(max(b + db, 0), last), min(max(c + dc, 0), last)
                            shares[at] += near * counts[a, b, c]
    odds = (1.0 - BACKGROUND.any_colour) * shares / total * COLOUR_LEVELS**3
    return np.log(BACKGROUND.any_colour + odds).astype(np.float32)


@njit(cache=True, nogil=True)
def _body_log_odds(frame: Image, likelihood: Float32, known: Image, palette: Float32, log_odds: Float32) -> None:
    """Fill in the log-odds of body, given the ``palette`` of its colours: 0 where the hall is unknown."""
    height, width = likelihood.shape
    cell, largest = 256 // COLOUR_LEVELS, BACKGROUND.largest_log_odds
    for i in range(height):
        for j in range(width):
            if known[i, j] == 0:
                log_odds[i, j] = 0.0
                continue
            body = palette[frame[i, j, 0] // cell, frame[i, j, 1] // cell, frame[i, j, 2] // cell]
            log_odds[i, j] = min(max(body - _LOG_COLOURS - likelihood[i, j], -largest), largest)
