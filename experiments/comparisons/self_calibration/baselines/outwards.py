"""Sinha and Pollefeys (2006)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from experiments.comparisons.self_calibration.baselines.adjustment import LensModel, adjust
from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair, turn_of
from experiments.comparisons.self_calibration.baselines.shots import Shots, first_values, one_zoom
from pzcap.types import Array


def sinha_pollefeys(shots: Shots, pairs: Sequence[Pair]) -> Frames:
    """Intrinsics at one zoom by adjusting a mosaic, then outwards through the zoom, one step after the other.

    The mosaic's frames share focal length, principal point and distortion; then every zoom step has its own, adjusted
    with those before it, and at last all at once. Where a step does not show distortion or principal point they stay
    near the step before. Simplified: one coefficient of distortion; first values from closed-form focal lengths instead
    of the linear self-calibration; where there is no panorama at the widest zoom, the largest group of frames of one
    zoom is the mosaic, and the zoom goes outwards from it both ways; where there is no zoom run, frames that pan and
    zoom at once are its steps, each with a rotation of its own.
    """
    start = first_values(shots, pairs)
    base = one_zoom(shots, start)
    believed = np.array([np.median(start.lens[base, 0]), *shots.centre_px, 0.0])
    shared = np.tile(np.eye(4), (len(shots.found), 1, 1))
    model = LensModel(shared, np.eye(4), believed, np.array([2.0, 0.02 * shots.width, 0.02 * shots.width, 0.2]))
    mosaic, intrinsics, _ = adjust(replace(start, valid=start.valid & base), believed, model, pairs)
    near = np.array([0.3, 0.005 * shots.width, 0.005 * shots.width, 0.05])  # of a step's lens about that before it
    frames, before = _outwards(start, mosaic, float(believed[0]), near, pairs)
    return _together(frames, before, model, intrinsics, near, pairs)


def _outwards(
    start: Frames, mosaic: Frames, log_focal: float, near: Array, pairs: Sequence[Pair]
) -> tuple[Frames, dict[int, int]]:
    """The mosaic (taken at ``log_focal``) with the other frames of ``start`` added by one, the nearest in zoom first;
    and from which frame each of these was reached."""
    steps = [int(k) for k in np.flatnonzero(start.valid & ~mosaic.valid)]
    frames, before = mosaic, dict[int, int]()
    for k in sorted(steps, key=lambda k: abs(start.lens[k, 0] - log_focal)):
        linked = [pair for pair in pairs if k in (pair.first, pair.second) and frames.valid[_other(pair, k)]]
        if not linked:
            continue
        best = max(linked, key=lambda pair: len(pair.first_px))
        nearest = before[k] = _other(best, k)
        rotation, lens, valid = frames.rotation.copy(), frames.lens.copy(), frames.valid.copy()
        lens[k] = lens[nearest]
        lens[k, 0] += start.lens[k, 0] - start.lens[nearest, 0]
        turn = turn_of(best, Frames(rotation, lens, valid))
        rotation[k] = rotation[nearest] @ (turn.T if best.first == nearest else turn)
        valid[k] = True
        moving = np.arange(len(valid)) == k
        held = np.where(moving[:, None], 0.0, lens)
        model = LensModel(np.eye(4) * moving[:, None, None], np.eye(4), lens[k], near, held)
        frames, _, _ = adjust(Frames(rotation, lens, valid), lens[k], model, linked, moving=moving, scale_px=15.0)
    return frames, before


def _together(
    frames: Frames, before: Mapping[int, int], mosaic: LensModel, intrinsics: Array, near: Array, pairs: Sequence[Pair]
) -> Frames:
    """All at once: the mosaic's intrinsics, and those of each step near those of the frame it was reached from."""
    size = 4 * (1 + len(before))
    where = {k: 4 * (1 + n) for n, k in enumerate(before)}
    design = np.pad(mosaic.design, ((0, 0), (0, 0), (0, size - 4)))
    rows, values, sigmas = [np.eye(4, size)], [mosaic.values], [mosaic.sigmas]
    for k, at in where.items():
        design[k] = np.eye(4, size, at)
        row = np.eye(4, size, at) - np.eye(4, size, where.get(before[k], 0))
        rows.append(row[1:])  # nothing is believed of the focal length
        values.append(np.zeros(3))
        sigmas.append(near[1:])
    unknowns = np.concatenate([intrinsics, *(frames.lens[k] for k in before)])
    model = LensModel(design, np.concatenate(rows), np.concatenate(values), np.concatenate(sigmas))
    return adjust(frames, unknowns, model, pairs, scale_px=6.0)[0]


def _other(pair: Pair, frame: int) -> int:
    return pair.second if pair.first == frame else pair.first
