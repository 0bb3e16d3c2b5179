"""Bundle adjustment of a pan: pans, lens, offset and the place of every feature, by robust least squares.

From the projection centre, ``offset`` (forward, left) beside the axis of a head panned by ``pan``, a feature in the
direction (azimuth ``a``, slope ``h``) from the axis and of inverse distance ``q`` stands in the direction of

    (cos(a - pan) - q forward,  sin(a - pan) - q left,  h)

which to first order is `pzcap.geometry.parallax.parallax`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap.extras.slide.tracks import Tracks
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.solver.gauss_newton import NormalEquations, Schedule, minimise
from pzcap.solver.robust import geman_mcclure, planar_sigma
from pzcap.types import Array, Mask

START_SCALE_PX = 8.0  # of the robust weights
ITERATIONS = 20
SHARED = 8  # log focal, tilt, roll, principal point, k1, offset


@dataclass(frozen=True, slots=True, eq=False)
class State:
    pan_rad: Array  # (F,)
    view: View  # at pan 0
    offset_m: Array  # (2,)
    points: Array  # (T, 3) azimuth, slope, inverse distance

    def shared(self) -> Array:
        """(8,) log focal, tilt, roll, principal point, k1, offset."""
        view = self.view
        return np.array([
            np.log(view.focal_px), view.tilt_rad, view.roll_rad, *view.principal_px, view.distortion.k1, *self.offset_m
        ])  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Priors:
    shared: Array  # (8,)
    sigmas: Array  # (8,)
    nearness: Array  # (T,) inverse distance of each feature
    nearness_sigma: Array  # (T,)
    known: Mask  # (T,) near or far; what may be either would fit noise the better the larger the offset


def started(tracks: Tracks, pan_rad: Array, view: View, nearness: Array) -> State:
    """Each feature where its observations, on average, see it."""
    azimuth, slope = geometry.pixel_to_direction(view, tracks.points_px)
    seen = np.bincount(tracks.track, minlength=len(nearness))
    azimuth = np.bincount(tracks.track, azimuth + pan_rad[tracks.frame]) / seen
    return State(pan_rad, view, np.zeros(2), np.column_stack([
        azimuth, np.bincount(tracks.track, slope) / seen, nearness
    ]))  # fmt: skip


def placed(state: State, priors: Priors) -> State:
    """The state with every feature as far away as its kind is."""
    return replace(state, points=np.column_stack([state.points[:, :2], priors.nearness]))


# --------------------------------------------------------------------------------------------------------------
# Where a feature is seen


def from_centre(
    azimuth_rad: Array, slope: Array, nearness: Array, pan_rad: Array, offset_m: Array
) -> tuple[Array, Array, Array]:
    """Directions (N,) from the pan axis, and inverse distances, as seen from the projection centre.

    Returns azimuth and slope (N, 2), their derivatives with respect to (azimuth, slope, inverse distance) (N, 2, 3)
    and to (pan, forward, left) (N, 2, 3).
    """
    alpha = azimuth_rad - pan_rad
    x, y = np.cos(alpha) - nearness * offset_m[0], np.sin(alpha) - nearness * offset_m[1]
    squared = x * x + y * y
    distance = np.sqrt(squared)
    seen = np.column_stack([pan_rad + np.arctan2(y, x), slope / distance])
    zero = np.zeros_like(alpha)
    # columns: azimuth, slope, inverse distance, forward, left
    d_x = np.column_stack([-np.sin(alpha), zero, np.full_like(alpha, -offset_m[0]), -nearness, zero])
    d_y = np.column_stack([np.cos(alpha), zero, np.full_like(alpha, -offset_m[1]), zero, -nearness])
    by = np.empty((len(alpha), 2, 5))
    by[:, 0] = (x[:, None] * d_y - y[:, None] * d_x) / squared[:, None]
    by[:, 1] = -(slope / distance**3)[:, None] * (x[:, None] * d_x + y[:, None] * d_y)
    by[:, 1, 1] += 1.0 / distance
    by_pan = -by[:, :, :1] + np.array([[1.0], [0.0]])
    return seen, by[:, :, :3], np.concatenate([by_pan, by[:, :, 3:]], axis=2)


def linearised(tracks: Tracks, state: State) -> tuple[Array, Array, Array, Array]:
    """Residuals (N, 2), and derivatives with respect to the pan (N, 2), to what is shared (N, 2, 8), to the point."""
    points, pan = state.points[tracks.track], state.pan_rad[tracks.frame]
    seen, by_point, by_motion = from_centre(points[:, 0], points[:, 1], points[:, 2], pan, state.offset_m)
    relative = seen[:, 0] - pan
    pixels, _ = geometry.direction_to_pixel(state.view, relative, seen[:, 1])
    by_view, by_direction = geometry.derivatives(state.view, relative, seen[:, 1])
    to_pan = by_direction @ by_motion[:, :, :1]
    shared = np.concatenate([by_view[:, :, [2, 1, 3, 4, 5, 6]], by_direction @ by_motion[:, :, 1:]], axis=2)
    return pixels - tracks.points_px, by_view[:, :, 0] + to_pan[:, :, 0], shared, by_direction @ by_point


# --------------------------------------------------------------------------------------------------------------
# Least squares


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    state: State
    spread_px: float  # of one coordinate
    covariance: Array  # (2, 2) of the offset


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """Normal equations about a state, U = F + SHARED unknowns, with the features eliminated."""

    residual: Array  # (N, 2)
    length: Array  # (N,) of these
    weight: Array  # (N,)
    spread_px: float
    by_unknown: Array  # (N, 2, U)
    weighted: Array  # (N, 2, U) the same times the weight
    cross: Array  # (T, 3, U) of the features with the unknowns
    slopes: Array  # (T, 3) the features' part of the gradient
    inverse: Array  # (T, 3, 3) of the features' own blocks
    eliminated: Array  # (T, U, 3) cross times inverse
    reduced: Array  # (U, U)
    gradient: Array  # (U,)


def adjust(tracks: Tracks, state: State, priors: Priors, least_scale_px: float) -> Fit:
    """Robust least squares with the features eliminated by the Schur complement."""
    frames = len(state.pan_rad)
    system: _System

    def linearise(state: State, scale: float) -> NormalEquations:
        nonlocal system
        system = _system(tracks, state, priors, scale)
        cost = float(system.weight @ system.length**2)
        return NormalEquations(system.reduced, system.gradient, system.spread_px, cost)

    def retract(state: State, step: Array) -> State:
        points = -(system.inverse @ (system.slopes + system.cross @ step)[:, :, None])[:, :, 0]
        return _stepped(state, step, points)

    def settled(step: Array) -> bool:
        return bool(np.abs(step[:frames]).max() < 1e-7 and np.abs(step[-2:]).max() < 1e-6)

    schedule = Schedule(ITERATIONS, START_SCALE_PX, least_scale=least_scale_px)
    solution = minimise(state, linearise, retract, settled, schedule, held=0)  # the first frame's pan is 0
    free = np.arange(1, frames + SHARED)
    return Fit(solution.state, system.spread_px, _offset_covariance(tracks, system, priors, free, solution.scale))


def _system(tracks: Tracks, state: State, priors: Priors, scale_px: float) -> _System:
    frames, count = len(state.pan_rad), len(state.points)
    used = priors.known[tracks.track]
    residual, by_pan, by_shared, by_point = linearised(tracks, state)
    length = np.hypot(*residual.T)
    weight = geman_mcclure(length, scale_px) * used
    spread = max(planar_sigma(length[used]), 0.01)
    by_unknown = np.zeros((len(residual), 2, frames + SHARED))
    by_unknown[np.arange(len(residual)), :, tracks.frame] = by_pan
    by_unknown[:, :, frames:] = by_shared
    weighted = by_unknown * weight[:, None, None]
    normal = np.einsum("nij,nik->jk", weighted, by_unknown) + np.diag(_information(priors, frames)) * spread**2
    gradient = np.einsum("nij,ni->j", weighted, residual)
    gradient[frames:] += spread**2 * (state.shared() - priors.shared) / priors.sigmas**2
    blocks, cross, slopes = np.zeros((count, 3, 3)), np.zeros((count, 3, frames + SHARED)), np.zeros((count, 3))
    turned = (by_point * weight[:, None, None]).transpose(0, 2, 1)
    np.add.at(blocks, tracks.track, turned @ by_point)
    np.add.at(cross, tracks.track, turned @ by_unknown)
    np.add.at(slopes, tracks.track, (turned @ residual[:, :, None])[:, :, 0])
    blocks += np.eye(3) * np.array([1e-6, 1e-6, 0.0])  # a feature without weight must not be singular
    blocks[:, 2, 2] += spread**2 / priors.nearness_sigma**2
    slopes[:, 2] += spread**2 * (state.points[:, 2] - priors.nearness) / priors.nearness_sigma**2
    inverse = np.asarray(np.linalg.inv(blocks), np.float64)
    eliminated = cross.transpose(0, 2, 1) @ inverse
    reduced = normal - np.einsum("tij,tjk->ik", eliminated, cross)
    gradient -= np.einsum("tij,tj->i", eliminated, slopes)
    return _System(
        residual, length, weight, spread, by_unknown, weighted, cross, slopes, inverse, eliminated, reduced, gradient
    )


def _information(priors: Priors, frames: int) -> Array:
    """(U,) What is believed: nothing of the pans."""
    return np.concatenate([np.zeros(frames), priors.sigmas**-2.0])


def _offset_covariance(
    tracks: Tracks, system: _System, priors: Priors, free: NDArray[np.int64], scale_px: float
) -> Array:
    """(2, 2) The errors of one feature are taken for dependent on each other: it is found a little beside where it is
    in all frames alike. So scores are summed a feature (Liang and Zeger, 1986), as they would be if it had not been
    fitted itself (Bell and McCaffrey, 2002)."""
    count, unknowns = system.slopes.shape[0], len(system.gradient)
    scores = np.zeros((count, unknowns))
    np.add.at(scores, tracks.track, np.einsum("nij,ni->nj", system.weighted, system.residual))
    scores -= (system.eliminated @ system.slopes[:, :, None])[:, :, 0]
    own = np.zeros((count, unknowns, unknowns))  # each feature's part of the reduced normal matrix
    np.add.at(own, tracks.track, system.weighted.transpose(0, 2, 1) @ system.by_unknown)
    own = (own - system.eliminated @ system.cross)[:, free[:, None], free]
    bread = np.linalg.inv(system.reduced[np.ix_(free, free)])
    # the weights fall with the residual, so that the cost curves less than they say (Huber, 1981)
    squared = system.length**2
    curving = np.sum(system.weight * (1.0 - 2.0 * squared / (scale_px**2 + squared))) / np.sum(system.weight)
    left_out = np.linalg.solve(np.eye(len(free)) - own @ bread, scores[:, free, None])[:, :, 0]
    believed = _information(priors, unknowns - SHARED)[free]
    meat = left_out.T @ left_out + np.diag(believed) * system.spread_px**4
    covariance = bread @ meat @ bread / curving**2
    return np.asarray(covariance[-2:, -2:], np.float64)


def _stepped(state: State, step: Array, moved: Array) -> State:
    frames = len(state.pan_rad)
    log_focal, tilt, roll, _, _, k1 = step[frames : frames + 6]
    before = state.view
    view = replace(
        before, tilt_rad=before.tilt_rad + tilt, roll_rad=before.roll_rad + roll,
        focal_px=before.focal_px * float(np.exp(np.clip(log_focal, -0.3, 0.3))),
        principal_px=before.principal_px + step[frames + 3 : frames + 5],
        distortion=before.distortion._replace(k1=before.distortion.k1 + k1),
    )  # fmt: skip
    return State(state.pan_rad + step[:frames], view, state.offset_m + step[-2:], state.points + moved)
