"""AKAZE features (Alcantarilla, Nuevo and Bartoli, 2013) and their matching."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from pzcap.calibration.tuning import FEATURES
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


def detect(
    image: Image, threshold: float, limit: int, mask: Image | None = None, scales: tuple[int, int] = FEATURES.all_scales
) -> Features:
    """Detect the ``limit`` strongest features of ``image`` (H, W), grey, whose response exceeds ``threshold``; none
    where ``mask`` (H, W) is 0. ``scales`` are octaves, and levels in each.

    Descriptors are upright: tripod heads do not roll, and without rotation invariance they are more distinctive.
    """
    detector = cv2.AKAZE.create(
        descriptor_type=cv2.AKAZE_DESCRIPTOR_MLDB_UPRIGHT, threshold=threshold, max_points=limit,
        nOctaves=scales[0], nOctaveLayers=scales[1],
    )  # fmt: skip
    keypoints, descriptors = detector.detectAndCompute(image, mask)
    if not keypoints:
        return Features(np.empty((0, 2)), np.empty((0, 61), np.uint8), np.empty(0))
    points = np.array([keypoint.pt for keypoint in keypoints])
    soft = cv2.GaussianBlur(image, (0, 0), 2.0)
    column, row = points.astype(np.float32).T.reshape(2, -1, 1)
    brightness = cv2.remap(soft.astype(np.float32), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Features(points, np.asarray(descriptors, np.uint8), brightness.ravel().astype(np.float64))


def match(
    first: Features, second: Features, ratio: float, near: tuple[Array, float] | None = None
) -> NDArray[np.int64]:
    """Match features by mutual nearest neighbours and Lowe's ratio test (2004): pairs (N, 2) of indices.

    The nearest must be nearer than ``ratio`` times the second nearest of the second set. With ``near``, predicted
    places (len(first), 2) in the second image and a radius in pixels, only features within the radius are compared,
    which is faster and leaves fewer false matches.
    """
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), np.int64)
    within = None if near is None else (cdist(near[0], second.points_px) <= near[1]).view(np.uint8)
    both, nearest = _nearest(first.descriptors, second.descriptors, 2, within)
    (best, other), index = both.T, nearest[:, 0]
    if near is not None:  # one that stands alone in the radius has to be near
        other = np.minimum(other, FEATURES.max_distance + 1)
    good = (index >= 0) & (best < ratio * other) & (best <= FEATURES.max_distance)
    # the mutual test is needed only for those that pass the others
    asked = np.unique(index[good])
    back = np.full(len(second), -1)
    if len(asked):
        mask = None if within is None else np.ascontiguousarray(within[:, asked].T)
        back[asked] = _nearest(second.descriptors[asked], first.descriptors, 1, mask)[1][:, 0]
    good &= back[index] == np.arange(len(first))
    return np.column_stack([np.flatnonzero(good), index[good]])


def _nearest(
    first: NDArray[np.uint8], second: NDArray[np.uint8], count: int, mask: NDArray[np.uint8] | None
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Distances (N, count), in bits, of the nearest of the ``second`` descriptors, and these; -1 where the ``mask``
    (N, M) is 0 for all others."""
    distance, index = cv2.batchDistance(first, second, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=count, mask=mask)
    return np.asarray(distance, np.int32), np.asarray(index, np.int32)


def densest(values: Array, width: float) -> Mask:
    """Select those of ``values`` (N,) that lie in the fullest interval of length ``width``."""
    order = np.sort(values)
    counts = np.searchsorted(order, order + width, side="right") - np.arange(len(order))
    start = order[int(np.argmax(counts))]
    return (values >= start) & (values <= start + width)
