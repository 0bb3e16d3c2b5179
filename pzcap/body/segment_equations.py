"""Normal equations of the segments as free rigid bodies: accumulated from residuals of points, lifted to the pose.

Every residual of a point ``x`` on a segment is linearised in the segment's own twist ``(v, w)`` about a centre ``c``
near the body, ``dx = v + w x (x - c)``, so that a row of the Jacobian is ``[a, (x - c) x a]`` with ``a`` the gradient
by the point: 16 small matrices in place of thousands of rows of 43.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pzcap.body.skeleton import DOF_SEGMENT, MOVES
from pzcap.types import DOF, PARENTS, SEGMENTS, Array, Indices


class SegmentSums(NamedTuple):
    """Normal equations of each segment by itself, in its twist about ``centre``."""

    hessians: Array  # (16, 6, 6)
    gradients: Array  # (16, 6)
    centre: Array  # (3,) world

    @staticmethod
    def zero(centre: Array) -> SegmentSums:
        """No residuals yet."""
        return SegmentSums(np.zeros((len(SEGMENTS), 6, 6)), np.zeros((len(SEGMENTS), 6)), centre)


class PointResiduals(NamedTuple):
    """Residuals of single points, in pixels; a kernel that fills them in tells how many there are."""

    rows: Array  # (N, 8) weight, residual, its gradient with respect to the point, and the point (world)
    owner: Indices  # (N,) segment or keypoint of the point

    @staticmethod
    def empty(count: int) -> PointResiduals:
        """Room for ``count`` points."""
        return PointResiduals(np.empty((count, 8)), np.empty(count, np.int64))

    def first(self, count: int) -> PointResiduals:
        """The first ``count`` of them."""
        return PointResiduals(self.rows[:count], self.owner[:count])


@njit(cache=True, nogil=True)
def accumulate(rows: Array, segment: Indices, sums: SegmentSums) -> None:
    """Add ``rows`` (N, 8), as `PointResiduals` has them, of points on the ``segment`` (N,) to the ``sums``."""
    hessians, gradients, centre = sums
    wrench = np.empty(6)
    for n in range(len(rows)):
        s = segment[n]
        weight, residual = rows[n, 0], rows[n, 1]
        for k in range(3):
            wrench[k] = rows[n, 2 + k]
        rx, ry, rz = rows[n, 5] - centre[0], rows[n, 6] - centre[1], rows[n, 7] - centre[2]
        wrench[3] = ry * wrench[2] - rz * wrench[1]
        wrench[4] = rz * wrench[0] - rx * wrench[2]
        wrench[5] = rx * wrench[1] - ry * wrench[0]
        for k in range(6):
            for m in range(6):
                hessians[s, k, m] += weight * wrench[k] * wrench[m]
            gradients[s, k] += weight * wrench[k] * residual


@njit(cache=True, nogil=True)
def lift(sums: SegmentSums, twists: Array) -> tuple[Array, Array]:
    """Normal equations of the pose, (43, 43) and (43,), from those of each segment.

    The ``twists`` (43, 6) are those of `pzcap.body.kinematics.screws` about the same centre. What a joint moves, its
    segment and all that hang on it, moves as one body: their equations add up. Two joints meet where one moves the
    segment of the other.
    """
    hessians, gradients = sums.hessians.copy(), sums.gradients.copy()
    for n in range(len(PARENTS) - 1, -1, -1):  # parents come before their children
        if PARENTS[n] >= 0:
            hessians[PARENTS[n]] += hessians[n]
            gradients[PARENTS[n]] += gradients[n]
    hessian, gradient = np.zeros((DOF, DOF)), np.zeros(DOF)
    carried = np.empty(6)
    for d in range(DOF):
        s = DOF_SEGMENT[d]
        for i in range(6):
            gradient[d] += twists[d, i] * gradients[s, i]
            carried[i] = 0.0
            for j in range(6):
                carried[i] += hessians[s, i, j] * twists[d, j]
        for e in range(d + 1):
            if MOVES[e, s]:
                for i in range(6):
                    hessian[d, e] += carried[i] * twists[e, i]
                hessian[e, d] = hessian[d, e]
    return hessian, gradient
