"""What most of some values are like, however far off the others are."""

from __future__ import annotations

import numpy as np
from numba import njit

from pzcap.types import Array


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
            robust = weight[n] / (1.0 + ((values[n] - a - b * at[n]) / scale) ** 2) ** 2
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
