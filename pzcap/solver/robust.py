"""Robust weights and scales: what most of some values are like, however far off the others are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from pzcap.types import Array


@njit(cache=True, nogil=True, inline="always")
def geman_mcclure(squared: float) -> float:
    """Weight of a residual, ``1 / (1 + squared)^2`` of its square over the squared scale (Geman and McClure, 1987)."""
    nearness = 1.0 / (1.0 + squared)
    return nearness * nearness


def geman_mcclure_weights(residual: ArrayLike, scale: float) -> Array:
    """`geman_mcclure` of residuals (...) at a ``scale`` in their unit."""
    squared: Any = (np.asarray(residual) / scale) ** 2
    return np.asarray(geman_mcclure.py_func(squared), np.float64)


def half_sample_mode(values: Array) -> float:
    """Middle of the narrowest interval that holds a third of the values (N,), of one in four of them: what the others
    are like does not matter, be they all larger."""
    some = np.sort(values[::4])
    third = len(some) // 3
    first = int(np.argmin(some[third:] - some[: len(some) - third]))
    return float(some[first + third // 2])


@njit(cache=True, nogil=True)
def line(
    values: Array, at: Array, weight: Array, scales: tuple[float, ...], start: tuple[float, float]
) -> tuple[float, float]:
    """The a and b of the line a + b x on which most of the ``values`` (N,) lie ``at`` x (N,), from a ``start``.

    A step a scale: with the weights of Geman and McClure of that scale, beside the values' own ``weight`` (N,).
    """
    a, b = start
    for scale in scales:
        ones, first, second, sums, products = 1e-6, 0.0, 1e-6, 0.0, 0.0
        for n in range(len(values)):
            robust = weight[n] * geman_mcclure(((values[n] - a - b * at[n]) / scale) ** 2)
            ones += robust
            first += robust * at[n]
            second += robust * at[n] * at[n]
            sums += robust * values[n]
            products += robust * at[n] * values[n]
        determinant = ones * second - first * first
        a, b = (second * sums - first * products) / determinant, (ones * products - first * sums) / determinant
    return a, b


def median_absolute(values: Array) -> float:
    """Median of the absolute values (N,), of one in four of them: as good for a scale, and sorting takes long."""
    return median(np.abs(values[::4]))


def median(values: Array) -> float:
    """The upper median of (N,): numpy's checks its input for longer than it takes."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])
