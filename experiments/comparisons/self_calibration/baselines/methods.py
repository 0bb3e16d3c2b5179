"""The three self-calibrations: Shum and Szeliski (2000), Sinha and Pollefeys (2006), Wu and Radke (2013)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.comparisons.self_calibration.baselines.adjustment import LensModel, adjust
from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair, turn_of
from experiments.comparisons.self_calibration.baselines.shots import Shots, first_values, one_zoom
from pzcap.types import Array


def shum_szeliski(shots: Shots, pairs: Sequence[Pair]) -> Frames:
    """A mosaic: focal lengths and rotations of all frames, no distortion, principal point in the middle.

    Focal lengths in closed form from the homographies; rotations chained; in a full turn the gap at the end gives the
    focal length and is spread over the turn; then all frames are aligned globally over all overlapping
    pairs, each with a rotation and a focal length. Simplified: homographies from features instead of
    registered patches, and residuals in pixels instead of between rays; no deghosting, which moves pixels, not cameras.
    """
    start = first_values(shots, pairs)
    count = len(shots.found)
    design = np.zeros((count, 4, count))
    design[np.arange(count), 0, np.arange(count)] = 1.0
    constant = np.array([0.0, *shots.centre_px, 0.0])
    # nothing is believed of the focal lengths, but that of a frame without matches must not be anything at all
    model = LensModel(design, np.eye(count), start.lens[:, 0].copy(), np.full(count, 2.0), constant)
    return adjust(start, start.lens[:, 0].copy(), model, pairs)[0]


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
    mosaic, intrinsics = adjust(replace(start, valid=start.valid & base), believed, model, pairs)
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
        frames, _ = adjust(Frames(rotation, lens, valid), lens[k], model, linked, moving=moving, scale_px=15.0)
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


@dataclass(frozen=True, slots=True, eq=False)
class ZoomModel:
    """The camera as Wu and Radke model it: distortion a smooth function of zoom, principal point where zooming aims."""

    reference_log_focal: float
    principal_px: Array  # (2,)
    k1: Array  # (3,) polynomial in log focal over the reference

    def lens(self, log_focal: float) -> Array:
        """(4,) as in `rotations.Frames`."""
        x = log_focal - self.reference_log_focal
        return np.array([log_focal, *self.principal_px, self.k1 @ x ** np.arange(len(self.k1))])


def wu_radke(shots: Shots, pairs: Sequence[Pair]) -> tuple[Frames, ZoomModel]:
    """The complete model from panned and zoomed frames: simple first values, then one nonlinear fit.

    The principal point is first where the zoom run's pictures expand from. Simplified: our cameras have no encoder, so
    that every zoom step's focal length is free, and distortion a quadratic in its logarithm rather than in a reading;
    rotations are free, for want of readings of pan and tilt.
    """
    start = first_values(shots, pairs)
    count = len(shots.found)
    centre = centre_of_zoom(shots, pairs)
    base = one_zoom(shots, start)
    reference = float(np.median(start.lens[base, 0]))
    own = [int(k) for k in np.flatnonzero(~base)]
    size = 1 + len(own) + 5  # log focals, principal point, k1's polynomial
    design = np.zeros((count, 4, size))
    design[base, 0, 0] = 1.0
    for n, k in enumerate(own):
        design[k, 0, 1 + n] = 1.0
    design[:, 1, -5] = design[:, 2, -4] = 1.0
    x = np.where(base, 0.0, start.lens[:, 0] - reference)
    design[:, 3, -3:] = x[:, None] ** np.arange(3)
    guess = np.concatenate([[reference], start.lens[own, 0], centre, np.zeros(3)])
    sigmas = np.concatenate([np.full(1 + len(own), 2.0), np.full(2, 0.02 * shots.width), [0.2, 0.2, 0.1]])
    frames, unknowns = start, guess
    for _ in range(3):  # the polynomial's argument is the zoom, which is found at the same time
        model = LensModel(design, np.eye(size), guess, sigmas)
        frames, unknowns = adjust(frames, unknowns, model, pairs)
        x = np.where(base, 0.0, frames.lens[:, 0] - unknowns[0])
        design[:, 3, -3:] = x[:, None] ** np.arange(3)
    return frames, ZoomModel(float(unknowns[0]), unknowns[-5:-3].copy(), unknowns[-3:].copy())


def centre_of_zoom(shots: Shots, pairs: Sequence[Pair]) -> Array:
    """(2,) Where the pictures of the zoom run expand from; the middle of the picture where there is no run."""
    members = set(shots.zoom)
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for pair in pairs:
        if pair.first in members and pair.second in members:
            # p' = c + s (p - c): a similarity without turn
            a, b = pair.first_px.mean(axis=0), pair.second_px.mean(axis=0)
            p, q = pair.first_px - a, pair.second_px - b
            scale = float(np.sum(p * q) / np.sum(p * p))
            share = 1.0 - scale
            normal += len(p) * share**2 * np.eye(2)
            right += len(p) * share * (b - scale * a)
    if normal[0, 0] < 1.0:
        return shots.centre_px
    centre = np.linalg.solve(normal, right)
    return np.asarray(np.clip(centre, shots.centre_px - 0.03 * shots.width, shots.centre_px + 0.03 * shots.width))
