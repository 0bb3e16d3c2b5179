"""Pictures that are the picture before, in part or as a whole.

Where a camera moves by less than a pixel a frame, as in the hand of somebody who waits, a codec repeats blocks of the
picture before: it saves bits, and no eye sees it. Whoever converts a variable rate, or loses pictures, repeats whole
ones. What is repeated shows where the camera was, and not where it is. All parts of a picture are then off alike, so
that its residuals do not tell; but two exposures are never the same to a grey level, and blocks that are tell how much
of a picture is no news.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pzcap.geometry.camera import wrapped
from pzcap.localisation.tuning import REPETITION
from pzcap.types import Array, Image, Localisation


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


def known_less_surely(found: Localisation, change: Array, share: float, width: int) -> Localisation:
    """A frame that was ``found``, of whose picture a ``share`` is repeated: that is shifted, and its edges are, by a
    part of a pixel that nobody knows. Where pan and log focal were to ``change`` (2,) by more than a codec passes over,
    the picture is the one before, encoded once more, and has `missed` that."""
    by_pixel = np.array([1.0 / found.focal_px, 1.0 / (width / 2)])
    shifted = share * np.diag((REPETITION.sigma_px * by_pixel) ** 2)
    is_old = share > REPETITION.most and float(np.hypot(*(change / by_pixel))) > REPETITION.missed_px
    return replace(found, covariance=found.covariance + shifted, missed=change if is_old else np.zeros(2))


def carried_on(found: Localisation) -> Localisation:
    """Place of a frame at its own instant, where its picture `missed` a change: as expected from the frames before."""
    pan_rad, focal_px = found.pan_rad + found.missed[0], found.focal_px * np.exp(found.missed[1])
    covariance = found.covariance + covariance_of(found.missed)
    return replace(found, pan_rad=float(wrapped(pan_rad)), focal_px=float(focal_px), covariance=covariance)


def covariance_of(missed: Array) -> Array:
    """Covariance (..., 2, 2) of pan and log focal where changes that pictures ``missed`` (..., 2) are made up for: they
    are known to the half of themselves, since a hand may stop within a frame."""
    sigma = 0.5 * missed
    return np.asarray(sigma[..., :, None] * sigma[..., None, :])
