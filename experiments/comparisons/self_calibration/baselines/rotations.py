"""Frames of a camera that turns about its projection centre: matched pairs, and first values by their homographies.

What the methods share. They know of no pan axis and no reference pose, so that every frame has a rotation of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import features
from pzcap.calibration.features import Features
from pzcap.types import Array

RATIO = 0.8  # of Lowe's test
LEAST = 20  # matches of a pair


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Matches between two frames that agree on a homography."""

    first: int
    second: int
    first_px: Array  # (N, 2)
    second_px: Array  # (N, 2)
    homography: Array  # (3, 3) first to second, pixels


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Rotations and lenses of F frames."""

    rotation: Array  # (F, 3, 3) camera to mosaic
    lens: Array  # (F, 4) log focal, principal point, k1
    valid: NDArray[np.bool_]  # (F,) linked to the others

    @property
    def focal_px(self) -> Array:
        return np.exp(self.lens[:, 0])


def match_pairs(found: Sequence[Features], candidates: Sequence[tuple[int, int]]) -> list[Pair]:
    """Pairs of frames, of ``candidates``, with ``LEAST`` matches or more that agree on a homography to 3 px."""
    pairs = []
    for first, second in candidates:
        matched = features.match(found[first], found[second], RATIO)
        if len(matched) < LEAST:
            continue
        a, b = found[first].points_px[matched[:, 0]], found[second].points_px[matched[:, 1]]
        model, inlier = cv2.findHomography(a, b, cv2.USAC_MAGSAC, 3.0, maxIters=3000, confidence=0.999)
        if model is None:
            continue
        homography = np.asarray(model, np.float64)
        if not _plausible(homography, a):
            continue
        agree = inlier.ravel() > 0
        if agree.sum() >= max(LEAST, 0.25 * len(matched)):
            pairs.append(Pair(first, second, a[agree], b[agree], homography))
    return pairs


def _plausible(homography: Array, points: Array) -> bool:
    """True if ``homography`` keeps the points in front of the camera and does not mirror."""
    depth = points @ homography[2, :2] + homography[2, 2]
    return bool((depth > 0).all() or (depth < 0).all()) and bool(np.linalg.det(homography / homography[2, 2]) > 1e-3)


def focals_of(homography: Array, centre_px: Array) -> tuple[float | None, float | None]:
    """Focal lengths of the two frames of a homography, in closed form (Shum and Szeliski, 2000).

    None where the motion does not show it: a turn of a few degrees, or zooming alone.
    """
    shift = np.eye(3)
    shift[:2, 2] = centre_px
    h = (np.linalg.inv(shift) @ homography @ shift).ravel()
    h = h / np.cbrt(np.linalg.det(h.reshape(3, 3)))
    second = _root(
        (-(h[0] * h[1] + h[3] * h[4]), h[6] * h[7]),
        (h[0] ** 2 + h[3] ** 2 - h[1] ** 2 - h[4] ** 2, h[7] ** 2 - h[6] ** 2),
    )
    first = _root(
        (-h[2] * h[5], h[0] * h[3] + h[1] * h[4]),
        (h[5] ** 2 - h[2] ** 2, h[0] ** 2 + h[1] ** 2 - h[3] ** 2 - h[4] ** 2),
    )
    return first, second


def _root(*fractions: tuple[float, float]) -> float | None:
    """The square root of the better determined of two fractions, if it is positive."""
    above, below = max(fractions, key=lambda fraction: abs(fraction[1]))
    if abs(below) < 1e-12 or above / below <= 0:
        return None
    return float(np.sqrt(above / below))


def zoom_between(homography: Array, centre_px: Array) -> float:
    """Log of the second focal length over the first, roughly: how much the middle of the picture grows."""
    u, v = centre_px
    depth = homography[2] @ (u, v, 1.0)
    place = homography[:2] @ (u, v, 1.0) / depth
    slope = (homography[:2, :2] - place[:, None] * homography[2, :2]) / depth
    # a turn stretches the picture, too: along its direction by 1 / cos^2, across by 1 / cos
    return float(np.log(np.linalg.svd(slope, compute_uv=False).min()))


def initial(pairs: Sequence[Pair], count: int, centre_px: Array, guess_px: float) -> Frames:
    """Focal lengths and rotations by the homographies along the tree of the best matched pairs.

    ``guess_px`` is the focal length taken where no homography shows one.
    """
    weighted, degree = [], np.zeros(count)
    for pair in pairs:
        weight = len(pair.first_px) / (1.0 + 20.0 * abs(zoom_between(pair.homography, centre_px)))
        weighted.append((weight, pair))
        degree[[pair.first, pair.second]] += weight
    tree = spanning(weighted, {int(np.argmax(degree))})  # from the best linked frame on
    valid = np.zeros(count, bool)
    log_zoom = np.zeros(count)
    for known, new, pair in tree:
        valid[[known, new]] = True
        ratio = zoom_between(pair.homography, centre_px)
        log_zoom[new] = log_zoom[known] + (ratio if pair.first == known else -ratio)
    estimates = []
    for pair in pairs:
        if valid[pair.first]:
            for frame, focal in zip((pair.first, pair.second), focals_of(pair.homography, centre_px), strict=True):
                if focal is not None and 0.2 * guess_px < focal < 10.0 * guess_px:
                    estimates.append(np.log(focal) - log_zoom[frame])
    base = float(np.median(estimates)) if len(estimates) >= 3 else np.log(guess_px)
    lens = np.column_stack([base + log_zoom, np.tile(centre_px, (count, 1)), np.zeros(count)])
    return rechained(Frames(np.tile(np.eye(3), (count, 1, 1)), lens, valid), tree)


def rechained(frames: Frames, tree: Sequence[tuple[int, int, Pair]]) -> Frames:
    """The rotations along ``tree`` with the focal lengths of ``frames``."""
    rotation = frames.rotation.copy()
    for known, new, pair in tree:
        turn = turn_of(pair, frames)  # second from first
        rotation[new] = rotation[known] @ (turn.T if pair.first == known else turn)
    return replace(frames, rotation=rotation)


def turn_of(pair: Pair, frames: Frames) -> Array:
    """(3, 3) The rotation from the first camera to the second that is nearest to the pair's homography."""
    first, second = _matrix(frames.lens[pair.first]), _matrix(frames.lens[pair.second])
    u, _, vt = np.linalg.svd(np.linalg.inv(second) @ pair.homography @ first)
    sign = np.sign(np.linalg.det(u @ vt))
    return np.asarray(sign * u @ vt, np.float64)


def _matrix(lens: Array) -> Array:
    focal = np.exp(lens[0])
    return np.array([[focal, 0.0, lens[1]], [0.0, focal, lens[2]], [0.0, 0.0, 1.0]])


def spanning(weighted: Sequence[tuple[float, Pair]], reached: set[int]) -> list[tuple[int, int, Pair]]:
    """The best tree of pairs from the frames that are ``reached`` (Prim, 1957): frame reached, new frame, pair.

    The new frames are added to ``reached``.
    """
    tree: list[tuple[int, int, Pair]] = []
    while edges := [(w, p) for w, p in weighted if (p.first in reached) != (p.second in reached)]:
        _, pair = max(edges, key=lambda edge: edge[0])
        known, new = (pair.first, pair.second) if pair.first in reached else (pair.second, pair.first)
        reached.add(new)
        tree.append((known, new, pair))
    return tree
