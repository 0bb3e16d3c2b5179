"""Duplicate frames: pictures that repeat the picture before, in part or as a whole.

Where a camera moves by less than a pixel a frame, as in the hand of somebody who waits, a codec repeats blocks of the
picture before: it saves bits, and no eye sees it. Whoever converts a variable rate, or loses pictures, repeats whole
ones. What is repeated shows where the camera was, and not where it is. All parts of a picture are then off alike, so
that its residuals do not tell; but two exposures are never the same to a grey level, and blocks that are tell how much
of a picture is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numba import njit

from pzcap.geometry.camera import wrapped
from pzcap.localisation.readout import rate_between
from pzcap.localisation.tuning import REPETITION
from pzcap.types import Array, Image, Localisation, Mask


class Pictures:
    """The picture that came last of a camera, and where the camera writes over its pictures, a date or its name: what
    stays there while it turns is no repetition."""

    def __init__(self) -> None:
        self._last: Image | None = None
        self._turned = 0  # pictures so far in which the camera turned or zoomed,
        self._stayed = np.zeros((1, 1), np.int64)  # and in how many of them each block stayed

    def repeated_share(self, grey: Image, change_px: float) -> float:
        """Share of the picture (H, W) that comes next that is the one before: of its blocks, those whose pixels are the
        same to a grey level, each by how steep it is across, since what is flat tells of no place. ``change_px``: by
        how much it should have moved."""
        before, self._last = self._last, grey
        if before is None:
            return 0.0
        same, weight = _blocks(grey, before)
        if change_px > REPETITION.missed_px:
            self._turned, self._stayed = self._turned + 1, self._stayed + same
            if self._turned < REPETITION.turned:  # who knows what is written there
                return 0.0
        weight = np.where(self._stayed > max(REPETITION.stayed * self._turned, 1), 0.0, weight)
        return float(weight[same].sum() / max(float(weight.sum()), 1e-9))


def _blocks(grey: Image, before: Image) -> tuple[Mask, Array]:
    """Blocks (h, w) that are the same in two pictures, and the weights of all, from 0 where they are flat to 1."""
    shape = (grey.shape[0] // REPETITION.block_px, grey.shape[1] // REPETITION.block_px)
    same, steep = np.empty(shape, np.bool_), np.empty(shape)
    _compare(grey, before, same, steep)
    return same, steep / (steep + REPETITION.steep**2)


@njit(cache=True, nogil=True)
def _compare(grey: Image, before: Image, same: Mask, steep: Array) -> None:
    """Fill in which blocks (h, w) are the ``same`` to a grey level or so, and their mean square slope across."""
    block = REPETITION.block_px
    for n in range(same.shape[0]):
        for m in range(same.shape[1]):
            changed, squares = False, 0.0
            for i in range(n * block, (n + 1) * block):
                for j in range(m * block, (m + 1) * block):
                    here = np.int64(grey[i, j])
                    if abs(here - np.int64(before[i, j])) > REPETITION.levels:  # uint8 would wrap
                        changed = True
                    slope = np.int64(grey[i, min(j + 1, grey.shape[1] - 1)]) - here
                    squares += float(slope * slope)
            same[n, m], steep[n, m] = not changed, squares / block**2


def known_less_surely(found: Localisation, change: Array, share: float, width: int) -> Localisation:
    """A frame that was ``found``, of whose picture a ``share`` is repeated: that is shifted, and its edges are, by a
    part of a pixel that nobody knows. Where pan and log focal were to ``change`` (2,) by more than a codec passes over,
    the picture is the one before, encoded once more, and has `missed` that."""
    shifted = share * np.diag([REPETITION.sigma_px / found.focal_px, REPETITION.sigma_px / (width / 2)]) ** 2
    is_old = share > REPETITION.most and moved_px(change, found.focal_px, width) > REPETITION.missed_px
    return replace(found, covariance=found.covariance + shifted, missed=change if is_old else np.zeros(2))


def moved_px(change: Array, focal_px: float, width: int) -> float:
    """Pixels by which a ``change`` (2,) of pan and log focal moves a picture, and its edges."""
    return float(np.hypot(change[0] * focal_px, change[1] * width / 2))


def extrapolated(found: Localisation) -> Localisation:
    """Place of a frame at its own instant, where its picture `missed` a change: as expected from the frames before."""
    pan_rad, focal_px = found.pan_rad + found.missed[0], found.focal_px * np.exp(found.missed[1])
    covariance = found.covariance + covariance_of(found.missed)
    return replace(found, pan_rad=float(wrapped(pan_rad)), focal_px=float(focal_px), covariance=covariance)


def without_extrapolation(carried: Localisation) -> Localisation:
    """A frame that was `extrapolated`, as its picture shows it."""
    pan_rad, focal_px = carried.pan_rad - carried.missed[0], carried.focal_px * np.exp(-carried.missed[1])
    covariance = carried.covariance - covariance_of(carried.missed)
    return replace(
        carried, pan_rad=float(wrapped(pan_rad)), focal_px=float(focal_px), covariance=covariance, missed=np.zeros(2)
    )


def stood_still(shown: Localisation, missed: Array, after: Localisation) -> bool:
    """True if a camera had stopped in a frame, ``shown`` by its picture, that is said to have ``missed`` (2,) a change:
    the frame ``after`` is there still, and not where two such changes lead."""
    return float(rate_between(shown, after) @ missed) < float(missed @ missed)


def confirmed(frames: Sequence[Localisation | None]) -> list[Localisation | None]:
    """Frames one after the other, without the changes that were `missed` where the camera had stopped."""
    out = list(frames)
    for number, (one, after) in enumerate(pairwise(frames)):
        if one is None or after is None or not after.valid or not one.missed.any():
            continue
        if stood_still(one, one.missed, after):
            out[number] = replace(one, missed=np.zeros(2))
    return out


def covariance_of(missed: Array) -> Array:
    """Covariance (..., 2, 2) of pan and log focal where changes that pictures ``missed`` (..., 2) are made up for: they
    are known to the half of themselves, since a hand may stop within a frame."""
    sigma = 0.5 * missed
    return np.asarray(sigma[..., :, None] * sigma[..., None, :])
