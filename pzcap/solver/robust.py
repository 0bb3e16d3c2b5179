"""Robust weights, scales and fits: what most values are like, however far off the others are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from pzcap.types import Array, Float32


@njit(cache=True, nogil=True, inline="always")
def geman_mcclure(residual: Any, scale: float) -> Any:
    """Weight ``1 / (1 + (residual / scale)^2)^2`` of a residual, or of each of an array, in kernels and outside.

    It is ``rho'(r) / r`` of ``rho = scale^2 r^2 / (scale^2 + r^2) / 2`` (Geman and McClure, 1987): a quarter where the
    residual equals the scale, and so little far beyond it that outliers no longer pull.
    """
    nearness = 1.0 / (1.0 + (residual / scale) ** 2)
    return nearness * nearness


def normal_sigma(residuals: Array | Float32) -> float:
    """Standard deviation of normally distributed residuals (N,), from the median of their absolute values."""
    return 1.4826 * float(np.median(np.abs(residuals)))


def planar_sigma(lengths: Array) -> float:
    """Standard deviation of a coordinate of normally distributed pairs, from the median of their ``lengths`` (N,)."""
    return float(np.median(lengths)) / 1.1774


def half_sample_mode(values: Array) -> float:
    """Mode of the values (N,), estimated from one in four of them: the middle of the narrowest interval that holds a
    third. Unlike the median it stands where most others are larger (Bickel, 2002)."""
    some = np.sort(values[::4])
    third = len(some) // 3
    first = int(np.argmin(some[third:] - some[: len(some) - third]))
    return float(some[first + third // 2])


@njit(cache=True, nogil=True, error_model="numpy")
def line(
    values: Array, at: Array, weight: Array, scales: tuple[float, ...], start: tuple[float, float]
) -> tuple[float, float]:
    """The a and b of the line a + b x on which most of the ``values`` (N,) lie ``at`` x (N,), from a ``start``.

    One reweighted least-squares step a scale (`geman_mcclure`), times the values' own ``weight`` (N,). The normal
    matrix is made a little rounder, so that it can be solved where all are at one place.
    """
    a, b = start
    for scale in scales:
        n, x, xx, y, xy = 1e-6, 0.0, 1e-6, 0.0, 0.0
        for k in range(len(values)):
            w = weight[k] * geman_mcclure(values[k] - a - b * at[k], scale)
            n, x, xx = n + w, x + w * at[k], xx + w * at[k] * at[k]
            y, xy = y + w * values[k], xy + w * at[k] * values[k]
        determinant = n * xx - x * x
        a, b = (xx * y - x * xy) / determinant, (n * xy - x * y) / determinant
    return a, b


def median_absolute(values: Array) -> float:
    """Median of the absolute values (N,), from one in four of them: good enough for a scale, and four times faster."""
    return median(np.abs(values[::4]))


def median(values: Array) -> float:
    """Upper median of (N,), without numpy's checks, which take longer than the median."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])
