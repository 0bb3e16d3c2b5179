"""Silhouettes: what in a frame is not the empty hall, as the panorama shows it through the estimated camera (stage 5).

First at half the resolution: the hall's brightness is matched to the frame, and its colours say where the body is
(`pzcap.segmentation.background_model`). Where the body was predicted that enters as prior. The part with the most
evidence is the body, with what is near it for its size; holes where the hall is hardly seen are none. Then the outline
is drawn on the sharp frame (`pzcap.segmentation.boundary_refinement`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.geometry.camera import at
from pzcap.localisation.panorama_sampler import Window, warp_background
from pzcap.segmentation import boundary_refinement
from pzcap.segmentation.background_model import Compared, ForegroundConfig, compare, double, shrink
from pzcap.solver.robust import line
from pzcap.types import Array, Camera, Float32, Image, Localisation, Mask, Panorama, PanZoomCamera, Silhouette

__all__ = ["Expected", "ForegroundConfig", "match_gain", "separate", "subtract"]


EVEN: Final = 127
"""Probability (of 255) where nothing is known."""
SOFTNESS: Final = 5 / 12
"""Variance (px2 of the panorama) of its blur: pixels of the sweep (1/12), interpolated twice (1/6 each)."""
FALLING: Final = (0.15, 0.08, 0.05, 0.04)  # scales of what the log of the brightness differs by, from coarse to fine
WINDOW: Final = (3, 3)  # half pixels over which the evidence is averaged
FEWEST: Final = 30  # half pixels that show which colours the body has
MARGIN_PX: Final = 16  # kept round the body for its outline
CLOTHES_PX: Final = 4.0  # by which they may stand off a body
SMALL: Final = 8  # half pixels: a hole this small is none
HOLE: Final = -2.5  # mean log-odds: nor is one where the hall is seen no better
NEAR: Final = 0.1  # of the body's size: a part this far off needs twice the evidence to be kept
PART: Final = 0.02  # of the body's evidence, that a part needs
ALONE: Final = 0.3  # weight of the soft evidence beside the sharp frame's colours, where nothing is expected
TOGETHER: Final = (0.15, 0.3)  # where something is: of the evidence, and of what is expected


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where whoever follows the body expects it in a view, over the part of the view in which it can be."""

    left: int  # even, as are width and height: half pixels
    top: int
    distance_px: Float32  # (h, w) of half pixels, to the outline; positive inside
    sigma_px: float  # of that, for a pose that is not quite as expected

    @property
    def window(self) -> Window:
        height, width = self.distance_px.shape
        return self.left, self.top, self.left + 2 * width, self.top + 2 * height

    def covered(self, height: int, width: int) -> Mask:
        """(height, width) the pixels of the view in which the body may be."""
        left, top, right, bottom = self.window
        near = (self.distance_px > -self.sigma_px - CLOTHES_PX).astype(np.uint8)
        covered = np.zeros((height, width), np.bool_)
        covered[top:bottom, left:right] = cv2.resize(
            near, (right - left, bottom - top), interpolation=cv2.INTER_NEAREST
        )
        return covered


def separate(
    image: Image,
    panorama: Panorama,
    camera: PanZoomCamera,
    localisation: Localisation,
    config: ForegroundConfig,
    expected: Expected | None = None,
) -> Silhouette:
    """Tell the athlete from the hall in one view; only where the body is ``expected``, if somebody expects it.

    Invalid where the localisation is.
    """
    height, width = image.shape[:2]
    whole = Silhouette(
        np.zeros((height, width), np.uint8), np.zeros((height, width, 3), np.uint8),
        np.zeros((height // 2, width // 2), np.float32), localisation.valid,
    )  # fmt: skip
    if not localisation.valid:
        return whole
    pan_rad, tilt_rad, focal_px = localisation.pan_rad, localisation.tilt_rad, localisation.focal_px
    left, top, right, bottom = (0, 0, width, height) if expected is None else expected.window
    part, half = np.s_[top:bottom, left:right], np.s_[top // 2 : bottom // 2, left // 2 : right // 2]
    background, known = warp_background(panorama, camera, pan_rad, tilt_rad, focal_px, (left, top, right, bottom))
    view = at(camera, pan_rad, tilt_rad, focal_px)
    blur_px = float(np.sqrt(SOFTNESS) * focal_px / panorama.px_per_rad)
    found = subtract(image[part], background, known, view, blur_px, config, expected)
    whole.probability[part], whole.background[part] = found.probability, found.background
    whole.evidence[half] = found.evidence
    return whole


def subtract(
    image: Image,
    background: Image,
    known: Mask,
    camera: Camera,
    blur_px: float,
    config: ForegroundConfig,
    expected: Expected | None = None,
) -> Silhouette:
    """Tell the athlete from the hall, given the empty hall in this very view.

    ``background`` (H, W, 3) counts where it is ``known`` (H, W); where it is not, nothing is known of the body.
    ``blur_px`` is how soft (sigma) it is: a panorama at twice its own magnification has no finer detail to give.
    All are of the part of the view in which the body is ``expected``, or of the whole view.
    """
    matched = match_gain(image, background, known)
    if expected is None:
        half = known.shape[0] // 2, known.shape[1] // 2
        corner, prior = (0, 0), np.full(half, config.prior_log_odds, np.float32)
    else:
        corner, prior = (expected.left, expected.top), _prior(expected, config)
    hoped = None if expected is None else prior
    evidence = _judge(compare(image, matched, known, camera, corner, blur_px, config), prior, hoped)
    probability = _outlined(image, matched, evidence + prior, hoped)
    np.maximum(probability, EVEN, out=probability, where=~known)
    return Silhouette(probability, matched, evidence, True)


def _prior(expected: Expected, config: ForegroundConfig) -> Float32:
    """Log-odds (h, w) that a prediction speaks with: not too sure, and less so against the body than for it, so that a
    limb that is elsewhere is found."""
    says = expected.distance_px * np.float32(2.0 / math.hypot(config.prediction_sigma_px, expected.sigma_px))
    return np.asarray(np.clip(says, -config.prediction_against, config.prediction_for), np.float32)


def match_gain(image: Image, background: Image, known: Mask) -> Image:
    """The background as bright as the frame: an exposure and what vignetting the panorama does not share, both from
    the pixels that agree. No offset: blur would corrupt it."""
    height, width = known.shape
    cover = shrink(np.asarray(known, np.float32), 8)
    gain = np.empty((*cover.shape, 3), np.float32)
    if not _fit_gain(shrink(image, 8), shrink(background, 8), cover, gain):
        return background
    fine = cv2.resize(gain, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.multiply(background, fine, dtype=cv2.CV_8U), np.uint8)


@njit(cache=True, nogil=True)
def _fit_gain(image: Image, background: Image, cover: Float32, gain: Float32) -> bool:
    """The ``gain`` (h, w, 3) of a frame over its background (h, w, 3): ``exp(a + b r^2)`` with r the distance from the
    middle, fitted robustly, with a wide scale first. False where too little is covered."""
    height, width = cover.shape
    squared, ratio, weight = np.empty(cover.size), np.empty(cover.size), np.empty(cover.size)
    count = 0
    for i in range(height):
        for j in range(width):
            frame, hall = 0.0, 0.0
            for c in range(3):
                frame += image[i, j, c]
                hall += background[i, j, c]
            if cover[i, j] > 0.99 and 45.0 < hall < 720.0 and frame > 45.0:
                squared[count] = _radius(i, j, height, width)
                ratio[count], weight[count] = np.log(frame / hall), np.sqrt(hall)
                count += 1
    if count < 50:
        return False
    ratio, start = ratio[:count], (float(np.median(ratio[:count])), 0.0)
    a, b = line(ratio, squared[:count], weight[:count], FALLING, start)
    for i in range(height):
        for j in range(width):
            gain[i, j, :] = np.exp(a + b * _radius(i, j, height, width))
    return True


@njit(cache=True, nogil=True, inline="always")
def _radius(i: int, j: int, height: int, width: int) -> float:
    """Squared distance from the middle, in half widths."""
    y, x = (i - (height - 1) / 2) / (width / 2), (j - (width - 1) / 2) / (width / 2)
    return y * y + x * x


# --------------------------------------------------------------------------------------------------------------
# The body


def _judge(compared: Compared, prior: Float32, expected: Float32 | None) -> Float32:
    """Log-odds of body (h, w) from the colours alone. What is body whatever its colour shows which colours it has."""
    body = _body(_smooth(compared.judge() + prior), expected)
    sure = np.asarray(cv2.erode(body, np.ones((3, 3), np.uint8)), np.uint8)
    return compared.judge(sure if sure.sum() >= FEWEST else None)


def _smooth(log_odds: Float32) -> Float32:
    return np.asarray(cv2.blur(log_odds, WINDOW), np.float32)


def _body(smooth: Float32, expected: Float32 | None) -> Image:
    """1 where the body is (h, w): the part with the most evidence, what is near it for its own size, and what is where
    it was ``expected``, as a hand whose arm is hardly seen."""
    solid = np.asarray(smooth > 0, np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), connectivity=8
    )
    if count < 2:
        return solid
    mass = _weigh(np.asarray(labels, np.int32), smooth, count)
    main = int(np.argmax(mass))
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:4]
    gap = np.maximum(np.max(np.maximum(low - high[main], low[main] - high), axis=1), 0) / boxes[main, 2:4].max()
    keep = mass >= PART * mass[main] * (1.0 + (gap / NEAR) ** 2)
    if expected is not None:
        keep |= np.bincount(labels.ravel(), expected.ravel(), count) > 0.0
    keep[0] = False
    return np.asarray(cv2.bitwise_and(solid, keep.astype(np.uint8)[labels]), np.uint8)


@njit(cache=True, nogil=True)
def _weigh(labels: NDArray[np.int32], log_odds: Float32, count: int) -> Array:
    """Evidence for body in each labelled part (count,); the rest, labelled 0, has none."""
    mass = np.zeros(count)
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            if labels[i, j] > 0 and log_odds[i, j] > 0:
                mass[labels[i, j]] += log_odds[i, j]
    return mass


def _window(body: Image) -> Window:
    """Part of the view (left, top, right, bottom) that holds the body (h, w), with a margin."""
    left, top, width, height = cv2.boundingRect(body)
    margin = MARGIN_PX // 2
    right, bottom = min(left + width + margin, body.shape[1]), min(top + height + margin, body.shape[0])
    return max(left - margin, 0), max(top - margin, 0), right, bottom


def _filled(solid: Image, log_odds: Float32, expected: Float32 | None) -> Image:
    """``solid`` (h, w) without holes that are small, or in which the hall is hardly seen and none was ``expected``."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(1 - solid, connectivity=4)
    area = boxes[:, 4]
    mean = np.bincount(labels.ravel(), log_odds.ravel(), count) / np.maximum(area, 1)
    within = (boxes[:, 0] > 0) & (boxes[:, 1] > 0)
    within &= (boxes[:, :2] + boxes[:, 2:4] < np.array(solid.shape)[::-1]).all(axis=1)
    hardly = mean > HOLE
    if expected is not None:  # as between an arm and the trunk
        hardly &= np.bincount(labels.ravel(), expected.ravel(), count) > 0.0
    fill = within & ((area < SMALL) | hardly)
    fill[0] = False  # the body itself
    return solid | fill[labels].astype(np.uint8)


def _outlined(image: Image, background: Image, log_odds: Float32, expected: Float32 | None) -> Image:
    """Probability of body (H, W), its outline drawn on the sharp frame; ``log_odds`` and what was ``expected`` of it
    (h, w) are half as fine."""
    probability = np.zeros(image.shape[:2], np.uint8)
    smooth = _smooth(log_odds)
    body = _body(smooth, expected)
    if not body.any():
        return probability
    left, top, right, bottom = _window(body)
    part, half = np.s_[2 * top : 2 * bottom, 2 * left : 2 * right], np.s_[top:bottom, left:right]
    solid = _filled(body[half], smooth[half], None if expected is None else expected[half])
    hint = ALONE * smooth if expected is None else TOGETHER[0] * smooth + TOGETHER[1] * expected
    soft, hint, firm = (double(one) for one in (smooth[half], hint[half], solid.astype(np.float32)))
    drawn = boundary_refinement.draw(image[part], background[part], soft, hint, (firm > 0.5).astype(np.uint8))
    probability[part] = np.rint(255.0 * drawn)
    return probability
