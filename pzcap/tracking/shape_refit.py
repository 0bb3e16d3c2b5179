"""Refit of the poses of early frames to the body as it is known in the end.

The body is known better after every interval between keyframes (`pzcap.body.shape_estimation`), so that what was
tracked first had the worst of it. The images tell where the skin is, and only the body where in it the joints are.
When all is tracked, each pose is therefore changed until the skin of the body as it is known now lies where that of its
time lay.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pzcap.body.kinematics import forward, joints, place, retract, screws
from pzcap.body.segment_equations import SegmentSums, accumulate, lift
from pzcap.body.skeleton import Body
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.interval import Tracked
from pzcap.tracking.tuning import SHAPE
from pzcap.types import Pose


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
    wanted = place(then, forward(then, pose))[0][:: SHAPE.refit_stride]
    surface = now.surface
    segment, area = surface.segment[:: SHAPE.refit_stride], surface.area_m2[:: SHAPE.refit_stride]
    for _ in range(SHAPE.refit_steps):
        frames = forward(now, pose)
        points, normals = (values[:: SHAPE.refit_stride] for values in place(now, frames))
        centre = np.ascontiguousarray(frames[0, :3, 3])
        sums = SegmentSums.zero(centre)
        # residuals along each of the world's axes, and across the skin
        ways = np.stack([*(np.broadcast_to(axis, points.shape) for axis in np.eye(3)), normals])
        residual = np.sum(ways * (wanted - points), axis=2)
        weight = area * np.array([SHAPE.refit_along] * 3 + [1.0 - SHAPE.refit_along])[:, None]
        rows = np.dstack([weight, residual, ways, np.broadcast_to(points, ways.shape)]).reshape(-1, 8)
        accumulate(rows, np.tile(segment, 4), sums)
        hessian, gradient = lift(sums, screws(frames, centre))
        pose = retract(pose, np.asarray(np.linalg.solve(hessian, gradient), np.float64))
    return pose
