"""Similarity of two pictures of one camera: features matched, a similarity fitted to them by RANSAC.

Pictures are looked at in grey and no wider than `WIDTH`: what is asked is whether they fit, not to a hundredth of a
pixel. Lengths are given in widths of the picture, so that they hold for any size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from pzcap.calibration.features import Features, match
from pzcap.command.check.tuning import VIEWS
from pzcap.types import Array, Image

WIDTH: Final = 640
ENOUGH: Final = 14  # features that agree, from which on two pictures show the same; chance gives up to ten


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture as it is compared with others."""

    picture: Image  # (h, w) grey, no wider than WIDTH
    features: Features


@dataclass(frozen=True, slots=True)
class Relation:
    """The similarity that takes the middle of one picture into another."""

    inliers: int
    across: float = 0.0  # in widths of the picture, to the right
    down: float = 0.0
    scale: float = 1.0
    turn_deg: float = 0.0

    @property
    def found(self) -> bool:
        """True where the pictures show the same."""
        return self.inliers >= ENOUGH


NOTHING: Final = Relation(0)


def small(image: Image, width: int = WIDTH) -> Image:
    """The picture in grey, no wider than ``width``."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    factor = width / grey.shape[1]
    if factor < 1.0:
        grey = cv2.resize(grey, (width, round(factor * grey.shape[0])), interpolation=cv2.INTER_AREA)
    return np.asarray(grey, np.uint8)


def view(image: Image, most: int = VIEWS.most_features) -> View:
    """A picture and its features, ``most`` at most."""
    picture = small(image)
    return View(picture, _features(picture, most))


def _features(picture: Image, most: int) -> Features:
    detector = cv2.AKAZE.create(threshold=3e-4, max_points=most)
    # the detector's threshold is one of contrast: a dark picture shall have as many features as a bright one
    gain = min(VIEWS.contrast / max(float(picture.std()), 1.0), VIEWS.most_gain)
    even = np.clip(gain * (picture.astype(np.float32) - picture.mean()) + 128.0, 0.0, 255.0).astype(np.uint8)
    points, descriptors = detector.detectAndCompute(even, None)
    if not points:
        return Features(np.empty((0, 2)), np.empty((0, 61), np.uint8), np.empty(0))
    places = np.array([point.pt for point in points])
    return Features(places, np.asarray(descriptors, np.uint8), np.zeros(len(points)))


def _coarse(whole: View) -> View:
    """The same picture, its features sought in half its size: of a long zoom those that a wide view shows as well."""
    halved = cv2.resize(whole.picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    found = _features(np.asarray(halved, np.uint8), VIEWS.most_features)
    return replace(whole, features=replace(found, points_px=2.0 * found.points_px + 0.5))


def relate(first: View, second: View) -> Relation:
    """Place of the middle of ``first`` in ``second``."""
    pairs = match(first.features, second.features, VIEWS.ratio)
    if len(pairs) < ENOUGH:
        return NOTHING
    here, there = first.features.points_px[pairs[:, 0]], second.features.points_px[pairs[:, 1]]
    cv2.setRNGSeed(1)
    similarity, agree = cv2.estimateAffinePartial2D(here, there, ransacReprojThreshold=VIEWS.tolerance_px, maxIters=500)
    if similarity is None:
        return NOTHING
    height, width = first.picture.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    moved = (similarity @ [*middle, 1.0] - middle) / width
    scale = float(np.hypot(similarity[0, 0], similarity[1, 0]))
    turn = float(np.rad2deg(np.arctan2(similarity[1, 0], similarity[0, 0])))
    if not 0.1 < scale < 10.0:
        return NOTHING
    return Relation(int(agree.sum()), float(moved[0]), float(moved[1]), scale, turn)


def step(first: Image, second: Image) -> tuple[float, float, float]:
    """By how much the picture moves from one frame to the next, across and down, in widths of the picture, and how sure
    that is, 0 to 1. By phase correlation (Kuglin and Hines, 1975): for steps of less than a third of a picture."""
    one, other = (small(image, VIEWS.step_width).astype(np.float32) for image in (first, second))
    window = cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
    (across, down), response = cv2.phaseCorrelate(one, other, window)
    return across / one.shape[1], down / one.shape[1], float(response)


def best(wanted: View, views: Sequence[View]) -> tuple[int, Relation]:
    """The view that fits ``wanted`` best, and how; its features are sought more coarsely where none fits."""
    index, relation = _best(wanted, views)
    return (index, relation) if relation.found else _best(_coarse(wanted), views)


def _best(wanted: View, views: Sequence[View]) -> tuple[int, Relation]:
    relations = [relate(wanted, each) for each in views]
    index = int(np.argmax([relation.inliers for relation in relations])) if relations else -1
    return index, relations[index] if relations else NOTHING


def mirrored(image: Image) -> Image:
    """The picture as a mirror shows it."""
    return np.ascontiguousarray(image[:, ::-1])


def overlap(first: Image, second: Image, across: float) -> tuple[Array, Array]:
    """Parts that two small pictures share, where the second has moved by ``across`` widths."""
    width = first.shape[1]
    moved = round(across * width)
    kept = width - abs(moved)
    if moved >= 0:
        return first[:, :kept].astype(float), second[:, moved:].astype(float)
    return first[:, -moved:].astype(float), second[:, :kept].astype(float)
