"""A stretch of frames improved all at once: each image's normal equations, a motion that does not jerk, and feet that
do not slide.

The passes from the keyframes see one frame at a time. Here all frames of a stretch are solved for together, with the
second difference of the motion as prior: minimise over the steps ``d_t`` of all poses

    sum_t 1/2 d_t' H_t d_t - g_t' d_t  +  sum_t 1/2 |d_(t-1) - 2 d_t + d_(t+1) + a_t|^2 / sigma^2

with ``a_t`` the acceleration that the poses have now; and neighbours are tied to each other by what rests on the floor
(`pzcap.tracking.temporal_constraints`). The matrix is banded, so the cost is linear in the frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from pzcap.body.kinematics import difference
from pzcap.body.skeleton import DOF
from pzcap.types import Array, Pose

_REACH = 3  # frames that are tied to each other, at most


@dataclass(frozen=True, slots=True, eq=False)
class Tie:
    """Something that should be 0 and is made by two poses that follow one another."""

    first: int  # of the two
    residual_m: Array  # (R,)
    weight: Array  # (R,)
    jacobians: Array  # (2, R, 43) derivatives of ``residual_m`` by the tangent of each pose


def smooth_step(
    poses: Sequence[Pose], hessians: Sequence[Array], gradients: Sequence[Array], sigma: Array,
    before: Sequence[Pose], ties: Sequence[Tie],
) -> Array:  # fmt: skip
    """Steps (T, 43) of ``poses`` (T of them) with normal equations ``hessians`` (43, 43) and ``gradients`` (43,).

    ``sigma`` (43,) is the standard deviation of the acceleration, a frame squared. The body is held fast in the
    frames ``before`` the stretch. ``ties`` are between all of these, and count from the first of them.
    """
    chain, first = [*before, *poses], len(before)
    count = len(poses)
    band = np.zeros((min(count, _REACH) * DOF, count * DOF))
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
    """Add what ties the frames of the chain; ``first`` of them come before the stretch."""
    rows, columns = np.indices((DOF, DOF))
    below = rows >= columns
    for tie in ties:
        inside = [(tie.first + k - first, each) for k, each in enumerate(tie.jacobians)]
        inside = [(t, each) for t, each in inside if 0 <= t < count]
        for i, (t, earlier) in enumerate(inside):
            right[t * DOF : (t + 1) * DOF] -= earlier.T @ (tie.weight * tie.residual_m)
            for other, later in inside[i:]:
                block, kept = (later.T * tie.weight) @ earlier, below if other == t else np.ones_like(below)
                band[(other - t) * DOF + (rows - columns)[kept], t * DOF + columns[kept]] += block[kept]
