"""Least squares over a whole clip, whose residuals each see a few successive poses only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.types import Array
from sim.motion._kinematics import DOF


class NormalEquations:
    """Normal equations of residuals that couple at most three successive poses."""

    def __init__(self, count: int) -> None:
        self.blocks = np.zeros((3, count, DOF, DOF))
        self.right = np.zeros((count, DOF))

    def add(self, first: NDArray[np.int64], jacobians: Sequence[Array], residuals: Array, sigma: float) -> None:
        """Add residuals (N, M) whose jacobians (N, M, 43) are those of poses ``first``, ``first + 1``, ..."""
        for i, left in enumerate(jacobians):
            weighted = left.transpose(0, 2, 1) / sigma**2
            self.right[first + i] -= (weighted @ residuals[:, :, None])[:, :, 0]
            for j in range(i + 1):
                self.blocks[i - j, first + j] += weighted @ jacobians[j]

    def solve(self) -> Array:
        """Return the step (T, 43)."""
        return _solve_banded(self.blocks, self.right.ravel()).reshape(self.right.shape)


@njit(cache=True)
def _solve_banded(blocks: Array, right: Array) -> Array:
    """Solve a positive definite system of blocks (3, T, B, B) on and below the diagonal by Cholesky's method.

    LAPACK's banded solver does the same, but OpenBLAS shares such small work among threads that wait for each other:
    beside other processes it took fifty times as long.
    """
    _, count, size, _ = blocks.shape
    order, band = count * size, 3 * size
    columns = np.zeros((order, band))  # columns[j, k] is element (j + k, j)
    for k in range(3):
        for t in range(count - k):
            for a in range(size):
                for b in range(size if k else a + 1):
                    columns[t * size + b, k * size + a - b] = blocks[k, t, a, b]
    x = right.copy()
    for j in range(order):
        reach = min(band, order - j)
        pivot = np.sqrt(columns[j, 0])
        for k in range(reach):
            columns[j, k] /= pivot
        x[j] /= pivot
        for k in range(1, reach):
            factor = columns[j, k]
            if factor != 0.0:
                x[j + k] -= factor * x[j]
                for i in range(reach - k):
                    columns[j + k, i] -= factor * columns[j, k + i]
    for j in range(order - 1, -1, -1):
        total = x[j]
        for k in range(1, min(band, order - j)):
            total -= columns[j, k] * x[j + k]
        x[j] = total / columns[j, 0]
    return x
