"""Other people in one view: regions that are neither hall nor near the expected outline of the athlete.

A region of the foreground counts as somebody else where it is larger than any limb, or leaves the part of the view that
is looked at, and stands off the expected outline by more than the prediction errs. With it goes all foreground that
hangs together with it and lies outside that outline, as arms that are reached out to the athlete.
Nothing is known there: neither hall, against which the athlete's outline would show, nor the athlete.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from pzcap.segmentation.tuning import OTHERS
from pzcap.types import Float32, Image

BESIDE: Final = 1
BEFORE: Final = 2
"""Somebody else in `pzcap.types.Silhouette.others`, and one who is nearer to the camera than the athlete."""


def other_people(log_odds: Float32, distance_px: Float32, sigma_px: float) -> Image:
    """Mask (h, w), 1 or 0, of half pixels, from the ``log_odds`` (h, w) of foreground. ``distance_px`` (h, w) is that
    from the expected outline, positive inside, of standard deviation ``sigma_px``."""
    nobody = np.zeros(log_odds.shape, np.uint8)
    size = int(np.count_nonzero(distance_px > 0.0))
    if not size:
        return nobody
    reach_px = OTHERS.apart_px + OTHERS.apart_sigmas * sigma_px
    solid = np.asarray(cv2.blur(log_odds, (3, 3)) > 0.0, np.uint8)
    far = solid & (distance_px < -reach_px).astype(np.uint8)
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(far, connectivity=8)
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:4]
    leaves = np.any((low == 0) | (high == np.array(far.shape)[::-1]), axis=1)
    keep = boxes[:, 4] >= np.where(leaves, OTHERS.leaving_share, OTHERS.whole_share) * size
    keep[0] = False  # the rest
    if not keep.any():
        return nobody
    # with the arms that are reached out from there
    outside = solid & (distance_px < -OTHERS.beside_px - sigma_px).astype(np.uint8)
    _, parts = cv2.connectedComponents(outside, connectivity=8)
    theirs = np.isin(parts, np.unique(parts[keep[labels]])) & (outside > 0)
    radius = int(np.ceil((OTHERS.beside_px + sigma_px) / 2.0)) + 1  # half pixels
    near = cv2.dilate(theirs.astype(np.uint8), np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))
    return np.asarray((near > 0) & (solid > 0) & (distance_px < 0.0), np.uint8)
