"""Residuals of the skin's points in a view, brightness and contour, accumulated per segment.

Every residual of a point ``x`` on a segment is linearised in the segment's own twist ``(v, w)`` about a centre ``c``
near the body, ``dx = v + w x (x - c)``, so that a row of the Jacobian is ``[a, (x - c) x a]`` with ``a`` the
gradient of the residual with respect to the point. The 6 x 6 of a segment is accumulated here and lifted to the pose by
``pzcap.body.lift``: 16 small matrices in place of thousands of rows of 43.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.raster import bilinear, pixel_gradient, project
from pzcap.types import Array

Float32 = NDArray[np.float32]

NUISANCES: Final = 4
"""Per segment and view: a gain and a shading gradient along the three axes of the world."""


@njit(cache=True, nogil=True)
def photometric(
    points: Array,
    normals: Array,
    segment: NDArray[np.int64],
    facing: Float32,
    pixels: Array,
    world_T_cam: Array,
    focal: float,
    k1: float,
    centre: Array,
    image: Float32,
    left: float,
    top: float,
    scale: float,
    template: Float32,
    trust: Float32,
    sigma: float,
    nuisance_weight: Array,
    segment_weight: Array,
    hessians: Array,
    gradients: Array,
    cost: Array,
) -> None:
    """Brightness of each visible point against its template, accumulated into each segment's 6 x 6.

    The residual is ``I(project(x)) - T * (1 + g + s . n)``. Light is fixed in the world, so a limb that turns changes
    its shading; the gain ``g`` and the shading gradient ``s`` of each segment in this view are eliminated (Schur
    complement) with the prior ``nuisance_weight`` (4,), so that no motion is inferred from what shading could explain.
    Residuals are weighted by Geman-McClure of scale ``sigma``. ``cost`` (16, 2) gains weighted squares and weights.
    """
    size = 6 + NUISANCES
    joint = np.zeros((16, size, size))
    right = np.zeros((16, size))
    row = np.zeros(size)
    a = np.zeros(3)
    height, width = image.shape
    for n in range(len(points)):
        s = segment[n]
        if facing[n] < 0.15 or trust[n] <= 0.0 or segment_weight[s] <= 0.0:
            continue
        x = (pixels[n, 0] - left) / scale
        y = (pixels[n, 1] - top) / scale
        if x < 2.0 or y < 2.0 or x >= width - 3.0 or y >= height - 3.0:
            continue
        value = bilinear(image, x, y)
        du = 0.5 * (bilinear(image, x + 1.0, y) - bilinear(image, x - 1.0, y)) / scale
        dv = 0.5 * (bilinear(image, x, y + 1.0) - bilinear(image, x, y - 1.0)) / scale
        residual = value - template[n]
        robust = 1.0 / (1.0 + (residual / sigma) ** 2)
        weight = robust * robust * trust[n] * min(1.0, 2.0 * facing[n]) * segment_weight[s] / (sigma * sigma)
        pixel_gradient(points[n], world_T_cam, focal, k1, du, dv, a)
        rx, ry, rz = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
        row[0], row[1], row[2] = a[0], a[1], a[2]
        row[3] = ry * a[2] - rz * a[1]
        row[4] = rz * a[0] - rx * a[2]
        row[5] = rx * a[1] - ry * a[0]
        row[6] = -template[n]
        row[7] = -template[n] * normals[n, 0]
        row[8] = -template[n] * normals[n, 1]
        row[9] = -template[n] * normals[n, 2]
        for i in range(size):
            wi = weight * row[i]
            right[s, i] -= wi * residual
            for j in range(i + 1):
                joint[s, i, j] += wi * row[j]
        cost[s, 0] += weight * residual * residual
        cost[s, 1] += weight * sigma * sigma
    for s in range(16):
        if joint[s, 6, 6] <= 0.0:
            continue
        for i in range(size):
            for j in range(i):
                joint[s, j, i] = joint[s, i, j]
        for k in range(NUISANCES):
            joint[s, 6 + k, 6 + k] += nuisance_weight[k]
        cross = np.ascontiguousarray(joint[s, :6, 6:])
        solved = np.linalg.solve(np.ascontiguousarray(joint[s, 6:, 6:]), np.ascontiguousarray(cross.T))
        hessians[s] += joint[s, :6, :6] - cross @ solved
        gradients[s] += right[s, :6] - right[s, 6:] @ solved


@njit(cache=True, nogil=True)
def contour(
    points: Array,
    normals: Array,
    segment: NDArray[np.int64],
    edges: NDArray[np.int64],
    depth: Array,
    world_T_cam: Array,
    focal: float,
    principal: Array,
    k1: float,
    z_buffer: Float32,
    cover: NDArray[np.uint8],
    group: NDArray[np.uint8],
    z_left: int,
    z_top: int,
    z_scale: float,
    probability: Float32,
    left: float,
    top: float,
    reach: float,
    sigma: float,
    segment_weight: Array,
    rows: Array,
    row_segment: NDArray[np.int64],
    cost: Array,
) -> int:
    """Occluding contour of the body against the silhouette: writes ``rows`` and returns how many.

    Where the normal turns away from the camera between the two ends of a mesh edge lies a contour point. It counts
    if nothing hides it and no other part of the body lies just outside. Along its normal in the image, within
    ``reach`` pixels, the silhouette's edge is sought: the crossing of 1/2 that falls towards the outside (which is the
    check of the contour's normal) and lies nearest, unless another part of the body (``cover`` holds the bits ``group``
    (16,) of the segments there) has its own edge there. The residual is the signed distance to it. A row (8,) holds its
    weight, the residual, the gradient of the distance with respect to the point, and the point. ``cost`` (16, 3) gains
    squared distances, points with an edge found and points sought.
    """
    height, width = z_buffer.shape
    p_height, p_width = probability.shape
    x = np.zeros((1, 3))
    uv = np.zeros((1, 2))
    z1 = np.zeros(1)
    a = np.zeros(3)
    count = 0
    n3 = np.zeros(3)
    stride = 2 if reach > 12.0 else 1  # pixels: a coarse search needs no fine steps
    far = reach + stride
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        if depth[i] < 0 or depth[j] < 0:
            continue
        s = segment[i]
        if segment_weight[s] <= 0.0:
            continue
        fi = 0.0
        fj = 0.0
        for k in range(3):
            fi += normals[i, k] * (world_T_cam[k, 3] - points[i, k])
            fj += normals[j, k] * (world_T_cam[k, 3] - points[j, k])
        if (fi > 0.0) == (fj > 0.0):
            continue
        t = fi / (fi - fj)
        for k in range(3):
            x[0, k] = points[i, k] + t * (points[j, k] - points[i, k])
            n3[k] = normals[i, k] + t * (normals[j, k] - normals[i, k])
        project(x, world_T_cam, focal, principal, k1, uv, z1)
        u, v, z = uv[0, 0], uv[0, 1], z1[0]
        nu = world_T_cam[0, 0] * n3[0] + world_T_cam[1, 0] * n3[1] + world_T_cam[2, 0] * n3[2]
        nv = world_T_cam[0, 1] * n3[0] + world_T_cam[1, 1] * n3[1] + world_T_cam[2, 1] * n3[2]
        length = np.sqrt(nu * nu + nv * nv)
        if length < 1e-6:
            continue
        nu /= length
        nv /= length
        # hidden, or in front of another part of the body?
        column = int(np.rint((u - 1.5 * nu - z_left) / z_scale))
        line = int(np.rint((v - 1.5 * nv - z_top) / z_scale))
        if column < 0 or line < 0 or column >= width or line >= height or z > z_buffer[line, column] + 0.06:
            continue
        open_outside = True
        for step in (2.0, 4.0):
            column = int(np.rint((u + step * nu - z_left) / z_scale))
            line = int(np.rint((v + step * nv - z_top) / z_scale))
            if column < 0 or line < 0 or column >= width or line >= height or z_buffer[line, column] < np.inf:
                open_outside = False
        if not open_outside:
            continue
        px, py = u - left, v - top
        if (
            min(px - far * abs(nu), py - far * abs(nv)) < 1.0
            or px + far * abs(nu) >= p_width - 2.0
            or py + far * abs(nv) >= p_height - 2.0
        ):
            continue
        cost[s, 2] += segment_weight[s]
        best = np.inf
        slope = 0.0
        steps = stride * int(np.ceil(reach / stride))
        previous = bilinear(probability, px - steps * nu, py - steps * nv)
        for k in range(-steps + stride, steps + 1, stride):
            current = bilinear(probability, px + k * nu, py + k * nv)
            if previous >= 0.5 and current < 0.5:
                crossing = k - stride + stride * (previous - 0.5) / (previous - current)
                if abs(crossing) < abs(best):
                    best = crossing
                    slope = previous - current
            previous = current
        if abs(best) > reach:
            continue
        # the edge of another part of the body, which that part explains: no limb is drawn to it
        column = int(np.rint((u + (best - 2.0) * nu - z_left) / z_scale))
        line = int(np.rint((v + (best - 2.0) * nv - z_top) / z_scale))
        if 0 <= column < width and 0 <= line < height:
            there = cover[line, column]
            if there != 0 and there & group[s] == 0:
                continue
        # a soft or tilted edge (its gradient not along our normal) says little about where we are
        ex, ey = px + best * nu, py + best * nv
        gx = 0.5 * (bilinear(probability, ex + 1.0, ey) - bilinear(probability, ex - 1.0, ey))
        gy = 0.5 * (bilinear(probability, ex, ey + 1.0) - bilinear(probability, ex, ey - 1.0))
        g = np.sqrt(gx * gx + gy * gy)
        if g < 0.05:
            continue
        aligned = -(gx * nu + gy * nv) / g
        if aligned < 0.5:
            continue
        robust = 1.0 / (1.0 + (best / (2.5 * sigma)) ** 2)
        weight = robust * robust * aligned * min(1.0, 3.0 * slope) * segment_weight[s] / (sigma * sigma)
        pixel_gradient(x[0], world_T_cam, focal, k1, nu, nv, a)
        row_segment[count] = s
        rows[count, 0], rows[count, 1] = weight, best
        for k in range(3):
            rows[count, 2 + k] = a[k]
            rows[count, 5 + k] = x[0, k]
        count += 1
        cost[s, 0] += segment_weight[s] * best * best
        cost[s, 1] += segment_weight[s]
    return count


@njit(cache=True, nogil=True)
def accumulate(
    rows: Array, row_segment: NDArray[np.int64], count: int, centre: Array, hessians: Array, gradients: Array
) -> None:
    """Add the first ``count`` rows of `contour` to each segment's 6 x 6."""
    wrench = np.empty(6)
    for n in range(count):
        s = row_segment[n]
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
