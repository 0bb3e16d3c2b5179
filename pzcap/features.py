"""AKAZE features (Alcantarilla, Nuevo and Bartoli, 2013) and their matches."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, Image, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    points_px: Array  # (N, 2)
    descriptors: NDArray[np.uint8]  # (N, 61)
    brightness: Array  # (N,) mean grey level around each

    def __len__(self) -> int:
        return len(self.points_px)

    def subset(self, which: Mask | NDArray[np.int64]) -> Features:
        return Features(self.points_px[which], self.descriptors[which], self.brightness[which])


def detect(image: Image, threshold: float, limit: int, mask: Image | None = None) -> Features:
    """The ``limit`` strongest AKAZE features of ``image`` (H, W), grey, whose response exceeds ``threshold``.

    Descriptors are upright: heads of tripods do not roll, and a descriptor that need not find its orientation tells
    features apart better. ``mask`` (H, W) is 0 where no feature may lie.
    """
    detector = cv2.AKAZE.create(
        descriptor_type=cv2.AKAZE_DESCRIPTOR_MLDB_UPRIGHT, threshold=threshold, max_points=limit
    )
    keypoints, descriptors = detector.detectAndCompute(image, mask)
    if not keypoints:
        return Features(np.empty((0, 2)), np.empty((0, 61), np.uint8), np.empty(0))
    points = np.array([keypoint.pt for keypoint in keypoints])
    soft = cv2.GaussianBlur(image, (0, 0), 2.0)
    column, row = points.astype(np.float32).T.reshape(2, -1, 1)
    brightness = cv2.remap(soft.astype(np.float32), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Features(points, np.asarray(descriptors, np.uint8), brightness.ravel().astype(np.float64))


def match(first: Features, second: Features, ratio: float) -> NDArray[np.int64]:
    """Pairs (N, 2) of indices of features that are each other's nearest.

    The nearest must also be nearer than ``ratio`` times the second nearest of the second set (Lowe, 2004).
    """
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    forward = matcher.knnMatch(first.descriptors, second.descriptors, k=2)
    nearest = np.array([(best.trainIdx, best.distance, other.distance) for best, other in forward])
    backward = np.array([best.trainIdx for best in matcher.match(second.descriptors, first.descriptors)])
    index = nearest[:, 0].astype(np.int64)
    good = (nearest[:, 1] < ratio * nearest[:, 2]) & (backward[index] == np.arange(len(first)))
    return np.column_stack([np.flatnonzero(good), index[good]])


def densest(values: Array, width: float) -> Mask:
    """Which of ``values`` (N,) lie in the interval of length ``width`` that holds the most of them."""
    order = np.sort(values)
    counts = np.searchsorted(order, order + width, side="right") - np.arange(len(order))
    start = order[int(np.argmax(counts))]
    return (values >= start) & (values <= start + width)
