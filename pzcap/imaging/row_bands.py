"""Bands that mains light leaves in the rows of a rolling shutter: lamps flicker at twice the mains' frequency, and rows
are exposed one after the other.

The gain of a row is ``1 + sum_k c_k cos(k pi (tau + 1/2))``, tau the time of the row (`row_time`): a few cosines have
any smooth bands, whatever their frequency and phase.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.imaging.tuning import BANDS
from pzcap.solver.robust import geman_mcclure, normal_sigma
from pzcap.types import Array, Float32, Image

NO_BANDS: Array = np.zeros(0)


class Overlaps(NamedTuple):
    """Pixels that two frames show, an overlap after the other, for kernels."""

    ends: NDArray[np.int64]  # (L, 2) the first and the second frame of each overlap
    bounds: NDArray[np.int64]  # (L + 1,) where each overlap's pixels begin
    lit: Float32  # (N,) as bright as the second frame would show it in the light of the first
    difference: Float32  # (N,) how much brighter the second frame shows it; inf where it does not
    time: Float32  # (N, 2) row time in the first frame and in the second


def row_time(rows: Array, height: int) -> Array:
    """Time (...) at which pixel ``rows`` (...) of a frame are exposed: -1/2 at its top edge, 1/2 at its bottom edge, in
    units of the time that its read-out takes."""
    return np.asarray((rows + 0.5) / height - 0.5)


def gain(bands: Array, time: Array) -> Array:
    """Gain (...) at row times (...) of ``bands`` (K,)."""
    return np.asarray(1.0 + _cosines(time, len(bands)) @ bands)


def fit(ratio: Array, time: Array, squared: Array) -> Array:
    """Bands (K,) from ``ratio`` (N,) of frame to panorama at row times (N,), and at ``squared`` distances (N,) from the
    principal point, of which vignetting is a function; NO_BANDS where there are none to speak of.

    Most pixels show the hall: iteratively reweighted least squares, with the bands held to 0 by a prior. Some of them
    tell whether there are any, which is seldom.
    """
    usual = float(np.median(ratio))
    if usual <= 0.0 or len(ratio) < BANDS.least_pixels:
        return NO_BANDS
    some = slice(None, None, BANDS.telling)
    if _strength(_fitted(ratio[some] / usual, time[some], squared[some], BANDS.telling_rounds)) < BANDS.suspicious:
        return NO_BANDS
    bands = _fitted(ratio / usual, time, squared, BANDS.rounds)
    return bands if _strength(bands) > BANDS.least else NO_BANDS


def fit_frames(overlaps: Overlaps, count: int) -> Array:
    """Bands (F, K) of ``count`` frames, from what differs where two of them overlap; (F, 0) where there are none to
    speak of.

    Frames one after the other may have nearly the same bands, those further off have not, and all are fitted together:
    iteratively reweighted least squares, a gain of each overlap eliminated. Whether there are any, only what differs
    from frame to frame tells: all have alike what errs of the vignetting.
    """
    some = _some_of(overlaps, BANDS.telling)
    telling = _fitted_to_overlaps(some, count, BANDS.telling_cosines, BANDS.telling_rounds)
    strength = _strength(telling - telling.mean(axis=0))
    if np.median(strength) < BANDS.least_of_sweep and strength.max() < BANDS.least_of_one:
        return np.zeros((count, 0))
    return _fitted_to_overlaps(overlaps, count, BANDS.cosines, BANDS.rounds)


def _some_of(overlaps: Overlaps, every: int) -> Overlaps:
    """One pixel in so many of each overlap."""
    chosen = [np.arange(first, last, every) for first, last in pairwise(overlaps.bounds.tolist())]
    which = np.concatenate(chosen)
    bounds = np.cumsum([0, *map(len, chosen)])
    return Overlaps(overlaps.ends, bounds, overlaps.lit[which], overlaps.difference[which], overlaps.time[which])


def _fitted_to_overlaps(overlaps: Overlaps, count: int, cosines: int, rounds: int) -> Array:
    """`fit_frames`, with so many ``cosines``."""
    seen = overlaps.difference[np.isfinite(overlaps.difference)]
    bands, noise = np.zeros((count, cosines)), max(normal_sigma(seen), 0.1)
    for _ in range(rounds):
        normal, gradient = np.diag(np.full(bands.size, (noise / BANDS.sigma) ** 2)), np.zeros(bands.size)
        left = _add_overlaps(overlaps, bands, BANDS.scale_sigmas * noise, normal, gradient)
        bands = np.asarray(np.linalg.solve(normal, gradient).reshape(bands.shape), np.float64)
        noise = max(normal_sigma(left[np.isfinite(left)]), 0.1)
    return bands


@njit(cache=True, nogil=True, error_model="numpy")
def _add_overlaps(overlaps: Overlaps, bands: Array, scale: float, normal: Array, gradient: Array) -> Float32:
    """Add to the ``normal`` matrix (F K, F K) and the ``gradient`` (F K,) of all frames' bands what each overlap tells,
    its gain eliminated, weighted by what ``bands`` (F, K) leave (N,) of the differences, which is returned."""
    cosines = bands.shape[1]
    left = np.full_like(overlaps.difference, np.inf)
    into = np.empty(2 * cosines, np.int64)
    for link in range(len(overlaps.ends)):
        ends, begin, end = overlaps.ends[link], overlaps.bounds[link], overlaps.bounds[link + 1]
        rows, used = np.empty((end - begin, 2 * cosines + 2)), 0  # both frames' cosines, the gain, the difference
        for side in range(2):
            into[side * cosines : (side + 1) * cosines] = ends[side] * cosines + np.arange(cosines)
        both = bands.ravel()[into]
        lit, drawn = 1e-9, 0.0
        for n in range(begin, end):
            if not np.isfinite(overlaps.difference[n]):
                continue
            row = rows[used]
            for k in range(cosines):
                row[k] = -overlaps.lit[n] * np.cos(np.pi * (k + 1) * (overlaps.time[n, 0] + 0.5))
                row[cosines + k] = overlaps.lit[n] * np.cos(np.pi * (k + 1) * (overlaps.time[n, 1] + 0.5))
            row[2 * cosines], row[2 * cosines + 1] = overlaps.lit[n], overlaps.difference[n]
            left[n] = overlaps.difference[n] - row[: 2 * cosines] @ both
            weight = geman_mcclure(left[n], scale)
            lit += weight * overlaps.lit[n] ** 2
            drawn += weight * overlaps.lit[n] * left[n]
            used += 1
        used = 0
        for n in range(begin, end):
            if np.isfinite(left[n]):
                left[n] -= drawn / lit * overlaps.lit[n]
                rows[used] *= np.sqrt(geman_mcclure(left[n], scale))
                used += 1
        summed = rows[:used].T @ rows[:used]
        gain = summed[2 * cosines]
        for i in range(2 * cosines):
            share = gain[i] / (gain[2 * cosines] + 1e-9)
            gradient[into[i]] += summed[i, 2 * cosines + 1] - share * gain[2 * cosines + 1]
            for j in range(2 * cosines):
                normal[into[i], into[j]] += summed[i, j] - share * gain[j]
    return left


def _strength(bands: Array) -> Array:
    """(...) root mean square of the gain's change of ``bands`` (..., K)."""
    return np.asarray(np.sqrt(np.sum(bands**2, axis=-1) / 2.0))


def _fitted(ratio: Array, time: Array, squared: Array, rounds: int) -> Array:
    """`fit`, of a ``ratio`` that is 1 in most pixels, reweighted so many ``rounds``."""
    design = np.column_stack([np.ones_like(time), squared, _cosines(time, BANDS.cosines)])
    prior = np.diag([0.0, 0.0, *np.full(BANDS.cosines, BANDS.sigma**-2.0)])
    residual, found = ratio - 1.0, np.zeros(design.shape[1])
    for _ in range(rounds):
        noise = max(normal_sigma(residual), 1e-3)
        weighted = design * geman_mcclure(residual, BANDS.scale_sigmas * noise)[:, None] / noise**2
        found = np.linalg.solve(weighted.T @ design + prior, weighted.T @ (ratio - 1.0))
        residual = ratio - 1.0 - design @ found
    return np.asarray(found[2:] / (1.0 + found[0]), np.float64)


def without_bands(image: Image, bands: Array) -> Image:
    """The image (H, W, 3) as if its rows had had the same light."""
    height = image.shape[0]
    rows = gain(bands, row_time(np.arange(float(height)), height)).astype(np.float32)
    return np.clip(np.rint(image / rows[:, None, None]), 0, 255).astype(np.uint8)


def _cosines(time: Array, count: int) -> Array:
    """(..., K)"""
    return np.cos(np.pi * np.arange(1, count + 1) * (time[..., None] + 0.5))
