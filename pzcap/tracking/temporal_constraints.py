"""All frames of a stretch solved at once with temporal constraints: motion that does not jerk, feet that do not slide.

The passes from the keyframes see one frame at a time. Here the second difference of the motion has a prior: minimise
over the steps ``d_t`` of all poses

    sum_t 1/2 d_t' H_t d_t - g_t' d_t  +  sum_t 1/2 |d_(t-1) - 2 d_t + d_(t+1) + a_t|^2 / sigma^2

with ``H_t, g_t`` each image's normal equations and ``a_t`` the acceleration that the poses have now. The matrix is
banded, so the cost is linear in the frames.

Neighbours are tied to each other by what rests on the floor: images fix a foot to a millimetre or two in each frame by
itself, so that a standing one trembles. In contact are points near the floor that are all but at rest, as the estimate
itself has them; the more a point moves, the less it is believed to rest, so that a heel that rises is let go.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from pzcap.body.kinematics import difference, forward, point_jacobians, world_points
from pzcap.body.skeleton import Body
from pzcap.solver.robust import geman_mcclure
from pzcap.tracking.tuning import CONTACT
from pzcap.types import DOF, SEGMENTS, Array, Indices, Pose

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
    rows, columns = np.indices((DOF, DOF))
    below = rows >= columns
    for tie in ties:
        frames = [(tie.first + k - first, each) for k, each in enumerate(tie.jacobians)]
        frames = [(t, each) for t, each in frames if 0 <= t < count]
        for i, (t, earlier) in enumerate(frames):
            right[t * DOF : (t + 1) * DOF] -= earlier.T @ (tie.weight * tie.residual_m)
            for other, later in frames[i:]:
                block, kept = (later.T * tie.weight) @ earlier, below if other == t else np.ones_like(below)
                band[(other - t) * DOF + (rows - columns)[kept], t * DOF + columns[kept]] += block[kept]
    return np.asarray(solveh_banded(band, right, lower=True)).reshape(count, DOF)


def soles(body: Body) -> tuple[Indices, Array]:
    """Points that may bear the body: their segments (N,), and the points (N, 3) in the frames of these; heels, balls of
    the feet and fingers."""
    found: list[tuple[int, tuple[float, float, float]]] = []
    for segment, name in enumerate(SEGMENTS):
        skin = body.surface.points_m[body.surface.segment == segment]
        low, high = skin.min(axis=0), skin.max(axis=0)
        if name.endswith("foot"):
            for along in low[0] + np.array([0.15, 0.75]) * (high[0] - low[0]):
                found.append((segment, (along, 0.0, skin[np.abs(skin[:, 0] - along) < 0.02, 2].min())))
        elif name.endswith("hand"):
            found.append((segment, (0.0, 0.0, 0.5 * low[2])))
    segments, points = zip(*found, strict=True)
    return np.array(segments), np.array(points)


def contacts(body: Body, poses: Sequence[Pose]) -> list[Tie]:
    """Ties of consecutive ``poses``: points at rest on the floor stay where they were."""
    (segment, local), placed = soles(body), [forward(body, pose) for pose in poses]
    points = np.array([world_points(frames, segment, local) for frames in placed])
    moved = np.diff(points, axis=0)  # (T - 1, N, 3)
    near = np.maximum(points[1:, :, 2], points[:-1, :, 2]) < CONTACT.near_m
    still = geman_mcclure(np.linalg.norm(moved, axis=-1), CONTACT.rest_m)
    weight = np.where(near & (still > CONTACT.least_weight), still / CONTACT.sigma_m**2, 0.0)
    found = []
    for t in np.flatnonzero(weight.any(axis=1)).tolist():
        held = np.flatnonzero(weight[t])
        before, after = (point_jacobians(placed[k], segment[held], points[k, held]) for k in (t, t + 1))
        jacobians = np.stack([-before, after]).reshape(2, -1, DOF)
        found.append(Tie(t, moved[t, held].ravel(), np.repeat(weight[t, held], 3), jacobians))
    return found
