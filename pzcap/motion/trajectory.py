"""A stretch of frames improved all at once: each image's normal equations, a motion that does not jerk, and feet that
do not slide.

The passes from the keyframes see one frame at a time. Here all frames of a stretch are solved for together, with the
second difference of the motion as prior: minimise over the steps ``d_t`` of all poses

    sum_t 1/2 d_t' H_t d_t - g_t' d_t  +  sum_t 1/2 |d_(t-1) - 2 d_t + d_(t+1) + a_t|^2 / sigma^2

with ``a_t`` the acceleration that the poses have now; and what rests on the floor is tied to where it is in the next
frame (`pzcap.motion.contact`). The matrix is banded, so the cost is linear in the frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.linalg import solveh_banded

from pzcap.motion.body import DOF, difference
from pzcap.motion.contact import Tie
from pzcap.types import Array, Pose


def smooth_step(
    poses: Sequence[Pose], hessians: Sequence[Array], gradients: Sequence[Array], sigma: Array,
    before: Sequence[Pose], ties: Sequence[Tie],
) -> Array:  # fmt: skip
    """Steps (T, 43) of ``poses`` (T of them) with normal equations ``hessians`` (43, 43) and ``gradients`` (43,).

    ``sigma`` (43,) is the standard deviation of the acceleration, a frame squared. The body is held fast in the
    frames ``before`` the stretch. ``ties`` are those between all of these, in their order.
    """
    chain, first = [*before, *poses], len(before)
    count = len(poses)
    band = np.zeros((2 * DOF + 1 if count > 2 else min(count, 2) * DOF, count * DOF))
    right = np.concatenate(gradients)
    rows, columns = np.tril_indices(DOF)
    for t, hessian in enumerate(hessians):
        band[rows - columns, t * DOF + columns] += hessian[rows, columns]
    information = 1.0 / sigma**2
    velocity = [difference(b, a) for a, b in itertools.pairwise(chain)]
    for k in range(1, len(chain) - 1):
        bend = velocity[k] - velocity[k - 1]
        three = [(k - 1 - first, 1.0), (k - first, -2.0), (k + 1 - first, 1.0)]
        inside = [(t, c) for t, c in three if 0 <= t < count]
        for i, (t, c) in enumerate(inside):
            at = slice(t * DOF, (t + 1) * DOF)
            right[at] -= c * information * bend
            for other, d in inside[i:]:
                band[(other - t) * DOF, at] += c * d * information
    _tie(band, right, ties, first, count)
    return np.asarray(solveh_banded(band, right, lower=True)).reshape(count, DOF)


def _tie(band: Array, right: Array, ties: Sequence[Tie], first: int, count: int) -> None:
    """Add what rests from each frame of the chain to the next; ``first`` of its frames come before the stretch."""
    rows, columns = np.tril_indices(DOF)
    every_row, every_column = np.indices((DOF, DOF))
    for k, tie in enumerate(ties):
        earlier, later = k - first, k + 1 - first
        for t, jacobian in zip((earlier, later), tie.jacobians, strict=True):
            if 0 <= t < count:
                weighted = jacobian.T * tie.weight
                right[t * DOF : (t + 1) * DOF] -= weighted @ tie.moved_m
                band[rows - columns, t * DOF + columns] += (weighted @ jacobian)[rows, columns]
        if earlier >= 0 and later < count:
            across = (tie.jacobians[1].T * tie.weight) @ tie.jacobians[0]
            band[DOF + every_row - every_column, earlier * DOF + every_column] += across
