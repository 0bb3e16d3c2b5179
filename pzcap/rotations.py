"""Frames of a camera that turns about its projection centre, adjusted with free rotations and a lens for each frame.

What the self-calibration methods of `pzcap.selfcalibration` share. They know of no pan axis and no reference pose, so
that every frame has a rotation of its own; how frames share focal length, principal point and distortion, and what is
believed of them beforehand, is what the methods differ in. A match's residual is where the first frame's point would be
seen in the second, minus where it was seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pzcap import features
from pzcap.camera import distort, undistort
from pzcap.features import Features
from pzcap.types import Array

LENS: int = 4  # log focal, principal point (x, y), k1


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
    """How F frames were taken."""

    rotation: Array  # (F, 3, 3) camera to mosaic
    lens: Array  # (F, 4) log focal, principal point, k1
    valid: NDArray[np.bool_]  # (F,) linked to the others

    @property
    def focal_px(self) -> Array:
        return np.exp(self.lens[:, 0])


@dataclass(frozen=True, slots=True, eq=False)
class LensModel:
    """How the frames' lenses (F, 4) depend on unknowns (U,), and what is believed of these.

    ``lens = constant + design @ unknowns``, where ``rows @ unknowns`` should be ``values``, to within ``sigmas``.
    """

    design: Array  # (F, 4, U)
    rows: Array  # (B, U)
    values: Array  # (B,)
    sigmas: Array  # (B,)
    constant: Array = field(default_factory=lambda: np.zeros(LENS))  # (4,) or (F, 4)


def match_pairs(
    found: Sequence[Features], candidates: Sequence[tuple[int, int]], ratio: float = 0.8, least: int = 20
) -> list[Pair]:
    """Pairs of frames, of ``candidates``, with ``least`` matches or more that agree on a homography to 3 px."""
    pairs = []
    for first, second in candidates:
        matched = features.match(found[first], found[second], ratio)
        if len(matched) < least:
            continue
        a, b = found[first].points_px[matched[:, 0]], found[second].points_px[matched[:, 1]]
        model, inlier = cv2.findHomography(a, b, cv2.USAC_MAGSAC, 3.0, maxIters=3000, confidence=0.999)
        if model is None:
            continue
        homography = np.asarray(model, np.float64)
        if not _plausible(homography, a):
            continue
        agree = inlier.ravel() > 0
        if agree.sum() >= max(least, 0.25 * len(matched)):
            pairs.append(Pair(first, second, a[agree], b[agree], homography))
    return pairs


def _plausible(homography: Array, points: Array) -> bool:
    """Whether ``homography`` keeps the points in front of the camera and does not mirror."""
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
    near = [(_change(pair, centre_px), pair) for pair in pairs]
    tree = _tree([(len(pair.first_px) / (1.0 + 20.0 * change), pair) for change, pair in near], count)
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


def _change(pair: Pair, centre_px: Array) -> float:
    return abs(zoom_between(pair.homography, centre_px))


def _tree(weighted: Sequence[tuple[float, Pair]], count: int) -> list[tuple[int, int, Pair]]:
    """The best tree of pairs from the best linked frame on (Prim, 1957): frame reached, new frame, pair."""
    degree = np.zeros(count)
    for weight, pair in weighted:
        degree[[pair.first, pair.second]] += weight
    reached = {int(np.argmax(degree))}
    tree: list[tuple[int, int, Pair]] = []
    while True:
        edges = [(w, p) for w, p in weighted if (p.first in reached) != (p.second in reached)]
        if not edges:
            return tree
        _, pair = max(edges, key=lambda edge: edge[0])
        known, new = (pair.first, pair.second) if pair.first in reached else (pair.second, pair.first)
        reached.add(new)
        tree.append((known, new, pair))


# --------------------------------------------------------------------------------------------------------------
# Adjustment


def transfer(first: Array, second: Array, turn: Array, points_px: Array) -> tuple[Array, Array]:
    """Where points (N, 2) of a frame are seen in another, (N, 2), and the derivatives (N, 2, 14).

    ``first`` and ``second`` (4,) are the lenses, ``turn`` (3, 3) goes from the first camera to the second. The
    derivatives are with respect to the first frame's rotation (3, about its own axes) and lens (4), then the second's.
    """
    bent = (points_px - first[1:3]) / np.exp(first[0])
    xy = undistort(bent, first[3])
    rays = np.column_stack([xy, np.ones(len(xy))])
    seen = rays @ turn.T
    flat = seen[:, :2] / seen[:, 2:]
    focal = np.exp(second[0])
    bent_second = distort(flat, second[3])
    result = np.empty((len(xy), 2, 14))
    project = np.zeros((len(xy), 2, 3))
    project[:, 0, 0] = project[:, 1, 1] = 1.0
    project[:, :, 2] = -flat
    by_seen = focal * _bending(flat, second[3]) @ project / seen[:, 2, None, None]
    by_ray = by_seen @ turn
    result[:, :, :3] = -by_ray @ _cross(rays)
    straighten = by_ray[:, :, :2] @ np.linalg.inv(_bending(xy, first[3]))
    result[:, :, 3] = -(straighten @ bent[:, :, None])[:, :, 0]
    result[:, :, 4:6] = -straighten / np.exp(first[0])
    squared = np.sum(xy * xy, axis=1, keepdims=True)
    result[:, :, 6] = -(straighten @ (squared * xy)[:, :, None])[:, :, 0]
    result[:, :, 7:10] = by_seen @ _cross(seen)
    result[:, :, 10] = focal * bent_second
    result[:, :, 11:13] = np.eye(2)
    result[:, :, 13] = focal * np.sum(flat * flat, axis=1, keepdims=True) * flat
    return second[1:3] + focal * bent_second, result


def _bending(xy: Array, k1: float) -> Array:
    """(N, 2, 2) derivative of the distortion."""
    squared = np.sum(xy * xy, axis=1)
    return (1.0 + k1 * squared)[:, None, None] * np.eye(2) + 2.0 * k1 * xy[:, :, None] * xy[:, None, :]


def _cross(vectors: Array) -> Array:
    """(N, 3, 3) matrices that take the cross product of ``vectors`` with what follows."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def adjust(
    start: Frames,
    unknowns: Array,
    model: LensModel,
    pairs: Sequence[Pair],
    *,
    moving: NDArray[np.bool_] | None = None,
    scale_px: float = 30.0,
    iterations: int = 30,
) -> tuple[Frames, Array, float]:
    """Rotations and lenses by Levenberg and Marquardt; the frames, the unknowns (U,) and the spread of the residuals.

    Frames that are not ``moving`` keep their rotation; the first valid one always does. Weights fall with the residual
    (Geman and McClure, 1987), by a scale that follows the residuals down from ``scale_px``.
    """
    count, size = len(start.valid), len(unknowns)
    used = [pair for pair in pairs if start.valid[pair.first] and start.valid[pair.second]]
    turning = start.valid.copy() if moving is None else start.valid & moving
    if moving is None and turning.any():
        turning[int(np.argmax(turning))] = False
    free = np.concatenate([np.repeat(turning, 3), np.ones(size, bool)])
    frames, scale, spread, damping = start, scale_px, scale_px, 1e-6
    frames = replace(frames, lens=model.constant + model.design @ unknowns)
    for _ in range(iterations):
        normal, gradient = np.zeros((3 * count + size, 3 * count + size)), np.zeros(3 * count + size)
        lengths = []
        for pair in used:
            i, j = pair.first, pair.second
            turn = frames.rotation[j].T @ frames.rotation[i]
            seen, by = transfer(frames.lens[i], frames.lens[j], turn, pair.first_px)
            residual = seen - pair.second_px
            length = np.hypot(*residual.T)
            lengths.append(length)
            weight = (scale**2 / (scale**2 + length**2)) ** 2
            jacobian = np.zeros((len(length), 2, 6 + size))
            jacobian[:, :, :3], jacobian[:, :, 3:6] = by[:, :, :3], by[:, :, 7:10]
            jacobian[:, :, 6:] = by[:, :, 3:7] @ model.design[i] + by[:, :, 10:] @ model.design[j]
            flat = jacobian.reshape(-1, 6 + size)
            weighted = flat * np.repeat(weight, 2)[:, None]
            columns = np.concatenate([3 * i + np.arange(3), 3 * j + np.arange(3), 3 * count + np.arange(size)])
            normal[np.ix_(columns, columns)] += weighted.T @ flat
            gradient[columns] += weighted.T @ residual.ravel()
        spread = max(float(np.median(np.concatenate(lengths))) / 1.1774, 0.01)
        believed = model.rows / model.sigmas[:, None] * spread
        normal[3 * count :, 3 * count :] += believed.T @ believed
        gradient[3 * count :] += believed.T @ ((model.rows @ unknowns - model.values) / model.sigmas * spread)
        normal, gradient = normal[np.ix_(free, free)], gradient[free]
        normal[np.diag_indices_from(normal)] *= 1.0 + damping
        step = np.zeros(len(free))
        step[free] = -np.linalg.lstsq(normal, gradient, rcond=1e-14)[0]
        step = step * min(1.0, 0.3 / max(float(np.abs(step[: 3 * count]).max(initial=0.0)), 1e-12))
        unknowns = unknowns + step[3 * count :]
        rotation = frames.rotation @ Rotation.from_rotvec(step[: 3 * count].reshape(count, 3)).as_matrix()
        frames = Frames(rotation, model.constant + model.design @ unknowns, frames.valid)
        if np.abs(step[: 3 * count]).max(initial=0.0) < 1e-7 and scale < 1.05 * max(3.0 * spread, 0.3):
            break
        scale = max(3.0 * spread, scale / 2.0, 0.3)
    return frames, unknowns, spread
