"""Silhouettes: what in a frame is not the empty hall, as the panorama shows it through the estimated camera (stage 5).

Per pixel three explanations compete, each with its likelihood: the hall (the warped panorama, its gain matched, with
noise that grows with brightness and, where the picture is steep, with the camera's error); the hall in shadow (on the
floor alone: darker by one factor over a small window); and the body (any colour). Where the body was predicted the
tracker's confidence enters as prior log-odds. At last the outline is put where the mixture of the body's colour just
inside and the hall's is one half (the matte).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.camera import at
from pzcap.cylinder import warp_background
from pzcap.types import Array, Camera, Image, Localisation, Mask, Panorama, PanZoomCamera, Silhouette

Float32 = NDArray[np.float32]

LARGEST: Final = 6.0
"""No pixel alone says more, for or against, than these log-odds."""
LOG_ODDS_STEPS: Final = 20


@dataclass(frozen=True, slots=True)
class ForegroundConfig:
    """Defaults suit 8-bit video; the noise is scaled to the footage automatically."""

    read_noise: float = 3.0  # grey levels, with what compression adds
    shot_noise: float = 0.15  # variance a grey level
    camera_error_px: float = 0.5  # with blur and parallax that the panorama does not have
    prior_log_odds: float = -1.0  # of body anywhere, nothing predicted
    floor_range_m: float = 25.0  # where shadows are expected
    shadow_darkest: float = 0.35  # of the light that is left
    prediction_sigma_px: float = 4.0
    prediction_floor: float = 2.5  # log-odds that a prediction speaks with at most


def separate(
    image: Image,
    panorama: Panorama,
    camera: PanZoomCamera,
    localisation: Localisation,
    config: ForegroundConfig,
) -> Silhouette:
    """Tell the athlete from the hall in one view. Invalid where the localisation is."""
    background, known = warp_background(
        panorama, camera, localisation.pan_rad, localisation.tilt_rad, localisation.focal_px
    )
    if not localisation.valid:
        return Silhouette(np.zeros(image.shape[:2], np.uint8), background, False)
    view = at(camera, localisation.pan_rad, localisation.tilt_rad, localisation.focal_px)
    blur = 0.45 * np.sqrt(max((localisation.focal_px / panorama.px_per_rad) ** 2 - 1.0, 0.0))
    return subtract(image, background, known, view, blur, config)


def subtract(
    image: Image,
    background: Image,
    known: Mask,
    camera: Camera,
    blur_px: float,
    config: ForegroundConfig,
) -> Silhouette:
    """Tell the athlete from the hall, given the empty hall in this very view.

    ``background`` (H, W, 3) counts where it is ``known`` (H, W). ``blur_px`` is how much softer (sigma) it is than the
    frame: a panorama at twice its own magnification has no finer detail to give.
    """
    matched = match_gain(image, background, known)
    log_odds = _log_odds(image, matched, known, camera, 0, 0, blur_px, config) + np.float32(config.prior_log_odds)
    cv2.blur(log_odds, (3, 3), log_odds)
    return Silhouette(_matte(image, matched, log_odds), matched, True)


def evidence(
    image: Image, background: Image, camera: Camera, left: int, top: int, config: ForegroundConfig
) -> NDArray[np.int8]:
    """What the colours of a cut-out alone say: log-odds of body (h, w) in steps of 1 / LOG_ODDS_STEPS.

    ``image`` and ``background`` (h, w, 3; of `Silhouette`) are cut out with their top-left pixel at ``(left, top)``.
    Black background counts as unknown.
    """
    known = np.asarray(cv2.cvtColor(background, cv2.COLOR_BGR2GRAY) > 0, bool)
    return np.asarray(
        np.rint(LOG_ODDS_STEPS * _log_odds(image, background, known, camera, left, top, 0.0, config)), np.int8
    )


def refine(
    image: Image, background: Image, colours: NDArray[np.int8], predicted: Array | Float32, config: ForegroundConfig
) -> Image:
    """A second look at a cut-out of a view, the body's outline now predicted: the new probability (h, w).

    ``colours`` is their `evidence`; ``predicted`` (h, w) the signed distance, in pixels and positive inside, to the
    outline that the tracker expects.
    """
    say = np.clip(predicted * (2.0 / config.prediction_sigma_px), -config.prediction_floor, config.prediction_floor)
    log_odds = colours * np.float32(1.0 / LOG_ODDS_STEPS) + say.astype(np.float32)
    cv2.blur(log_odds, (3, 3), log_odds)
    return _matte(image, background, log_odds)


def match_gain(image: Image, background: Image, known: Mask) -> Image:
    """The background as bright as the frame: an exposure and what vignetting the panorama does not share, both from
    the pixels that agree. No offset: blur would corrupt it."""
    height, width = known.shape
    small = (max(width // 8, 1), max(height // 8, 1))
    frame = cv2.resize(image, small, interpolation=cv2.INTER_AREA).astype(np.float32).sum(axis=2)
    hall = cv2.resize(background, small, interpolation=cv2.INTER_AREA).astype(np.float32).sum(axis=2)
    cover = cv2.resize(known.astype(np.float32), small, interpolation=cv2.INTER_AREA)
    x = (np.arange(small[0]) - (small[0] - 1) / 2) / (small[0] / 2)
    y = (np.arange(small[1]) - (small[1] - 1) / 2) / (small[0] / 2)
    r2 = y[:, None] ** 2 + x[None, :] ** 2
    usable = (cover > 0.99) & (hall > 45) & (frame > 45) & (hall < 720)
    if usable.sum() < 50:
        return background
    basis = np.stack([np.ones_like(r2), r2], axis=-1)
    a, b = basis[usable], np.log(frame[usable] / hall[usable])
    weight = np.sqrt(hall[usable])
    solution = np.array([np.median(b), 0.0])
    for scale in (0.15, 0.08, 0.05, 0.04):
        robust = weight / (1.0 + ((b - a @ solution) / scale) ** 2) ** 2
        solution = np.linalg.solve((a * robust[:, None]).T @ a + 1e-6 * np.eye(2), (a * robust[:, None]).T @ b)
    gain = cv2.resize(np.exp(basis @ solution).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.multiply(background, cv2.merge([gain] * 3), dtype=cv2.CV_8U), np.uint8)


def _floor_plane(camera: Camera, left: int, top: int, reach_m: float) -> Array:
    """Coefficients (3,) of column, row and 1: negative where a pixel's ray meets the floor within reach."""
    turn = camera.world_T_cam[2, :3]
    principal = camera.principal_px - np.array([left, top])
    slope = turn[:2] / camera.focal_px
    return np.array([slope[0], slope[1], turn[2] - slope @ principal + camera.world_T_cam[2, 3] / reach_m])


def _log_odds(
    image: Image,
    background: Image,
    known: Mask,
    camera: Camera,
    left: int,
    top: int,
    blur_px: float,
    config: ForegroundConfig,
) -> Float32:
    """Log-odds of body, from the colours alone, within +-LARGEST."""
    frame = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8) if blur_px > 0.3 else image
    grey = cv2.cvtColor(background, cv2.COLOR_BGR2GRAY)
    steep_x, steep_y = (np.asarray(g, np.int16) for g in cv2.spatialGradient(grey))
    log_odds = np.empty(known.shape, np.float32)
    residual = np.empty(known.shape, np.float32)
    squares = np.empty((*known.shape, 2), np.float32)
    variance = np.empty(known.shape, np.float32)
    _differences(
        frame, background, steep_x, steep_y, config.read_noise, config.shot_noise, config.camera_error_px, residual,
        variance, squares,
    )  # fmt: skip
    # heavy compression or a camera that is further off makes everything noisier alike
    sampled = residual[::4, ::4][known[::4, ::4]]
    scale = max(float(np.median(sampled)) / 2.37, 1.0) if sampled.size else 1.0  # chi-square of three: median 2.37
    floor = _floor_plane(camera, left, top, config.floor_range_m)
    windowed = cv2.blur(squares, (7, 7))
    ratio = np.asarray(np.clip(windowed[..., 0] / np.maximum(windowed[..., 1], 1e-3), 0.0, 1.0), np.float32)
    shadowed = np.empty(known.shape, np.float32)
    _shadow(frame, background, ratio, variance, floor, config.shadow_darkest, scale, residual, shadowed)
    cv2.blur(shadowed, (5, 5), shadowed)
    np.minimum(residual / np.float32(scale), shadowed, out=log_odds)
    _judge(log_odds, known)
    return log_odds


@njit(cache=True, nogil=True)
def _differences(
    frame: Image, background: Image, steep_x: NDArray[np.int16], steep_y: NDArray[np.int16], read: float, shot: float,
    camera_error: float, residual: Float32, variance: Float32, squares: Float32,
) -> None:  # fmt: skip
    """Squared difference over its variance, summed over the colours; the products that a shadow's ratio needs."""
    height, width = residual.shape
    for i in range(height):
        for j in range(width):
            steep = (float(steep_x[i, j]) ** 2 + float(steep_y[i, j]) ** 2) / 64.0
            mean = (float(background[i, j, 0]) + float(background[i, j, 1]) + float(background[i, j, 2])) / 3.0
            noise = read * read + shot * mean + steep * camera_error * camera_error
            total = 0.0
            cross = 0.0
            own = 0.0
            for c in range(3):
                f, b = float(frame[i, j, c]), float(background[i, j, c])
                total += (f - b) ** 2
                cross += f * b
                own += b * b
            variance[i, j] = noise
            residual[i, j] = total / noise
            squares[i, j, 0] = cross / noise
            squares[i, j, 1] = own / noise


@njit(cache=True, nogil=True)
def _shadow(
    frame: Image, background: Image, ratio: Float32, variance: Float32, floor: Array, darkest: float, scale: float,
    residual: Float32, out: Float32,
) -> None:  # fmt: skip
    """Squared difference to the background darkened by ``ratio``; where there can be no shadow, a large number."""
    height, width = ratio.shape
    for i in range(height):
        for j in range(width):
            r = ratio[i, j]
            if floor[0] * j + floor[1] * i + floor[2] >= 0.0 or r < darkest or r >= 1.0:
                out[i, j] = residual[i, j] / scale
                continue
            total = 0.0
            for c in range(3):
                total += (float(frame[i, j, c]) - r * float(background[i, j, c])) ** 2
            out[i, j] = total / (variance[i, j] * scale)


@njit(cache=True, nogil=True)
def _judge(log_odds: Float32, known: Mask) -> None:
    """Turn squared differences, in place, into log-odds: none where the hall is unknown."""
    height, width = log_odds.shape
    for i in range(height):
        for j in range(width):
            log_odds[i, j] = min(max(0.5 * log_odds[i, j] - 8.0, -LARGEST), LARGEST) if known[i, j] else 0.0


_RING = np.ones((5, 5), np.uint8)
_MATTE_WINDOW = (11, 11)


def _matte(image: Image, background: Image, log_odds: Float32) -> Image:
    """Probability from log-odds; along the outline, from the mixture of the colours on either side."""
    solid = (log_odds > 0).astype(np.uint8)
    inner = np.asarray(cv2.erode(solid, _RING), np.uint8)
    outer = np.asarray(cv2.dilate(solid, _RING), np.uint8)
    masked = cv2.bitwise_and(image, image, mask=inner)
    inside = np.asarray(cv2.boxFilter(masked, cv2.CV_32F, _MATTE_WINDOW, normalize=False), np.float32)
    count = np.asarray(cv2.boxFilter(inner, cv2.CV_32F, _MATTE_WINDOW, normalize=False), np.float32)
    probability = np.empty(log_odds.shape, np.uint8)
    _mix(image, background, log_odds, inner, outer, inside, count, probability)
    return probability


@njit(cache=True, nogil=True)
def _mix(
    image: Image, background: Image, log_odds: Float32, inner: Image, outer: Image, inside: Float32, count: Float32,
    probability: Image,
) -> None:  # fmt: skip
    height, width = log_odds.shape
    for i in range(height):
        for j in range(width):
            p = 1.0 / (1.0 + np.exp(-log_odds[i, j]))
            if outer[i, j] > 0 and inner[i, j] == 0 and count[i, j] > 3:
                contrast = 0.0
                along = 0.0
                for c in range(3):
                    hall = float(background[i, j, c])
                    span = inside[i, j, c] / count[i, j] - hall
                    contrast += span * span
                    along += (float(image[i, j, c]) - hall) * span
                # where body and hall look alike the mixture says nothing
                say = contrast / (contrast + 900.0)
                p = say * min(max(along / max(contrast, 1.0), 0.0), 1.0) + (1.0 - say) * p
            probability[i, j] = int(255.0 * p + 0.5)
