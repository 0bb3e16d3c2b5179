"""Bands that mains light leaves in the rows of a rolling shutter: lamps flicker at twice the mains' frequency, and rows
are exposed one after the other.

The gain of a row is ``1 + sum_k c_k cos(k pi (tau + 1/2))``, tau the time of the row (`panorama_sampler.row_time`): a
few cosines have any smooth bands, whatever their frequency and phase.
"""

from __future__ import annotations

import numpy as np

from pzcap.localisation.panorama_sampler import row_time
from pzcap.localisation.tuning import BANDS
from pzcap.solver.robust import geman_mcclure, normal_sigma
from pzcap.types import Array, Image

NO_BANDS: Array = np.zeros(0)


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
    if _strength(_fitted(ratio[some] / usual, time[some], squared[some])) < BANDS.suspicious:
        return NO_BANDS
    bands = _fitted(ratio / usual, time, squared)
    return bands if _strength(bands) > BANDS.least else NO_BANDS


def _strength(bands: Array) -> float:
    """Root mean square of the gain's change."""
    return float(np.sqrt(np.sum(bands**2) / 2.0))


def _fitted(ratio: Array, time: Array, squared: Array) -> Array:
    """`fit`, of a ``ratio`` that is 1 in most pixels."""
    design = np.column_stack([np.ones_like(time), squared, _cosines(time, BANDS.cosines)])
    prior = np.diag([0.0, 0.0, *np.full(BANDS.cosines, BANDS.sigma**-2.0)])
    residual, found = ratio - 1.0, np.zeros(design.shape[1])
    for _ in range(BANDS.rounds):
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
