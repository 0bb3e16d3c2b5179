"""Rigid motions of sixteen segments at once: quaternions (wxyz), the kinematic chain, the skin in the world."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.types import Array


@njit(cache=True, nogil=True)
def turn(quaternions: Array, increments: Array) -> Array:
    """``q exp(increment)`` for quaternions (N, 4) and rotation vectors (N, 3), of unit length."""
    out = np.empty_like(quaternions)
    for n in range(len(quaternions)):
        x, y, z = increments[n, 0], increments[n, 1], increments[n, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        # sin(a/2)/a without dividing by zero
        s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else np.sin(0.5 * angle) / angle
        bw, bx, by, bz = np.cos(0.5 * angle), s * x, s * y, s * z
        aw, ax, ay, az = quaternions[n, 0], quaternions[n, 1], quaternions[n, 2], quaternions[n, 3]
        w = aw * bw - ax * bx - ay * by - az * bz
        i = aw * bx + ax * bw + ay * bz - az * by
        j = aw * by - ax * bz + ay * bw + az * bx
        k = aw * bz + ax * by - ay * bx + az * bw
        length = np.sqrt(w * w + i * i + j * j + k * k)
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = w / length, i / length, j / length, k / length
    return out


@njit(cache=True, nogil=True)
def between(start: Array, to: Array) -> Array:
    """Rotation vectors (N, 3) with ``turn(start, result) == to``, no longer than half a turn."""
    out = np.empty((len(start), 3))
    for n in range(len(start)):
        aw, ax, ay, az = start[n, 0], -start[n, 1], -start[n, 2], -start[n, 3]
        bw, bx, by, bz = to[n, 0], to[n, 1], to[n, 2], to[n, 3]
        w = aw * bw - ax * bx - ay * by - az * bz
        x = aw * bx + ax * bw + ay * bz - az * by
        y = aw * by - ax * bz + ay * bw + az * bx
        z = aw * bz + ax * by - ay * bx + az * bw
        sine = np.sqrt(x * x + y * y + z * z)
        sign = 1.0 if w >= 0.0 else -1.0
        scale = 2.0 * sign if sine < 1e-9 else 2.0 * np.arctan2(sine, sign * w) / sine * sign
        out[n, 0], out[n, 1], out[n, 2] = scale * x, scale * y, scale * z
    return out


@njit(cache=True, nogil=True)
def chain(root: Array, quaternions: Array, offsets: Array, parents: NDArray[np.int64]) -> Array:
    """``world_T_segment`` (N, 4, 4) from the root (3,), rotations (N, 4) and joints in their parents (N, 3)."""
    out = np.zeros((len(quaternions), 4, 4))
    local = np.empty((3, 3))
    for n in range(len(quaternions)):
        w, x, y, z = quaternions[n, 0], quaternions[n, 1], quaternions[n, 2], quaternions[n, 3]
        s = 2.0 / (w * w + x * x + y * y + z * z)
        local[0, 0], local[0, 1], local[0, 2] = 1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)
        local[1, 0], local[1, 1], local[1, 2] = s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)
        local[2, 0], local[2, 1], local[2, 2] = s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)
        p = parents[n]
        for i in range(3):
            if p < 0:
                out[n, i, 3] = root[i]
                for j in range(3):
                    out[n, i, j] = local[i, j]
                continue
            position = out[p, i, 3]
            for k in range(3):
                position += out[p, i, k] * offsets[n, k]
            out[n, i, 3] = position
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += out[p, i, k] * local[k, j]
                out[n, i, j] = total
        out[n, 3, 3] = 1.0
    return out


@njit(cache=True, nogil=True)
def carry(
    frames: Array, segment: NDArray[np.int64], points: Array, normals: Array, out_points: Array, out_normals: Array
) -> None:
    """Points and normals (V, 3) from their segments' frames to the world. A segment's best follow each other."""
    first = 0
    while first < len(points):
        s, last = segment[first], first + 1
        while last < len(points) and segment[last] == s:
            last += 1
        for i in range(3):
            a, b, c, position = frames[s, i, 0], frames[s, i, 1], frames[s, i, 2], frames[s, i, 3]
            for v in range(first, last):
                out_points[v, i] = a * points[v, 0] + b * points[v, 1] + c * points[v, 2] + position
                out_normals[v, i] = a * normals[v, 0] + b * normals[v, 1] + c * normals[v, 2]
        first = last


@njit(cache=True, nogil=True)
def twists(frames: Array, owner: NDArray[np.int64], axes: Array, centre: Array) -> Array:
    """Joint screws (D, 6) about ``centre``: three translations along the world's axes, then rotations of segments
    ``owner`` (D,) about their own ``axes`` (D, 3)."""
    out = np.zeros((len(owner), 6))
    for d in range(len(owner)):
        if d < 3:
            out[d, d] = 1.0
            continue
        m = frames[owner[d]]
        for i in range(3):
            out[d, 3 + i] = m[i, 0] * axes[d, 0] + m[i, 1] * axes[d, 1] + m[i, 2] * axes[d, 2]
        rx, ry, rz = centre[0] - m[0, 3], centre[1] - m[1, 3], centre[2] - m[2, 3]
        out[d, 0] = out[d, 4] * rz - out[d, 5] * ry
        out[d, 1] = out[d, 5] * rx - out[d, 3] * rz
        out[d, 2] = out[d, 3] * ry - out[d, 4] * rx
    return out


@njit(cache=True, nogil=True)
def lift(
    hessians: Array, gradients: Array, twists: Array, owner: NDArray[np.int64], parents: NDArray[np.int64],
    moves: NDArray[np.bool_],
) -> tuple[Array, Array]:  # fmt: skip
    """Normal equations (D, D) and (D,) of joints with these screws (D, 6) from those of each segment, (N, 6, 6) and
    (N, 6), about the same centre.

    What a joint moves, its segment ``owner`` (D,) and all that hang on it, moves as one body: their equations add up.
    Two joints meet where one ``moves`` (D, N) the segment of the other.
    """
    hessians, gradients = hessians.copy(), gradients.copy()
    for n in range(len(parents) - 1, -1, -1):  # parents come before their children
        if parents[n] >= 0:
            hessians[parents[n]] += hessians[n]
            gradients[parents[n]] += gradients[n]
    hessian, gradient = np.zeros((len(owner), len(owner))), np.zeros(len(owner))
    carried = np.empty(6)
    for d in range(len(owner)):
        s = owner[d]
        for i in range(6):
            gradient[d] += twists[d, i] * gradients[s, i]
            carried[i] = 0.0
            for j in range(6):
                carried[i] += hessians[s, i, j] * twists[d, j]
        for e in range(d + 1):
            if moves[e, s]:
                for i in range(6):
                    hessian[d, e] += carried[i] * twists[e, i]
                hessian[e, d] = hessian[d, e]
    return hessian, gradient
