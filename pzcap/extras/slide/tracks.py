"""Features followed over the frames of a pan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import features
from pzcap.calibration.features import Features
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.types import Array, PzcapError

MIN_TRACKS = 12  # of what is near, and of what is far; and of what two frames in a row must have in common


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Features followed over a pan: N observations of T features in F frames."""

    track: NDArray[np.int64]  # (N,)
    frame: NDArray[np.int64]  # (N,)
    points_px: Array  # (N, 2)


def follow(found: Sequence[Features], view: View, ratio: float) -> tuple[Tracks, Array]:
    """Features followed over the frames of a pan, and first values of the pans (F,). PzcapError if it has a gap."""
    counts = np.array([len(each) for each in found])
    first_of = np.concatenate([[0], np.cumsum(counts)])
    parent = np.arange(first_of[-1])

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = int(parent[node])
        return node

    def join(first: int, second: int, pairs: NDArray[np.int64]) -> None:
        for i, j in pairs:
            parent[root(int(first_of[first] + i))] = root(int(first_of[second] + j))

    pan = np.zeros(len(found))
    for second in range(1, len(found)):
        pairs, turn = _pairs(found[second - 1], found[second], view, ratio)
        if len(pairs) < MIN_TRACKS:
            raise PzcapError(
                f"pan: frames {second - 1} and {second} of the {len(found)} used show nothing in common; "
                "pan more slowly, or over less"
            )
        pan[second] = pan[second - 1] + turn
        join(second - 1, second, pairs)
    for first in range(len(found)):
        for second in range(first + 2, len(found)):
            pairs, turn = _pairs(found[first], found[second], view, ratio)
            chained = pan[second] - pan[first]
            if abs(turn - chained) < 0.02 + 0.1 * abs(chained):
                join(first, second, pairs)
    roots = np.array([root(node) for node in range(len(parent))])
    frame = np.repeat(np.arange(len(found)), counts)
    _, track, size = np.unique(roots, return_inverse=True, return_counts=True)
    # a track that holds two features of one frame is a muddle of several things
    twice = np.zeros(len(size), bool)
    _, where, times = np.unique(np.stack([track, frame]), axis=1, return_index=True, return_counts=True)
    twice[track[where[times > 1]]] = True
    kept = (size >= 3) & ~twice
    keep = kept[track]
    _, numbered = np.unique(track[keep], return_inverse=True)
    points = np.concatenate([each.points_px for each in found])
    return Tracks(numbered, frame[keep], points[keep]), pan


def _pairs(first: Features, second: Features, view: View, ratio: float) -> tuple[NDArray[np.int64], float]:
    """Pairs (N, 2) of features that agree roughly on one pan between the frames, and that pan."""
    pairs = features.match(first, second, ratio)
    if len(pairs) < MIN_TRACKS:
        return pairs[:0], 0.0
    azimuth_a, slope_a = geometry.pixel_to_direction(view, first.points_px[pairs[:, 0]])
    azimuth_b, slope_b = geometry.pixel_to_direction(view, second.points_px[pairs[:, 1]])
    turn = azimuth_a - azimuth_b
    middle = float(np.median(turn[features.densest(turn, 8.0 / view.focal_px)]))
    # what is near moves otherwise than what is far; focal length, tilt and distortion are not known yet
    agree = (np.abs(turn - middle) < 0.05 + 0.1 * abs(middle)) & (np.abs(slope_a - slope_b) < 0.04 + 0.1 * abs(middle))
    return pairs[agree], middle
