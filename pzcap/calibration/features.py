"""AKAZE features (Alcantarilla, Nuevo and Bartoli, 2013) and their matching."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    """Detect the ``limit`` strongest features of ``image`` (H, W), grey, whose response exceeds ``threshold``.

    Descriptors are upright: tripod heads do not roll, and descriptors without rotation invariance are more distinctive.
    ``mask`` (H, W) is 0 where no feature may lie. ``scales`` are octaves, and levels in each.
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
    if near is not None:
        index, best, other, back = _nearest_near(
            _words(first.descriptors), _words(second.descriptors), near[0], second.points_px, near[1]
        )
    else:
        matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        forward = matcher.knnMatch(first.descriptors, second.descriptors, k=2)
        index = np.array([pair[0].trainIdx for pair in forward])
        best = np.array([pair[0].distance for pair in forward])
        other = np.array([pair[1].distance for pair in forward])
        # the mutual test is needed only for those that pass the others
        asked = np.unique(index[(best < ratio * other) & (best <= FEATURES.max_distance)])
        back = np.full(len(second), -1)
        if len(asked):
            back[asked] = [pair.trainIdx for pair in matcher.match(second.descriptors[asked], first.descriptors)]
    good = (index >= 0) & (best < ratio * other) & (best <= FEATURES.max_distance)
    good &= back[index] == np.arange(len(first))
    return np.column_stack([np.flatnonzero(good), index[good]])


def _words(descriptors: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """Descriptors (N, 61) as (N, 8) words of 64 bits."""
    padded = np.zeros((len(descriptors), 64), np.uint8)
    padded[:, : descriptors.shape[1]] = descriptors
    return padded.view(np.uint64)


@njit(cache=True, nogil=True)
def _nearest_near(
    first: NDArray[np.uint64], second: NDArray[np.uint64], predicted_px: Array, points_px: Array, radius_px: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Nearest of the second set for each of the first, its distance, the second distance; nearest of the first.

    -1 and FEATURES.max_distance + 1 where there is none within the radius.
    """
    index = np.full(len(first), -1)
    best = np.full(len(first), FEATURES.max_distance + 1)
    other = np.full(len(first), FEATURES.max_distance + 1)
    back = np.full(len(second), -1)
    back_best = np.full(len(second), FEATURES.max_distance + 1)
    m1, m2, m4 = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333), np.uint64(0x0F0F0F0F0F0F0F0F)
    one, two, four, top = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)
    h01 = np.uint64(0x0101010101010101)
    for i in range(len(first)):
        for j in range(len(second)):
            dx = predicted_px[i, 0] - points_px[j, 0]
            dy = predicted_px[i, 1] - points_px[j, 1]
            if dx * dx + dy * dy > radius_px * radius_px:
                continue
            distance = np.int64(0)
            for k in range(8):
                bits = first[i, k] ^ second[j, k]
                bits = bits - ((bits >> one) & m1)
                bits = (bits & m2) + ((bits >> two) & m2)
                bits = (bits + (bits >> four)) & m4
                distance += np.int64((bits * h01) >> top)
            if distance < best[i]:
                other[i] = best[i]
                best[i] = distance
                index[i] = j
            elif distance < other[i]:
                other[i] = distance
            if distance < back_best[j]:
                back_best[j] = distance
                back[j] = i
    return index, best, other, back


def densest(values: Array, width: float) -> Mask:
    """Select those of ``values`` (N,) that lie in the fullest interval of length ``width``."""
    order = np.sort(values)
    counts = np.searchsorted(order, order + width, side="right") - np.arange(len(order))
    start = order[int(np.argmax(counts))]
    return (values >= start) & (values <= start + width)
