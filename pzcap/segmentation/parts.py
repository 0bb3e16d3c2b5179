"""Parts of a view that are body by their colours: which of them are the athlete, and which of their holes are not."""

from __future__ import annotations

import cv2
import numpy as np

from pzcap.segmentation.tuning import BODY
from pzcap.types import Float32, Image


def main_parts(smooth: Float32, expected: Float32 | None) -> Image:
    """Mask (h, w) of the body, 1 or 0: the part with the most evidence, what is near it for its own size, and what is
    where it was ``expected``, as a hand whose arm is hardly seen."""
    solid = np.asarray(smooth > 0, np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), connectivity=8
    )
    if count < 2:
        return solid
    mass = np.bincount(labels.ravel(), np.maximum(smooth, 0.0).ravel(), count)
    mass[0] = 0.0  # the hall
    main = int(np.argmax(mass))
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:4]
    gap = np.maximum(np.max(np.maximum(low - high[main], low[main] - high), axis=1), 0) / boxes[main, 2:4].max()
    keep = mass >= BODY.least_part * mass[main] * (1.0 + (gap / BODY.near) ** 2)
    if expected is not None:
        keep |= np.bincount(labels.ravel(), expected.ravel(), count) > 0.0
    keep[0] = False
    return np.asarray(cv2.bitwise_and(solid, keep.astype(np.uint8)[labels]), np.uint8)


def without_holes(solid: Image, log_odds: Float32, expected: Float32 | None) -> Image:
    """``solid`` (h, w) without holes that are small, or in which the hall is hardly seen and none was ``expected``."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(1 - solid, connectivity=4)
    area = boxes[:, 4]
    mean = np.bincount(labels.ravel(), log_odds.ravel(), count) / np.maximum(area, 1)
    within = (boxes[:, 0] > 0) & (boxes[:, 1] > 0)
    within &= (boxes[:, :2] + boxes[:, 2:4] < np.array(solid.shape)[::-1]).all(axis=1)
    hardly = mean > BODY.hole_log_odds
    if expected is not None:  # as between an arm and the trunk
        hardly &= np.bincount(labels.ravel(), expected.ravel(), count) > 0.0
    fill = within & ((area < 8) | hardly)
    fill[0] = False  # the body itself
    return solid | fill[labels].astype(np.uint8)
