"""Frames of a camera that turns about its projection centre, adjusted with free rotations and a lens for each frame.

How frames share focal length, principal point and distortion, and what is believed of them beforehand, is what the
methods differ in. A match's residual is where the first frame's point would be seen in the second, minus where it was
seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair
from pzcap.geometry.lens import Distortion, distort, jacobian, undistort
from pzcap.solver.gauss_newton import NormalEquations, Schedule, minimise
from pzcap.solver.robust import geman_mcclure, planar_sigma
from pzcap.types import Array, PzcapError

LENS = 4  # log focal, principal point (x, y), k1
DAMPING = 1e-6  # of the normal matrix' diagonal


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
    result[:, :, :3] = -np.cross(by_ray, rays[:, None])
    straighten = by_ray[:, :, :2] @ np.linalg.inv(jacobian(xy, Distortion(first[3])))
    result[:, :, 3] = -(straighten @ bent[:, :, None])[:, :, 0]
    result[:, :, 4:6] = -straighten / np.exp(first[0])
    squared = np.sum(xy * xy, axis=1, keepdims=True)
    result[:, :, 6] = -(straighten @ (squared * xy)[:, :, None])[:, :, 0]
    result[:, :, 7:10] = np.cross(by_seen, seen[:, None])
    result[:, :, 10] = focal * bent_second
    result[:, :, 11:13] = np.eye(2)
    result[:, :, 13] = focal * np.sum(flat * flat, axis=1, keepdims=True) * flat
    return second[1:3] + focal * bent_second, result


def adjust(
    start: Frames,
    unknowns: Array,
    model: LensModel,
    pairs: Sequence[Pair],
    *,
    moving: NDArray[np.bool_] | None = None,
    scale_px: float = 30.0,
) -> tuple[Frames, Array]:
    """Rotations and lenses by Gauss-Newton, a step limited to 0.3 rad: the frames, and the unknowns (U,).

    Frames that are not ``moving`` keep their rotation; the first valid one always does. Weights fall with the residual
    (Geman and McClure, 1987), by a scale that follows the residuals down from ``scale_px``. Raises PzcapError where no
    two of the valid frames are linked by a pair.
    """
    count, size = len(start.valid), len(unknowns)
    turns = 3 * count
    used = [pair for pair in pairs if start.valid[pair.first] and start.valid[pair.second]]
    if not used:
        raise PzcapError("self-calibration: no two of these frames show the same")
    turning = start.valid.copy() if moving is None else start.valid & moving
    if moving is None and turning.any():
        turning[int(np.argmax(turning))] = False
    held = np.concatenate([np.repeat(~turning, 3), np.zeros(size, bool)])

    def linearise(state: tuple[Array, Array], scale: float) -> NormalEquations:
        rotation, unknowns = state
        lens = model.constant + model.design @ unknowns
        normal, gradient = np.zeros((turns + size, turns + size)), np.zeros(turns + size)
        lengths, cost = [], 0.0
        for pair in used:
            i, j = pair.first, pair.second
            seen, by = transfer(lens[i], lens[j], rotation[j].T @ rotation[i], pair.first_px)
            residual = seen - pair.second_px
            length = np.hypot(*residual.T)
            weight = geman_mcclure(length, scale)
            by_lens = by[:, :, 3:7] @ model.design[i] + by[:, :, 10:] @ model.design[j]
            flat = np.concatenate([by[:, :, :3], by[:, :, 7:10], by_lens], axis=2).reshape(-1, 6 + size)
            weighted = flat * np.repeat(weight, 2)[:, None]
            columns = np.concatenate([3 * i + np.arange(3), 3 * j + np.arange(3), turns + np.arange(size)])
            normal[np.ix_(columns, columns)] += weighted.T @ flat
            gradient[columns] += weighted.T @ residual.ravel()
            lengths.append(length)
            cost += float(weight @ length**2)
        sigma = max(planar_sigma(np.concatenate(lengths)), 0.01)
        believed = model.rows / model.sigmas[:, None] * sigma
        normal[turns:, turns:] += believed.T @ believed
        gradient[turns:] += believed.T @ ((model.rows @ unknowns - model.values) / model.sigmas * sigma)
        normal[np.diag_indices_from(normal)] *= 1.0 + DAMPING
        normal[held], normal[:, held], gradient[held] = 0.0, 0.0, 0.0
        normal[held, held] = 1.0
        return NormalEquations(normal, gradient, sigma, cost)

    def retract(state: tuple[Array, Array], step: Array) -> tuple[Array, Array]:
        step = step * min(1.0, 0.3 / max(float(np.abs(step[:turns]).max(initial=0.0)), 1e-12))
        rotation = state[0] @ Rotation.from_rotvec(step[:turns].reshape(count, 3)).as_matrix()
        return rotation, state[1] + step[turns:]

    def settled(step: Array) -> bool:
        return bool(np.abs(step[:turns]).max(initial=0.0) < 1e-7)

    schedule = Schedule(30, scale_px, least_scale=0.3, fall=2.0, steady=0.05)
    rotation, unknowns = minimise((start.rotation, unknowns), linearise, retract, settled, schedule).state
    return Frames(rotation, model.constant + model.design @ unknowns, start.valid), unknowns
