"""The features that stand on the near object: as they move, or as the crew's box says."""

from __future__ import annotations

import numpy as np

from pzcap.extras.slide.adjustment import Fit, State, linearised
from pzcap.extras.slide.tracks import Tracks
from pzcap.geometry import camera as geometry
from pzcap.types import Array, Mask

TOLD_APART = 3.0  # standard deviations within the near and the far features, between their means
CLEARLY = 3.0  # sigmas by which a feature must contradict the crew


def _along(tracks: Tracks, fit: Fit, direction: Array) -> tuple[Array, Array]:
    """Distance (T,) that each feature's observations want to go along ``direction`` (N, 2), its azimuth and slope being
    free, and the standard deviations."""
    residual, _, _, by_point = linearised(tracks, fit.state)
    basis = np.concatenate([by_point[:, :, :2], direction[:, :, None]], axis=2)
    blocks, slopes = np.zeros((len(fit.state.points), 3, 3)), np.zeros((len(fit.state.points), 3))
    np.add.at(blocks, tracks.track, basis.transpose(0, 2, 1) @ basis)
    np.add.at(slopes, tracks.track, (basis.transpose(0, 2, 1) @ residual[:, :, None])[:, :, 0])
    inverse = np.linalg.inv(blocks + np.eye(3) * 1e-9)
    return -(inverse @ slopes[:, :, None])[:, 2, 0], fit.spread_px * np.sqrt(inverse[:, 2, 2])


def moving(fit: Fit, tracks: Tracks) -> tuple[Mask, Mask] | None:
    """(T,) The features that move against the others as what is in front would, and the others; None if none do.

    Which of two groups moves against which nobody can tell: it is the one that takes up less of the width.
    """
    _, _, by_shared, _ = linearised(tracks, fit.state)
    nearness = fit.state.points[tracks.track, 2]
    way, sigma = _along(tracks, fit, by_shared[:, :, 6] / nearness[:, None])
    # the split of the ways into two groups that leaves the least variance within them (Otsu, 1979)
    order = np.argsort(way)
    weight = 1.0 / (sigma[order] ** 2 + np.median(sigma) ** 2)
    total, first, second = (np.cumsum(weight * way[order] ** power) for power in range(3))
    below, above = total[:-1], total[-1] - total[:-1]
    within = second[-1] - first[:-1] ** 2 / below - (first[-1] - first[:-1]) ** 2 / above
    at = int(np.argmin(within))
    apart = (first[-1] - first[at]) / above[at] - first[at] / below[at]
    if apart < TOLD_APART * np.sqrt(within[at] / total[-1]):
        return None
    upper = np.asarray(way > way[order[at]], np.bool_)
    lower, azimuth = np.logical_not(upper), fit.state.points[:, 0]
    return (upper, lower) if np.std(azimuth[upper]) < np.std(azimuth[lower]) else (lower, upper)


def nearer(tracks: Tracks, fit: Fit, between: float, said: tuple[Mask, Mask] | None) -> tuple[Mask, Mask]:
    """(T,) The features whose own inverse distance, as they show it, exceeds ``between``, and those below it.

    What the crew ``said`` holds until a feature clearly shows the contrary; then it counts as neither.
    """
    _, _, _, by_point = linearised(tracks, fit.state)
    change, sigma = _along(tracks, fit, by_point[:, :, 2])
    shown = fit.state.points[:, 2] + change - between
    if said is None:
        return (shown > 0) & (sigma < between), (shown <= 0) & (sigma < between)
    return said[0] & (shown > -CLEARLY * sigma), said[1] & (shown < CLEARLY * sigma)


def boxed(state: State, frame: int, box_px: tuple[float, float, float, float], edge_px: float) -> tuple[Mask, Mask]:
    """(T,) The features that ``frame`` sees, or would see, within the box, and those outside, but for its border."""
    seen, front = geometry.direction_to_pixel(state.view, state.points[:, 0] - state.pan_rad[frame], state.points[:, 1])
    left, top, right, bottom = box_px
    within = np.min(np.column_stack([seen - (left, top), (right, bottom) - seen]), axis=1)
    return front & (within > edge_px), np.logical_not(front) | (within < -edge_px)
