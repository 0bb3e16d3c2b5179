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
    places, radius = (np.zeros((len(first), 2)), np.inf) if near is None else near
    down = np.argsort(second.points_px[:, 1])
    there, words = second.points_px[down], _words(second.descriptors)[down]
    begin, end = (np.searchsorted(there[:, 1], places[:, 1] + side) for side in (-radius, radius))
    rows = np.column_stack([begin, end])
    index = _nearest_within(_words(first.descriptors), words, places, there, rows, radius, ratio)
    paired = np.flatnonzero(index >= 0)
    return np.column_stack([paired, down[index[paired]]])


def _words(descriptors: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """Descriptors (N, B) of bytes, in words of eight."""
    return np.pad(descriptors, ((0, 0), (0, -descriptors.shape[1] % 8))).view(np.uint64)


@njit(cache=True, nogil=True)
def _nearest_within(
    first: NDArray[np.uint64], second: NDArray[np.uint64], places: Array, there: Array, rows: NDArray[np.int64],
    radius: float, ratio: float,
) -> NDArray[np.int64]:  # fmt: skip
    """(N,) the match of each descriptor (N, W) among the ``second`` (M, W), or -1. The latter lie ``there`` (M, 2);
    those between ``rows`` (N, 2) may lie near the ``places`` (N, 2) of the former."""
    most = FEATURES.max_distance
    index, of_second = np.full(len(first), -1), np.full(len(second), -1)
    nearest = np.full(len(second), _BITS)
    for i in range(len(first)):
        best = other = most + 1 if radius < np.inf else _BITS  # one that stands alone has to be near
        for j in range(rows[i, 0], rows[i, 1]):
            across, down = there[j, 0] - places[i, 0], there[j, 1] - places[i, 1]
            if across * across + down * down > radius * radius:
                continue
            distance = _bits_apart(first[i], second[j])
            if distance < best:
                best, other, index[i] = distance, best, j
            elif distance < other:
                other = distance
            if distance < nearest[j]:
                nearest[j], of_second[j] = distance, i
        if best > most or best >= ratio * other:
            index[i] = -1
    for i in range(len(first)):
        if index[i] >= 0 and of_second[index[i]] != i:
            index[i] = -1
    return index


@njit(cache=True, nogil=True)
def _bits_apart(one: NDArray[np.uint64], other: NDArray[np.uint64]) -> int:
    """Number of bits in which two descriptors differ, words added up by halves, as in Warren, Hacker's Delight (2012),
    which compilers know as one instruction."""
    count = 0
    for k in range(len(one)):
        x = one[k] ^ other[k]
        x -= (x >> _ONE) & _PAIRS
        x = (x & _FOURS) + ((x >> _TWO) & _FOURS)
        count += int((((x + (x >> _FOUR)) & _EIGHTS) * _ONES) >> _TOP)
    return count


_BITS = 512  # more than descriptors have
_ONE, _TWO, _FOUR, _TOP = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)
_PAIRS, _FOURS, _EIGHTS, _ONES = (np.uint64(0xFFFFFFFFFFFFFFFF // n) for n in (3, 5, 17, 255))


def densest(values: Array, width: float) -> Mask:
    """Select those of ``values`` (N,) that lie in the fullest interval of length ``width``."""
    order = np.sort(values)
    counts = np.searchsorted(order, order + width, side="right") - np.arange(len(order))
    start = order[int(np.argmax(counts))]
    return (values >= start) & (values <= start + width)
