"""Pictures that a codec has repeated.

Where a camera moves by less than a pixel a frame, as in the hand of somebody who waits, a codec repeats blocks of the
picture before: it saves bits, and no eye sees it. Such a block shows where the camera was, and not where it is. All
parts of a picture are then off alike, so that its residuals do not tell; but two exposures are never the same to a grey
level, and blocks that are tell how much of a picture is no news.
"""

from __future__ import annotations

import cv2
import numpy as np

from pzcap.localisation.tuning import REPETITION
from pzcap.types import Array, Image


def repeated_share(grey: Image, before: Image) -> float:
    """Share of a picture (H, W) that is the picture ``before``: of its blocks, those whose pixels are the same to a
    grey level, each by how steep it is across. What is flat, as a lamp that outshines all, tells of no place."""
    block = REPETITION.block_px
    height, width = (size // block * block for size in grey.shape)
    grey, before = grey[:height, :width], before[:height, :width]
    changed = cv2.absdiff(grey, before) > REPETITION.levels
    same = ~changed.reshape(height // block, block, width // block, block).any(axis=(1, 3))
    slope = np.pad(cv2.absdiff(grey[:, 1:], grey[:, :-1]), ((0, 0), (0, 1))).astype(np.float32)
    steep = cv2.resize(slope * slope, (width // block, height // block), interpolation=cv2.INTER_AREA)
    return float(steep[same].sum() / max(float(steep.sum()), 1e-9))


def covariance(share: float, focal_px: float, width: int) -> Array:
    """Covariance (2, 2) of pan and log focal for the ``share`` of a picture that is repeated: the picture is shifted,
    and its edges are, by a part of a pixel that nobody knows."""
    sigma_px = REPETITION.sigma_px * np.sqrt(share)
    return np.diag([sigma_px / focal_px, sigma_px / (width / 2)]) ** 2
