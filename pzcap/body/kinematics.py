"""Kinematics: poses as points of a manifold, and the rigid motions of the sixteen segments that follow from them.

The tangent of a pose is a vector of 43 numbers (metres, radians):

* ``[0:3]`` root translation, along the world's axes;
* then, per segment in the order of ``SEGMENTS``, a rotation increment about the *segment's own* axes, applied from the
  right, ``R <- R Exp(increment)``: three numbers for a ball joint, one about the fixed axis for a hinge.

`retract` and `difference` go forth and back; `screws` is the derivative of every rigid motion with respect to it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from pzcap.body.joint_limits import LIMIT_HIGH, LIMIT_LOW
from pzcap.body.skeleton import DOF_AXES, DOF_SEGMENT, MOVES, Body
from pzcap.types import DOF, PARENTS, SEGMENTS, Array, Indices, Pose

Quaternion = tuple[float, float, float, float]
Coordinates = tuple[Array, Array, Array]

_PARENTS: Final[Indices] = np.array(PARENTS)
_IDENTITY: Final[Array] = np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1))


_SPREAD: Final[Array] = np.zeros((len(SEGMENTS), 3, DOF))
_SPREAD[DOF_SEGMENT[3:], :, np.arange(3, DOF)] = DOF_AXES[3:]
_SPREAD.shape = (-1, DOF)
"""(48, 43) Takes a tangent vector to the rotation vectors of all segments; the transpose takes it back."""


def forward(body: Body, pose: Pose) -> Array:
    """``world_T_segment``, (16, 4, 4). Joint centres are ``[:, :3, 3]``."""
    return np.asarray(chain(pose.root_position_m, pose.rotations, body.offsets_m, _PARENTS))


def joints(body: Body, pose: Pose) -> Array:
    """Joint centres in the world, (16, 3)."""
    return forward(body, pose)[:, :3, 3]


def retract(pose: Pose, delta: Array) -> Pose:
    """The pose moved by a tangent vector (43,)."""
    increments = _SPREAD @ delta
    return Pose(pose.root_position_m + delta[:3], turn(pose.rotations, increments.reshape(-1, 3)))


def difference(to: Pose, start: Pose) -> Array:
    """The tangent vector (43,) with ``retract(start, difference(to, start)) == to``.

    Of a hinge only the turn about its axis is kept.
    """
    delta = between(start.rotations, to.rotations).ravel() @ _SPREAD
    delta[:3] = to.root_position_m - start.root_position_m
    return np.asarray(delta)


def joint_angles(pose: Pose) -> Array:
    """(43,) Components of the joints' rotation vectors about their axes; 0 of the root's translation."""
    return difference(pose, Pose(pose.root_position_m, _IDENTITY))


def limit_residuals(pose: Pose) -> tuple[Array, Array]:
    """Excess (radians) of each component of the joints' rotation vectors over its limit: residual (43,), and the
    diagonal of its derivative (43,), 1 where violated. The derivative takes rotation vectors for tangent vectors,
    which is right about the axis of rotation and good enough for a soft wall elsewhere."""
    angles = joint_angles(pose)
    residual = np.maximum(angles - LIMIT_HIGH, 0.0) + np.minimum(angles - LIMIT_LOW, 0.0)
    return residual, (residual != 0.0).astype(np.float64)


def place(body: Body, world_T_segment: Array) -> tuple[Array, Array]:
    """Skin in the world: points (V, 3) and unit normals (V, 3), a coordinate after the other in memory."""
    surface = body.surface
    points, normals = (np.empty(surface.points_m.shape, order="F") for _ in range(2))
    _carry(world_T_segment, surface.segment, surface.points_m, surface.normals, points, normals)
    return points, normals


def screws(world_T_segment: Array, centre_m: Array) -> Array:
    """Joint screws, (43, 6): the twist ``(v, w)`` that one unit of a degree of freedom gives to what it moves.

    A point ``x`` that is moved (``MOVES``) has the velocity ``v + w x (x - centre_m)``. Expressing all twists about one
    centre near the body lets the normal equations be accumulated per segment (6 x 6) and lifted afterwards.
    """
    return np.asarray(_screws(world_T_segment, np.ascontiguousarray(centre_m)))


def world_points(world_T_segment: Array, segment: Indices, points_m: Array) -> Array:
    """(N, 3) in the world of points (N, 3) that are fixed to segments (N,), in their frames."""
    frames = world_T_segment[segment]
    return np.asarray(np.einsum("nij,nj->ni", frames[:, :3, :3], points_m) + frames[:, :3, 3])


def point_jacobians(world_T_segment: Array, segment: Indices, points_m: Array) -> Array:
    """Derivatives (N, 3, 43) of world points (N, 3) that are fixed to segments (N,) by the pose's tangent."""
    centre = world_T_segment[0, :3, 3]
    twists = screws(world_T_segment, centre)
    velocity = twists[:, :3] + np.cross(twists[:, 3:], (points_m - centre)[:, None])  # (N, 43, 3)
    return np.where(MOVES[:, segment].T[..., None], velocity, 0.0).transpose(0, 2, 1)


def joint_jacobians(world_T_segment: Array) -> Array:
    """Derivatives (16, 3, 43) of all joint centres by the pose's tangent."""
    return point_jacobians(world_T_segment, np.arange(len(SEGMENTS)), world_T_segment[:, :3, 3])


@njit(cache=True, nogil=True)
def _screws(frames: Array, centre: Array) -> Array:
    out = np.zeros((DOF, 6))
    for d in range(DOF):
        if d < 3:
            out[d, d] = 1.0
            continue
        m = frames[DOF_SEGMENT[d]]
        for i in range(3):
            out[d, 3 + i] = m[i, 0] * DOF_AXES[d, 0] + m[i, 1] * DOF_AXES[d, 1] + m[i, 2] * DOF_AXES[d, 2]
        rx, ry, rz = centre[0] - m[0, 3], centre[1] - m[1, 3], centre[2] - m[2, 3]
        out[d, 0] = out[d, 4] * rz - out[d, 5] * ry
        out[d, 1] = out[d, 5] * rx - out[d, 3] * rz
        out[d, 2] = out[d, 3] * ry - out[d, 4] * rx
    return out


@njit(cache=True, nogil=True)
def _carry(
    frames: Array, segment: Indices, points: Array, normals: Array, out_points: Array, out_normals: Array
) -> None:
    """Points and normals (V, 3) from their segments' frames to the world; they come segment by segment."""
    begin = 0
    while begin < len(points):
        end = segment_end(segment, begin)
        here, across = coordinates(points, begin, end), coordinates(normals, begin, end)
        for i in range(3):
            m = frames[segment[begin], i]
            _row_times(m, here, m[3], out_points[:, i][begin:end])
            _row_times(m, across, 0.0, out_normals[:, i][begin:end])
        begin = end


@njit(cache=True, nogil=True)
def _row_times(row: Array, vectors: Coordinates, shift: float, out: Array) -> None:
    """Fill in ``out`` (N,): a row of a matrix times ``vectors`` (N, 3), and a ``shift``."""
    a, b, c = row[0], row[1], row[2]
    x, y, z = vectors
    for n in range(len(out)):
        out[n] = a * x[n] + b * y[n] + c * z[n] + shift


@njit(cache=True, nogil=True)
def segment_end(segment: Indices, begin: int) -> int:
    """The first point after ``begin`` that is of another segment."""
    end = begin + 1
    while end < len(segment) and segment[end] == segment[begin]:
        end += 1
    return end


@njit(cache=True, nogil=True, inline="always")
def coordinates(points: Array, begin: int, end: int) -> Coordinates:
    """Some of the points (V, 3), which lie a coordinate after the other in memory, so that the compiler vectorises a
    loop over them."""
    return points[:, 0][begin:end], points[:, 1][begin:end], points[:, 2][begin:end]


@njit(cache=True, nogil=True)
def chain(root: Array, quaternions: Array, offsets: Array, parents: Indices) -> Array:
    """``world_T_segment`` (N, 4, 4) from the root (3,), rotations (N, 4) and joints in their parents (N, 3)."""
    out, local = np.zeros((len(quaternions), 4, 4)), np.eye(4)
    for n in range(len(quaternions)):
        w, x, y, z = quaternions[n, 0], quaternions[n, 1], quaternions[n, 2], quaternions[n, 3]
        s, p = 2.0 / (w * w + x * x + y * y + z * z), parents[n]
        local[0, :3] = 1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)
        local[1, :3] = s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)
        local[2, :3] = s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)
        local[:3, 3] = root if p < 0 else offsets[n]
        out[n] = local if p < 0 else out[p] @ local
    return out


@njit(cache=True, nogil=True)
def turn(quaternions: Array, increments: Array) -> Array:
    """``q exp(increment)`` for quaternions (N, 4) and rotation vectors (N, 3), of unit length."""
    out = np.empty_like(quaternions)
    for n in range(len(quaternions)):
        x, y, z = increments[n, 0], increments[n, 1], increments[n, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        # sin(a/2)/a without dividing by zero
        s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else np.sin(0.5 * angle) / angle
        a = quaternions[n, 0], quaternions[n, 1], quaternions[n, 2], quaternions[n, 3]
        w, i, j, k = _product(a, (np.cos(0.5 * angle), s * x, s * y, s * z))
        length = np.sqrt(w * w + i * i + j * j + k * k)
        out[n] = w / length, i / length, j / length, k / length
    return out


@njit(cache=True, nogil=True)
def between(start: Array, to: Array) -> Array:
    """Rotation vectors (N, 3) with ``turn(start, result) == to``, no longer than half a turn."""
    out = np.empty((len(start), 3))
    for n in range(len(start)):
        back = start[n, 0], -start[n, 1], -start[n, 2], -start[n, 3]
        w, x, y, z = _product(back, (to[n, 0], to[n, 1], to[n, 2], to[n, 3]))
        sine = np.sqrt(x * x + y * y + z * z)
        sign = 1.0 if w >= 0.0 else -1.0
        scale = 2.0 * sign if sine < 1e-9 else 2.0 * np.arctan2(sine, sign * w) / sine * sign
        out[n] = scale * x, scale * y, scale * z
    return out


@njit(cache=True, nogil=True)
def turned(before: Array, after: Array) -> Array:
    """Rotation vectors (N, 3), along the axes of the world, from frames (N, 4, 4) to others, no longer than half a
    turn."""
    out = np.empty((len(before), 3))
    for n in range(len(before)):
        turn = np.ascontiguousarray(after[n, :3, :3]) @ np.ascontiguousarray(before[n, :3, :3].T)
        x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
        sine, cosine = np.sqrt(x * x + y * y + z * z), turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0  # both twice
        if cosine > 0.0 or sine > 1e-6:
            scale = np.arctan2(sine, cosine) / sine if sine > 1e-9 else 0.5
            out[n] = scale * x, scale * y, scale * z
        else:  # about half a turn: the axis stands in 1 + R, its sign where there is one in the sine
            largest = np.argmax(np.array([turn[0, 0], turn[1, 1], turn[2, 2]]))
            axis = turn[largest].copy()
            axis[largest] += 1.0
            axis *= np.arctan2(sine, cosine) / np.sqrt(np.sum(axis**2))
            out[n] = -axis if axis[0] * x + axis[1] * y + axis[2] * z < 0.0 else axis
    return out


@njit(cache=True, nogil=True, inline="always")
def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )
