"""Residuals of the skin's points in a view, brightness and contour, accumulated per segment.

Every residual of a point ``x`` on a segment is linearised in the segment's own twist ``(v, w)`` about a centre ``c``
near the body, ``dx = v + w x (x - c)``, so that a row of the Jacobian is ``[a, (x - c) x a]`` with ``a`` the
gradient of the residual with respect to the point. The 6 x 6 of a segment is accumulated here and lifted to the pose by
``pzcap.body.skeleton.lift``: 16 small matrices in place of thousands of rows of 43.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.limbs.search import ARMS
from pzcap.tracking.visibility import bilinear, pixel_gradient, ray, sloped, stand
from pzcap.types import Array, Float32, Image

NUISANCES: Final = 4
"""Per segment and view: a gain and a shading gradient along the three axes of the world."""
RESIDUAL: Final = 6
EVEN: Final = 127.5  # of a silhouette's probability, 0..255
STEEP: Final = 255.0 / 3.0  # a fall of it, in a stride, that leaves no doubt
SOFTEST: Final = 12.75  # a slope of it, a pixel, that is an edge
WIDTH: Final = 7 + NUISANCES  # a row: its Jacobian by the segment's twist, the residual, and by the nuisances
ALL: Final = 255  # bits of the parts of a body
BEFORE_M: Final = 0.02  # by which an arm is nearer than what it lies before
FACING: Final = 0.15  # cosine: skin that is seen more obliquely tells little


@njit(cache=True, nogil=True, error_model="numpy")
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
    image: Image,
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
    height, width = image.shape
    camera = stand(world_T_cam)
    rows, weights, joint = np.empty((WIDTH, len(points))), np.empty(len(points)), np.empty((WIDTH, WIDTH))
    count, before = 0, -1
    for n in range(len(points)):
        s = segment[n]
        if s != before:  # points come segment by segment
            if count > 0:
                _gather(rows, weights, count, nuisance_weight, joint, hessians[before], gradients[before])
            count, before = 0, s
        if facing[n] < FACING or trust[n] <= 0.0 or segment_weight[s] <= 0.0:
            continue
        x = (pixels[n, 0] - left) / scale
        y = (pixels[n, 1] - top) / scale
        if x < 2.0 or y < 2.0 or x >= width - 3.0 or y >= height - 3.0:
            continue
        value, du, dv = sloped(image, x, y)
        residual = value - template[n]
        robust = 1.0 / (1.0 + (residual / sigma) ** 2)
        weight = robust * robust * trust[n] * min(1.0, 2.0 * facing[n]) * segment_weight[s] / (sigma * sigma)
        across, down, depth = ray(points[n, 0], points[n, 1], points[n, 2], camera)
        a0, a1, a2 = pixel_gradient(across, down, depth, camera, focal, k1, du / scale, dv / scale)
        rx, ry, rz = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
        weights[count] = weight
        rows[0, count], rows[1, count], rows[2, count] = a0, a1, a2
        rows[3, count], rows[4, count], rows[5, count] = ry * a2 - rz * a1, rz * a0 - rx * a2, rx * a1 - ry * a0
        rows[RESIDUAL, count], rows[7, count] = -residual, -template[n]
        for k in range(3):
            rows[8 + k, count] = -template[n] * normals[n, k]
        count += 1
        cost[s, 0] += weight * residual * residual
        cost[s, 1] += weight * sigma * sigma
    if count > 0:
        _gather(rows, weights, count, nuisance_weight, joint, hessians[before], gradients[before])


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(
    rows: Array, weights: Array, count: int, nuisance_weight: Array, joint: Array, hessian: Array, gradient: Array
) -> None:
    """Add the normal equations of the first ``count`` columns of ``rows`` to a segment's, its nuisances eliminated."""
    _products(rows, weights, count, joint)
    for k in range(NUISANCES):
        joint[7 + k, 7 + k] += nuisance_weight[k]
    for k in range(WIDTH - 1, RESIDUAL, -1):
        for i in range(k):
            factor = joint[k, i] / joint[k, k]
            for j in range(i + 1):
                joint[i, j] -= factor * joint[k, j]
    for i in range(6):
        gradient[i] += joint[RESIDUAL, i]
        for j in range(6):
            hessian[i, j] += joint[max(i, j), min(i, j)]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _products(rows: Array, weights: Array, count: int, joint: Array) -> None:
    """Lower triangle of ``rows diag(weights) rows'``, of the first ``count`` columns: a column a residual."""
    weighted = np.empty(count)
    for i in range(WIDTH):
        for n in range(count):
            weighted[n] = weights[n] * rows[i, n]
        for j in range(i + 1):
            total = 0.0
            for n in range(count):
                total += weighted[n] * rows[j, n]
            joint[i, j] = total


@njit(cache=True, nogil=True, error_model="numpy")
def contour(
    points: Array,
    normals: Array,
    segment: NDArray[np.int64],
    edges: NDArray[np.int64],
    depth: Array,
    above: Array,
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
    silhouette: Image,
    arms: Image,
    before_body: Array,
    left: float,
    top: float,
    reach: float,
    sigma: float,
    weight: float,
    rows: Array,
    row_segment: NDArray[np.int64],
    cost: Array,
) -> int:
    """Occluding contour of the body against silhouette and arms: writes ``rows`` and returns how many.

    Where the normal turns away from the camera between the two ends of a mesh edge lies a contour point (``above`` (V,)
    is as `pzcap.tracking.visibility.above` has it). It counts if nothing hides it. Along its normal in the image,
    within ``reach`` pixels, the edge of the ``silhouette`` is sought: the crossing of 1/2 that falls towards the
    outside (which is the check of the contour's normal) and lies nearest, unless another part of the body (``cover``
    holds the bits ``group`` (16,) of the segments there) has its own edge there. If another part lies just outside, the
    point counts only if it is before that and of a segment that is known from the rest by its colours: then the edge of
    the ``arms`` is sought, within ``before_body`` (16,) metres, unless the other arm is there.

    The residual is the signed distance to the edge. A row (8,) holds its weight, the residual, the gradient of the
    distance with respect to the point, and the point. ``cost`` (16, 3) gains, of the silhouettes' edges alone, squared
    distances, points with an edge found and points sought.
    """
    p_height, p_width = silhouette.shape
    camera = stand(world_T_cam)
    count = 0
    stride = 2 if reach > 12.0 else 1  # pixels: a coarse search needs no fine steps
    far = reach + stride
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        if (above[i] > 0.0) == (above[j] > 0.0) or depth[i] < 0.0 or depth[j] < 0.0:
            continue
        s = segment[i]
        t = above[i] / (above[i] - above[j])
        x, y, z = _mix(points, i, j, t)
        nx, ny, nz = _mix(normals, i, j, t)
        nu = camera[0] * nx + camera[1] * ny + camera[2] * nz
        nv = camera[3] * nx + camera[4] * ny + camera[5] * nz
        length = np.sqrt(nu * nu + nv * nv)
        if length < 1e-6:
            continue
        nu, nv = nu / length, nv / length
        across, down, away = ray(x, y, z, camera)
        along = focal * (1.0 + k1 * (across * across + down * down))
        u, v = principal[0] + along * across, principal[1] + along * down
        # hidden, or before another part of the body?
        zu, zv, du, dv = (u - z_left) / z_scale, (v - z_top) / z_scale, nu / z_scale, nv / z_scale
        if away > _depth(z_buffer, zu - 1.5 * du, zv - 1.5 * dv) + 0.06:
            continue
        beyond = min(_depth(z_buffer, zu + 2.0 * du, zv + 2.0 * dv), _depth(z_buffer, zu + 4.0 * du, zv + 4.0 * dv))
        before = beyond < np.inf
        if before and (before_body[s] <= 0.0 or beyond < away + BEFORE_M):
            continue
        px, py = u - left, v - top
        if (
            min(px - far * abs(nu), py - far * abs(nv)) < 1.0
            or px + far * abs(nu) >= p_width - 2.0
            or py + far * abs(nv) >= p_height - 2.0
        ):
            continue
        if before:
            shown, explained, within = arms, ARMS, min(reach, before_body[s] * focal / away)
            if _bits(cover, zu + 2.0 * du, zv + 2.0 * dv) & ARMS & ~group[s]:  # the two arms look alike
                continue
        else:
            shown, explained, within = silhouette, ALL, reach
            cost[s, 2] += weight
        offset, slope = _crossing(shown, px, py, nu, nv, stride, int(np.ceil(within / stride)))
        if abs(offset) > within:
            continue
        # the edge of another part of the body, which that part explains: no limb is drawn to it
        there = _bits(cover, zu + (offset - 2.0) * du, zv + (offset - 2.0) * dv) & explained
        if there != 0 and there & group[s] == 0:
            continue
        # a soft or tilted edge (its gradient not along our normal) says little about where we are
        _, gx, gy = sloped(shown, px + offset * nu, py + offset * nv)
        steepness = np.sqrt(gx * gx + gy * gy)
        aligned = -(gx * nu + gy * nv) / max(steepness, 1e-9)
        if steepness < SOFTEST or aligned < 0.5:
            continue
        robust = 1.0 / (1.0 + (offset / (2.5 * sigma)) ** 2)
        row_segment[count] = s
        rows[count, 0] = robust * robust * aligned * min(1.0, slope / STEEP) * weight / (sigma * sigma)
        rows[count, 1] = offset
        rows[count, 2:5] = pixel_gradient(across, down, away, camera, focal, k1, nu, nv)
        rows[count, 5:] = x, y, z
        count += 1
        if not before:
            cost[s, 0] += weight * offset * offset
            cost[s, 1] += weight
    return count


@njit(cache=True, nogil=True, inline="always")
def _mix(values: Array, i: int, j: int, share: float) -> tuple[float, float, float]:
    """The way from row ``i`` to row ``j``, a ``share`` of it."""
    return (
        values[i, 0] + share * (values[j, 0] - values[i, 0]),
        values[i, 1] + share * (values[j, 1] - values[i, 1]),
        values[i, 2] + share * (values[j, 2] - values[i, 2]),
    )


@njit(cache=True, nogil=True, inline="always")
def _bits(cover: NDArray[np.uint8], column: float, row: float) -> int:
    """Which parts of the body lie there."""
    i, j = int(np.rint(row)), int(np.rint(column))
    return int(cover[i, j]) if 0 <= i < cover.shape[0] and 0 <= j < cover.shape[1] else 0


@njit(cache=True, nogil=True, inline="always")
def _depth(z_buffer: Float32, column: float, row: float) -> float:
    """Depth of the body there; nearer than anything outside of what is known."""
    i, j = int(np.rint(row)), int(np.rint(column))
    return z_buffer[i, j] if 0 <= i < z_buffer.shape[0] and 0 <= j < z_buffer.shape[1] else -np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(
    probability: Image, x: float, y: float, nu: float, nv: float, stride: int, steps: int
) -> tuple[float, float]:
    """How far along ``(nu, nv)`` the nearest place lies where the silhouette ends, and how much it falls in a stride
    there; infinitely far where there is none within so many ``steps`` to either side."""
    inner = outer = bilinear(probability, x, y)
    for step in range(1, steps + 1):
        k = stride * step
        further_in = bilinear(probability, x - k * nu, y - k * nv)
        further_out = bilinear(probability, x + k * nu, y + k * nv)
        found, fall = np.inf, 0.0
        if further_in >= EVEN and inner < EVEN:
            fall = further_in - inner
            found = stride * (further_in - EVEN) / fall - k
        if outer >= EVEN and further_out < EVEN:
            other = k - stride + stride * (outer - EVEN) / (outer - further_out)
            if other < abs(found):
                found, fall = other, outer - further_out
        if found < np.inf:
            return found, fall
        inner, outer = further_in, further_out
    return np.inf, 0.0


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
