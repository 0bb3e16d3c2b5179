"""Normal equations of a frame's grey values against the panorama's: kernels of `photometric_alignment`."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.localisation.panorama_sampler import BY_PAN, KNOWN, VALUE
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array


@njit(cache=True, nogil=True)
def tile_scores(
    tile: NDArray[np.int64], tiles: int, sampled: Array, shading: Array, brightness: Array, weighted: Array, free: int
) -> Array:
    """Gradients (tiles, P + K) of the cost, as in `normal_equations`, of the pixels of each ``tile`` (N,); ``weighted``
    (N,) are their residuals times weights."""
    out = np.zeros((tiles, free + shading.shape[1]))
    for n in range(len(tile)):
        for i in range(free):
            out[tile[n], i] += weighted[n] * brightness[n] * sampled[n, BY_PAN + i]
        for i in range(shading.shape[1]):
            out[tile[n], free + i] += weighted[n] * shading[n, i] * sampled[n, VALUE]
    return out


@njit(cache=True, nogil=True)
def normal_equations(
    sampled: Array, shading: Array, brightness: Array, residual: Array, scale: float, free: int
) -> tuple[Array, Array, Array, float]:
    """Geman-McClure weights (N,) of residuals (N,) and the normal equations: their matrix (P + K, P + K) and gradient
    (P + K,), for the first ``free`` unknowns of the place and the K gains of the ``shading`` (N, K).

    A pixel's residual is its grey value less ``brightness`` (N,) times the panorama's. At last the cost's mean second
    derivative as a share of the weight that stands for it in the matrix: weights fall as residuals grow.
    """
    count = free + shading.shape[1]
    weights, row = np.zeros(len(residual)), np.empty(count)
    normal, gradient = np.zeros((count, count)), np.zeros(count)
    curved, total = 0.0, 0.0
    for n in range(len(residual)):
        if sampled[n, KNOWN] == 0.0:
            continue
        weight = geman_mcclure(residual[n], scale)
        weights[n] = weight
        total += weight
        curved += weight * (4.0 * np.sqrt(weight) - 3.0)
        for i in range(free):
            row[i] = brightness[n] * sampled[n, BY_PAN + i]
        for i in range(free, count):
            row[i] = shading[n, i - free] * sampled[n, VALUE]
        for i in range(count):
            weighted = weight * row[i]
            gradient[i] -= weighted * residual[n]
            for j in range(i + 1):
                normal[i, j] += weighted * row[j]
    for i in range(count):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return weights, normal, gradient, curved / total
