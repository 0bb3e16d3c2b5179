"""Agreement of a sweep's matches with what was adjusted to them, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration.bundle_adjustment import Adjusted, Link
from pzcap.calibration.tuning import FEATURES
from pzcap.types import PzcapError


def require_whole(adjusted: Adjusted, links: Sequence[Link], kept: NDArray[np.int64]) -> None:
    """Raise PzcapError where of the matches of a sweep's frames ``kept`` (M,) with those beyond hardly any agree: there
    the sweep is torn, and the circle does not fix the focal length. ``links`` come first in what was adjusted."""
    matches, agreed = _across(adjusted, links, len(kept))
    for first in torn(adjusted, links, len(kept)):
        raise PzcapError(
            f"sweep: of {matches[first]} matches across frames {kept[first]} and {kept[first + 1]} {agreed[first]} "
            "agree with the rest: it does not hold together there; pan evenly and slowly, with nothing nearer "
            "than a metre, and shoot the sweep again"
        )


def torn(adjusted: Adjusted, links: Sequence[Link], count: int) -> list[int]:
    """Frames of a sweep of ``count``, between which and the next hardly any match agrees with all others."""
    matches, agreed = _across(adjusted, links, count)
    return np.flatnonzero(agreed < FEATURES.least_agreed * matches).tolist()


def _across(adjusted: Adjusted, links: Sequence[Link], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(count - 1,) matches across each frame and the next, of all ``links``, and how many of these agree."""
    matches, agreed = np.zeros(count - 1, np.int64), np.zeros(count - 1, np.int64)
    for link, inliers in zip(links, adjusted.inliers, strict=False):
        if link.second - link.first < count // 2:  # the others are across the seam
            matches[link.first : link.second] += len(link.first_px)
            agreed[link.first : link.second] += inliers
    return matches, agreed


def sweep_inliers(adjusted: Adjusted, links: Sequence[Link], count: int) -> NDArray[np.int64]:
    """(M,) inlier matches of each frame with the next (of the last, with the one before)."""
    inliers = np.zeros(count, np.int64)
    for link, agreed in zip(links, adjusted.inliers, strict=True):
        if link.second == link.first + 1 < count:
            inliers[link.first] = agreed
    inliers[-1] = inliers[-2]
    return inliers
