"""The loops that run once per surface point: projection, depth test, photometric and contour residuals.

Every residual of a point ``x`` on a segment is linearised in the segment's own twist ``(v, w)`` about a centre ``c``
near the body, ``dx = v + w x (x - c)``, so that a row of the Jacobian is ``[a, (x - c) x a]`` with ``a`` the
gradient of the residual with respect to the point. The 6 x 6 of a segment is accumulated here and lifted to the pose by
``pzcap.body.lift``: 16 small matrices in place of thousands of rows of 43.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.types import Array

Float32 = NDArray[np.float32]

NUISANCES = 4
"""Per segment and view: a gain and a shading gradient along the three axes of the world."""


@njit(cache=True, nogil=True)
def project(
    points: Array, world_T_cam: Array, focal: float, principal: Array, k1: float, pixels: Array, depth: Array
) -> None:
    """Pixels (N, 2) and depth (N,) of world points (N, 3). Points behind the camera get a depth of -1."""
    for n in range(len(points)):
        dx = points[n, 0] - world_T_cam[0, 3]
        dy = points[n, 1] - world_T_cam[1, 3]
        dz = points[n, 2] - world_T_cam[2, 3]
        z = world_T_cam[0, 2] * dx + world_T_cam[1, 2] * dy + world_T_cam[2, 2] * dz
        if z < 0.1:
            depth[n] = -1.0
            pixels[n, 0] = 0.0
            pixels[n, 1] = 0.0
            continue
        x = (world_T_cam[0, 0] * dx + world_T_cam[1, 0] * dy + world_T_cam[2, 0] * dz) / z
        y = (world_T_cam[0, 1] * dx + world_T_cam[1, 1] * dy + world_T_cam[2, 1] * dz) / z
        scale = focal * (1.0 + k1 * (x * x + y * y))
        pixels[n, 0] = principal[0] + scale * x
        pixels[n, 1] = principal[1] + scale * y
        depth[n] = z


@njit(cache=True, nogil=True)
def pixel_gradient(point: Array, world_T_cam: Array, focal: float, k1: float, du: float, dv: float, out: Array) -> None:
    """Gradient (3,) with respect to a world point of the function whose gradient in the image is ``(du, dv)``."""
    dx = point[0] - world_T_cam[0, 3]
    dy = point[1] - world_T_cam[1, 3]
    dz = point[2] - world_T_cam[2, 3]
    z = world_T_cam[0, 2] * dx + world_T_cam[1, 2] * dy + world_T_cam[2, 2] * dz
    x = (world_T_cam[0, 0] * dx + world_T_cam[1, 0] * dy + world_T_cam[2, 0] * dz) / z
    y = (world_T_cam[0, 1] * dx + world_T_cam[1, 1] * dy + world_T_cam[2, 1] * dz) / z
    r2 = x * x + y * y
    # d(u, v)/d(x, y) of the lens, then d(x, y)/d(camera point)
    along = focal * (1.0 + k1 * r2)
    gx = du * (along + 2.0 * focal * k1 * x * x) + dv * (2.0 * focal * k1 * x * y)
    gy = dv * (along + 2.0 * focal * k1 * y * y) + du * (2.0 * focal * k1 * x * y)
    a = gx / z
    b = gy / z
    c = -(gx * x + gy * y) / z
    for k in range(3):
        out[k] = world_T_cam[k, 0] * a + world_T_cam[k, 1] * b + world_T_cam[k, 2] * c


@njit(cache=True, nogil=True)
def rasterise(
    pixels: Array, depth: Array, faces: NDArray[np.int64], left: int, top: int, scale: float, z_buffer: Float32
) -> None:
    """Nearest depth at every pixel of a window; infinity where there is no body.

    Pixel ``(i, j)`` of the window stands at ``(left, top) + (j, i) * scale`` of the image. Depth is interpolated
    linearly over a triangle, which for triangles of centimetres seen from metres is exact to a millimetre.
    """
    height, width = z_buffer.shape
    z_buffer[:] = np.inf
    for f in range(len(faces)):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        if depth[i0] < 0 or depth[i1] < 0 or depth[i2] < 0:
            continue
        x0 = (pixels[i0, 0] - left) / scale
        y0 = (pixels[i0, 1] - top) / scale
        x1 = (pixels[i1, 0] - left) / scale
        y1 = (pixels[i1, 1] - top) / scale
        x2 = (pixels[i2, 0] - left) / scale
        y2 = (pixels[i2, 1] - top) / scale
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area >= -1e-9:  # image y points down: a face seen from outside runs clockwise in these coordinates
            continue
        column0 = max(int(np.ceil(min(x0, x1, x2))), 0)
        column1 = min(int(np.floor(max(x0, x1, x2))), width - 1)
        row0 = max(int(np.ceil(min(y0, y1, y2))), 0)
        row1 = min(int(np.floor(max(y0, y1, y2))), height - 1)
        for row in range(row0, row1 + 1):
            for column in range(column0, column1 + 1):
                w1 = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
                w2 = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
                if w1 < -1e-9 or w2 < -1e-9 or w1 + w2 > 1.0 + 1e-9:
                    continue
                z = depth[i0] + w1 * (depth[i1] - depth[i0]) + w2 * (depth[i2] - depth[i0])
                if z < z_buffer[row, column]:
                    z_buffer[row, column] = z


@njit(cache=True, nogil=True)
def visible(
    points: Array,
    normals: Array,
    pixels: Array,
    depth: Array,
    centre: Array,
    z_buffer: Float32,
    left: int,
    top: int,
    scale: float,
    tolerance: float,
    facing: Float32,
) -> None:
    """Cosine between normal and ray of every point that the camera at ``centre`` sees, 0 for the hidden ones."""
    height, width = z_buffer.shape
    for n in range(len(points)):
        facing[n] = 0.0
        if depth[n] < 0:
            continue
        column = int(np.rint((pixels[n, 0] - left) / scale))
        row = int(np.rint((pixels[n, 1] - top) / scale))
        if column < 0 or row < 0 or column >= width or row >= height:
            continue
        if depth[n] > z_buffer[row, column] + tolerance:
            continue
        dx = centre[0] - points[n, 0]
        dy = centre[1] - points[n, 1]
        dz = centre[2] - points[n, 2]
        cosine = (dx * normals[n, 0] + dy * normals[n, 1] + dz * normals[n, 2]) / np.sqrt(dx * dx + dy * dy + dz * dz)
        if cosine > 0.0:
            facing[n] = cosine


@njit(cache=True, nogil=True, inline="always")
def _bilinear(image: Float32, x: float, y: float) -> float:
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    upper = image[row, column] * (1.0 - fx) + image[row, column + 1] * fx
    lower = image[row + 1, column] * (1.0 - fx) + image[row + 1, column + 1] * fx
    return upper * (1.0 - fy) + lower * fy


@njit(cache=True, nogil=True)
def sample(image: Float32, left: float, top: float, scale: float, pixels: Array, out: Float32) -> None:
    """Image values (N,) at full-resolution pixels (N, 2); negative where outside the window."""
    height, width = image.shape
    for n in range(len(pixels)):
        x = (pixels[n, 0] - left) / scale
        y = (pixels[n, 1] - top) / scale
        if x < 1.0 or y < 1.0 or x >= width - 2.0 or y >= height - 2.0:
            out[n] = -1.0
        else:
            out[n] = _bilinear(image, x, y)


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
        value = _bilinear(image, x, y)
        du = 0.5 * (_bilinear(image, x + 1.0, y) - _bilinear(image, x - 1.0, y)) / scale
        dv = 0.5 * (_bilinear(image, x, y + 1.0) - _bilinear(image, x, y - 1.0)) / scale
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
    centre: Array,
    z_buffer: Float32,
    z_left: int,
    z_top: int,
    z_scale: float,
    probability: Float32,
    left: float,
    top: float,
    reach: float,
    sigma: float,
    segment_weight: Array,
    hessians: Array,
    gradients: Array,
    cost: Array,
) -> None:
    """Occluding contour of the body against the silhouette, accumulated into each segment's 6 x 6.

    Where the normal turns away from the camera between the two ends of a mesh edge lies a contour point. It counts
    if nothing hides it and no other part of the body lies just outside. Along its normal in the image, within
    ``reach`` pixels, the silhouette's edge is sought: the crossing of 1/2 that falls towards the outside (which is the
    check of the contour's normal) and lies nearest. The residual is the signed distance to it. ``cost`` (16, 3) gains
    squared distances, points with an edge found and points sought.
    """
    height, width = z_buffer.shape
    p_height, p_width = probability.shape
    x = np.zeros((1, 3))
    uv = np.zeros((1, 2))
    z1 = np.zeros(1)
    a = np.zeros(3)
    row = np.zeros(6)
    n3 = np.zeros(3)
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
            min(px - reach * abs(nu), py - reach * abs(nv)) < 1.0
            or px + reach * abs(nu) >= p_width - 2.0
            or py + reach * abs(nv) >= p_height - 2.0
        ):
            continue
        cost[s, 2] += segment_weight[s]
        best = np.inf
        slope = 0.0
        steps = int(np.ceil(reach))
        previous = _bilinear(probability, px - steps * nu, py - steps * nv)
        for k in range(-steps + 1, steps + 1):
            current = _bilinear(probability, px + k * nu, py + k * nv)
            if previous >= 0.5 and current < 0.5:
                crossing = k - 1 + (previous - 0.5) / (previous - current)
                if abs(crossing) < abs(best):
                    best = crossing
                    slope = previous - current
            previous = current
        if abs(best) > reach:
            continue
        # a soft or tilted edge (its gradient not along our normal) says little about where we are
        ex, ey = px + best * nu, py + best * nv
        gx = 0.5 * (_bilinear(probability, ex + 1.0, ey) - _bilinear(probability, ex - 1.0, ey))
        gy = 0.5 * (_bilinear(probability, ex, ey + 1.0) - _bilinear(probability, ex, ey - 1.0))
        g = np.sqrt(gx * gx + gy * gy)
        if g < 0.05:
            continue
        aligned = -(gx * nu + gy * nv) / g
        if aligned < 0.5:
            continue
        robust = 1.0 / (1.0 + (best / (2.5 * sigma)) ** 2)
        weight = robust * robust * aligned * min(1.0, 3.0 * slope) * segment_weight[s] / (sigma * sigma)
        pixel_gradient(x[0], world_T_cam, focal, k1, nu, nv, a)
        rx, ry, rz = x[0, 0] - centre[0], x[0, 1] - centre[1], x[0, 2] - centre[2]
        row[0], row[1], row[2] = a[0], a[1], a[2]
        row[3] = ry * a[2] - rz * a[1]
        row[4] = rz * a[0] - rx * a[2]
        row[5] = rx * a[1] - ry * a[0]
        for k in range(6):
            for m in range(6):
                hessians[s, k, m] += weight * row[k] * row[m]
            gradients[s, k] += weight * row[k] * best
        cost[s, 0] += segment_weight[s] * best * best
        cost[s, 1] += segment_weight[s]
