"""Silhouettes: the part of a frame that is not the empty hall, as the panorama shows it through the estimated camera.

First at half the resolution: the hall's brightness is matched to the frame, and the colours give the log-odds of body
(`background_model`), with a predicted body as prior. The part with the most evidence is the body, with what is near it
for its size; holes in which the hall is hardly seen are filled. Then the boundary is refined on the sharp frame
(`boundary_refinement`).
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from pzcap.geometry.camera import at
from pzcap.localisation.panorama_sampler import place_of, warp_background
from pzcap.segmentation import boundary_refinement
from pzcap.segmentation.background_model import Compared, ForegroundConfig, compare, double, shrink
from pzcap.segmentation.expected import Expected
from pzcap.segmentation.others import other_people
from pzcap.segmentation.parts import main_parts, without_holes
from pzcap.segmentation.tuning import BACKGROUND, BODY
from pzcap.solver.robust import line
from pzcap.types import Camera, Float32, Image, Localisation, Mask, Panorama, PanZoomCamera, Silhouette

__all__ = ["ForegroundConfig", "match_gain", "separate", "subtract"]


def separate(
    image: Image, panorama: Panorama, camera: PanZoomCamera, localisation: Localisation, config: ForegroundConfig,
    expected: Expected | None = None,
) -> Silhouette:  # fmt: skip
    """Silhouette of one view, only where the body is ``expected`` if that is known. Invalid where the localisation
    is."""
    height, width = image.shape[:2]
    whole = Silhouette(
        np.zeros((height, width), np.uint8), np.zeros((height, width, 3), np.uint8),
        np.zeros((height // 2, width // 2), np.float32), localisation.valid,
        np.zeros((height // 2, width // 2), np.uint8),
    )  # fmt: skip
    if not localisation.valid:
        return whole
    place = place_of(localisation)
    left, top, right, bottom = (0, 0, width, height) if expected is None else expected.window
    part, half = np.s_[top:bottom, left:right], np.s_[top // 2 : bottom // 2, left // 2 : right // 2]
    background, known = warp_background(panorama, camera, place, (left, top, right, bottom))
    view = at(camera, *place[:4])
    # the panorama is blurred by the sweep's pixels (variance 1/12), interpolated twice (1/6 each)
    blur_px = float(np.sqrt(5 / 12) * place.focal_px / panorama.px_per_rad)
    found = subtract(image[part], background, known, view, blur_px, config, expected)
    whole.probability[part], whole.background[part] = found.probability, found.background
    whole.evidence[half], whole.others[half] = found.evidence, found.others
    return whole


def subtract(
    image: Image, background: Image, known: Mask, camera: Camera, blur_px: float, config: ForegroundConfig,
    expected: Expected | None = None,
) -> Silhouette:  # fmt: skip
    """Silhouette of a view, given the empty hall in this very view: ``background`` (H, W, 3), blurred by ``blur_px``
    (sigma). Where it is not ``known`` (H, W), nothing is known of the body.

    All are of the part of the view in which the body is ``expected``, or of the whole view.
    """
    matched = match_gain(image, background, known)
    if expected is None:
        half = known.shape[0] // 2, known.shape[1] // 2
        corner, prior, predicted = (0, 0), np.full(half, config.prior_log_odds, np.float32), None
    else:
        corner, prior = (expected.left, expected.top), _prior(expected, config)
        predicted = prior
    evidence = _evidence(compare(image, matched, known, camera, corner, blur_px, config), prior, predicted)
    probability = _probability(image, matched, evidence + prior, predicted)
    np.maximum(probability, 127, out=probability, where=~known)
    others = np.zeros(evidence.shape, np.uint8)
    if expected is not None and config.others:
        others = other_people(evidence + prior, expected.distance_px, expected.sigma_px)
        evidence[others > 0] = 0.0
    return Silhouette(probability, matched, evidence, True, others)


def _prior(expected: Expected, config: ForegroundConfig) -> Float32:
    """Log-odds (h, w) of a prediction: less against the body than for it, so that a limb that is elsewhere is found."""
    log_odds = expected.distance_px * np.float32(2.0 / math.hypot(config.prediction_sigma_px, expected.sigma_px))
    return np.asarray(np.clip(log_odds, -BACKGROUND.prediction_against, BACKGROUND.prediction_for), np.float32)


def match_gain(image: Image, background: Image, known: Mask, by: int = 8) -> Image:
    """The background as bright as the frame: exposure, and the vignetting that the panorama does not share, from the
    pixels that agree. The gain is ``exp(a + b r^2)``, r the distance from the middle. No offset: blur would corrupt
    it."""
    height, width = known.shape
    frame, hall = (shrink(one, by).sum(axis=2, dtype=np.float64) for one in (image, background))
    # neither black nor saturated
    usable = (shrink(np.asarray(known, np.float32), by) > 0.99) & (hall > 45.0) & (hall < 720.0) & (frame > 45.0)
    if usable.sum() < 50:
        return background
    rows, columns = frame.shape
    y, x = np.ogrid[:rows, :columns]
    squared = ((y - (rows - 1) / 2) / (columns / 2)) ** 2 + ((x - (columns - 1) / 2) / (columns / 2)) ** 2
    ratio = np.log(frame[usable] / hall[usable])
    start, scales = (float(np.median(ratio)), 0.0), (0.15, 0.08, 0.05, 0.04)
    a, b = line(ratio, squared[usable], np.sqrt(hall[usable]), scales, start)
    gain = cv2.resize(np.exp(a + b * squared).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.multiply(background, cv2.merge([gain] * 3), dtype=cv2.CV_8U), np.uint8)


# --------------------------------------------------------------------------------------------------------------
# The body


def _evidence(compared: Compared, prior: Float32, expected: Float32 | None) -> Float32:
    """Log-odds of body (h, w) from the colours alone: what is body whatever its colour shows which colours it has."""
    smooth = np.asarray(cv2.blur(compared.log_odds() + prior, (3, 3)), np.float32)
    body = main_parts(smooth, expected)
    certain = np.asarray(cv2.erode(body, np.ones((3, 3), np.uint8)), np.uint8)
    return compared.log_odds(certain if certain.sum() >= 30 else None)


def _probability(image: Image, background: Image, log_odds: Float32, expected: Float32 | None) -> Image:
    """Probability of body (H, W), 0..255, with the boundary of the sharp frame; ``log_odds`` and what was ``expected``
    of it (h, w) are half as fine."""
    probability = np.zeros(image.shape[:2], np.uint8)
    smooth = np.asarray(cv2.blur(log_odds, (3, 3)), np.float32)
    body = main_parts(smooth, expected)
    if not body.any():
        return probability
    x, y, width, height = cv2.boundingRect(body)
    left, top = max(x - 8, 0), max(y - 8, 0)  # room for the boundary
    right, bottom = min(x + width + 8, body.shape[1]), min(y + height + 8, body.shape[0])
    part, half = np.s_[2 * top : 2 * bottom, 2 * left : 2 * right], np.s_[top:bottom, left:right]
    solid = without_holes(body[half], smooth[half], None if expected is None else expected[half])
    if expected is None:
        hint = BODY.alone * smooth
    else:
        hint = BODY.with_expected[0] * smooth + BODY.with_expected[1] * expected
    soft, hint, firm = (double(one) for one in (smooth[half], hint[half], solid.astype(np.float32)))
    refined = boundary_refinement.refine(image[part], background[part], soft, hint, (firm > 0.5).astype(np.uint8))
    probability[part] = np.rint(255.0 * refined)
    return probability
