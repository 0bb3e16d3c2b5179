"""Refit of the poses of early frames to the body as it is known in the end.

The body is known better after every interval between keyframes (`pzcap.body.shape_estimation`), so that what was
tracked first had the worst of it. The images have told where the skin is, and only the body where in it the joints are.
When all is tracked, each pose is therefore changed until the skin of the body as it is known now lies where that of its
time lay.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.body.skeleton import Body, forward, joints, lift, place, retract, screws
from pzcap.tracking.interval_solver import BodyEstimate, Tracked
from pzcap.tracking.residuals import SegmentSums
from pzcap.tracking.tuning import REFIT
from pzcap.types import SEGMENTS, Array, Pose


def refit_shape(estimate: BodyEstimate, tracked: Iterable[Tracked]) -> list[Tracked]:
    """The frames ``tracked`` with the body as it was known then, refitted to the body as it is known now."""
    now, then, body = estimate.known, estimate.known, estimate.body
    found = []
    for each in tracked:
        if each.shape is not then:  # all of an interval share theirs
            then, body = each.shape, estimate.shape.body(each.shape.amounts_m)
        if then is not now:
            pose = refit_pose(each.pose, body, estimate.body)
            variance = each.sigma_m**2 - then.joint_variance_m2 + now.joint_variance_m2
            sigma, joints_m = np.sqrt(variance), joints(estimate.body, pose)
            each = replace(each, pose=pose, joints_m=joints_m, sigma_m=sigma, shape=now)
        found.append(each)
    return found


def refit_pose(pose: Pose, then: Body, now: Body) -> Pose:
    """The pose in which the skin of ``now`` lies where the body ``then``, of the same mesh, has it in ``pose``."""
    wanted = place(then, forward(then, pose))[0][:: REFIT.stride]
    surface = now.surface
    segment, area = surface.segment[:: REFIT.stride], surface.area_m2[:: REFIT.stride]
    for _ in range(REFIT.steps):
        frames = forward(now, pose)
        points, normals = (values[:: REFIT.stride] for values in place(now, frames))
        centre = np.ascontiguousarray(frames[0, :3, 3])
        sums = SegmentSums(np.zeros((len(SEGMENTS), 6, 6)), np.zeros((len(SEGMENTS), 6)), centre)
        _accumulate(points, normals, wanted, area, segment, sums)
        hessian, gradient = lift(sums.hessians, sums.gradients, screws(frames, centre))
        pose = retract(pose, np.asarray(np.linalg.solve(hessian, gradient), np.float64))
    return pose


@njit(cache=True, nogil=True)
def _accumulate(
    points: Array, normals: Array, wanted: Array, area: Array, segment: NDArray[np.int64], sums: SegmentSums
) -> None:
    """Add the normal equations of ``points`` (N, 3) that should be where they are ``wanted`` (N, 3) to the ``sums``."""
    hessians, gradients, centre = sums
    row = np.empty(6)
    for n in range(len(points)):
        s = segment[n]
        for way in range(4):  # along each of the world's axes, and across the skin
            for i in range(3):
                row[i] = normals[n, i] if way == 3 else (1.0 if way == i else 0.0)
            x, y, z = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
            row[3], row[4], row[5] = y * row[2] - z * row[1], z * row[0] - x * row[2], x * row[1] - y * row[0]
            residual = 0.0
            for i in range(3):
                residual += row[i] * (wanted[n, i] - points[n, i])
            weight = area[n] * (1.0 - REFIT.along if way == 3 else REFIT.along)
            for i in range(6):
                gradients[s, i] += weight * residual * row[i]
                for j in range(6):
                    hessians[s, i, j] += weight * row[i] * row[j]
