"""Wu and Radke (2013): the complete model of a pan-tilt-zoom camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.comparisons.self_calibration.baselines.adjustment import LensModel, adjust
from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair
from experiments.comparisons.self_calibration.baselines.shots import Shots, first_values, one_zoom
from pzcap.types import Array


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
        frames, unknowns, _ = adjust(frames, unknowns, model, pairs)
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
