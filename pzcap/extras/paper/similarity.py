"""Eq. 15, the paper's final solution: zoom ratio and place of a frame on the panorama, linear in matched features."""

from __future__ import annotations

import numpy as np

from pzcap.types import Array, Mask


def solve_eq15(relative_px: Array, places_px: Array) -> tuple[Array, Array]:
    """Eq. 15 for matches (N, 2) on the frame's cylinder, relative to its origin, and on the panorama.

    Returns ``(1 / zoom ratio, p_0, q_0)`` and its covariance (3, 3).
    """
    count = len(relative_px)
    system = np.zeros((count, 2, 3))
    system[:, :, 0] = relative_px
    system[:, 0, 1] = system[:, 1, 2] = 1.0
    flat = system.reshape(-1, 3)
    solution = np.linalg.lstsq(flat, places_px.ravel(), rcond=None)[0]
    residual = flat @ solution - places_px.ravel()
    variance = float(residual @ residual) / max(2 * count - 3, 1)
    covariance = variance * np.linalg.pinv(flat.T @ flat)
    return np.asarray(solution, np.float64), np.asarray(covariance, np.float64)


def ransac_eq15(relative_px: Array, places_px: Array, *, draws: int = 1000, tolerance_px: float = 5.0) -> Mask:
    """Mask (N,) of the matches that agree on one zoom ratio and place: random samples of two, always the same ones."""
    best = np.zeros(len(relative_px), bool)
    if len(relative_px) < 2:
        return best
    rng = np.random.default_rng(0)
    for i, j in rng.integers(len(relative_px), size=(draws, 2)):
        span = relative_px[j] - relative_px[i]
        squared = float(span @ span)
        if squared < 20.0**2:
            continue
        shrink = float(span @ (places_px[j] - places_px[i])) / squared
        if not 0.1 < shrink < 10:
            continue
        off = places_px - places_px[i] - shrink * (relative_px - relative_px[i])
        agree = np.hypot(off[:, 0], off[:, 1]) < tolerance_px
        if agree.sum() > best.sum():
            best = agree
    return best
