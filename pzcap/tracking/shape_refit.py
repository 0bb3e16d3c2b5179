"""The poses of early frames with the body as it is known in the end.

The body is known better after every interval between keyframes (`pzcap.body.shape_estimation`), so that what was
tracked first had the worst of it. The images have told where the skin is, and only the body where in it the joints are.
When all is tracked, each pose is therefore changed until the skin of the body as it is known now lies where that of its
time lay.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.body.skeleton import Body, forward, lift, place, retract, screws
from pzcap.types import SEGMENTS, Array, Pose

_ALONG: Final = 0.03
"""What it counts by how much a point has moved along the skin, of what it counts across: outlines show the latter, and
the texture, which shows the former, was learned with the body of its time."""
_SPARSE: Final = 3  # of so many points of the skin one is looked at
_STEPS: Final = 2  # of Gauss and Newton


def refit_poses(pose: Pose, then: Body, now: Body) -> Pose:
    """The pose in which the skin of ``now`` lies where the body ``then``, of the same mesh, has it in ``pose``."""
    wanted = place(then, forward(then, pose))[0][::_SPARSE]
    surface = now.surface
    segment, area = surface.segment[::_SPARSE], surface.area_m2[::_SPARSE]
    for _ in range(_STEPS):
        frames = forward(now, pose)
        points, normals = (values[::_SPARSE] for values in place(now, frames))
        centre = np.ascontiguousarray(frames[0, :3, 3])
        hessians, gradients = np.zeros((len(SEGMENTS), 6, 6)), np.zeros((len(SEGMENTS), 6))
        _pull(points, normals, wanted, area, segment, centre, hessians, gradients)
        hessian, gradient = lift(hessians, gradients, screws(frames, centre))
        pose = retract(pose, np.asarray(np.linalg.solve(hessian, gradient), np.float64))
    return pose


@njit(cache=True, nogil=True)
def _pull(
    points: Array, normals: Array, wanted: Array, area: Array, segment: NDArray[np.int64], centre: Array,
    hessians: Array, gradients: Array,
) -> None:  # fmt: skip
    """Add up the normal equations of ``points`` (N, 3) that should be where they are ``wanted`` (N, 3), each segment's
    in its own twist about the ``centre``, as `pzcap.body.skeleton.lift` takes them."""
    row = np.empty(6)
    for n in range(len(points)):
        s = segment[n]
        for way in range(4):  # across the skin, and along each of the world's axes
            for i in range(3):
                row[i] = normals[n, i] if way == 3 else (1.0 if way == i else 0.0)
            x, y, z = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
            row[3], row[4], row[5] = y * row[2] - z * row[1], z * row[0] - x * row[2], x * row[1] - y * row[0]
            residual = 0.0
            for i in range(3):
                residual += row[i] * (wanted[n, i] - points[n, i])
            weight = area[n] * (1.0 - _ALONG if way == 3 else _ALONG)
            for i in range(6):
                gradients[s, i] += weight * residual * row[i]
                for j in range(6):
                    hessians[s, i, j] += weight * row[i] * row[j]
