"""Frames of a camera that turns about its projection centre, adjusted with free rotations and a lens for each frame.

How frames share focal length, principal point and distortion, and what is believed of them beforehand, is what the
methods differ in. A match's residual is where the first frame's point would be seen in the second, minus where it was
seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair
from pzcap.geometry.lens import Distortion, distort, jacobian, undistort
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array

LENS: int = 4  # log focal, principal point (x, y), k1


@dataclass(frozen=True, slots=True, eq=False)
class LensModel:
    """Lenses (F, 4) of the frames by unknowns (U,), and prior of these.

    ``lens = constant + design @ unknowns``, where ``rows @ unknowns`` should be ``values``, to within ``sigmas``.
    """

    design: Array  # (F, 4, U)
    rows: Array  # (B, U)
    values: Array  # (B,)
    sigmas: Array  # (B,)
    constant: Array = field(default_factory=lambda: np.zeros(LENS))  # (4,) or (F, 4)


def transfer(first: Array, second: Array, turn: Array, points_px: Array) -> tuple[Array, Array]:
    """Pixels (N, 2) in another frame of points (N, 2) of a frame, and the derivatives (N, 2, 14).

    ``first`` and ``second`` (4,) are the lenses, ``turn`` (3, 3) goes from the first camera to the second. The
    derivatives are with respect to the first frame's rotation (3, about its own axes) and lens (4), then the second's.
    """
    bent = (points_px - first[1:3]) / np.exp(first[0])
    xy = undistort(bent, Distortion(first[3]))
    rays = np.column_stack([xy, np.ones(len(xy))])
    seen = rays @ turn.T
    flat = seen[:, :2] / seen[:, 2:]
    focal = np.exp(second[0])
    bent_second = distort(flat, Distortion(second[3]))
    result = np.empty((len(xy), 2, 14))
    project = np.zeros((len(xy), 2, 3))
    project[:, 0, 0] = project[:, 1, 1] = 1.0
    project[:, :, 2] = -flat
    by_seen = focal * jacobian(flat, Distortion(second[3])) @ project / seen[:, 2, None, None]
    by_ray = by_seen @ turn
    result[:, :, :3] = -by_ray @ _cross(rays)
    straighten = by_ray[:, :, :2] @ np.linalg.inv(jacobian(xy, Distortion(first[3])))
    result[:, :, 3] = -(straighten @ bent[:, :, None])[:, :, 0]
    result[:, :, 4:6] = -straighten / np.exp(first[0])
    squared = np.sum(xy * xy, axis=1, keepdims=True)
    result[:, :, 6] = -(straighten @ (squared * xy)[:, :, None])[:, :, 0]
    result[:, :, 7:10] = by_seen @ _cross(seen)
    result[:, :, 10] = focal * bent_second
    result[:, :, 11:13] = np.eye(2)
    result[:, :, 13] = focal * np.sum(flat * flat, axis=1, keepdims=True) * flat
    return second[1:3] + focal * bent_second, result


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
            weight = geman_mcclure(length, scale)
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
