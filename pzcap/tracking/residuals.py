"""Residuals of the skin in a view, brightness and contour, linearised in the segments' twists
(`pzcap.body.segment_equations`)."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit

from pzcap.body.segment_equations import PointResiduals, SegmentSums
from pzcap.geometry.pinhole import Pinhole, Vector, pixel_gradient, ray, to_pixel
from pzcap.imaging.interpolation import bilinear, bilinear_with_gradient
from pzcap.solver.robust import geman_mcclure
from pzcap.tracking.skin_colour_model import LOWER_ARM
from pzcap.tracking.tuning import BRIGHTNESS, CONTOUR
from pzcap.tracking.visibility import ARMS, GROUP, ProjectedSkin, SkinPoints, ZBuffer
from pzcap.types import SEGMENTS, Array, Float32, Image, Indices, without_side

NUISANCES: Final = 4  # per segment and view: a gain and a shading gradient along the three axes of the world
RESIDUAL: Final = 6
"""Place of the residual in a row, after its Jacobian by the segment's twist and before that by the nuisances."""
WIDTH: Final = 7 + NUISANCES
WHOLE_BODY: Final = 255  # bits of all parts of a body
_WIDTH_M: Final = {"pelvis": 0.3, "lumbar": 0.27, "thorax": 0.3, "head": 0.16, "upper_arm": 0.09, "forearm": 0.07,
                   "hand": 0.05, "thigh": 0.15, "shank": 0.1, "foot": 0.08}  # fmt: skip
SEGMENT_WIDTH_M: Final = np.array([_WIDTH_M[without_side(n)] for n in SEGMENTS])
BEFORE_BODY_M: Final = np.where(LOWER_ARM, SEGMENT_WIDTH_M, 0.0)
"""(16,) Distance within which an edge is sought of what may lie before the body: further off it is the other side's."""


class CropImage(NamedTuple):
    """Part of a view, at a pyramid level. Pixel ``(i, j)`` stands at ``(left, top) + scale * (j, i)`` of the view."""

    image: Image
    left: float
    top: float
    scale: float


class Template(NamedTuple):
    """Expected brightness of each point of the skin at a pyramid level."""

    value: Float32  # (V,) grey levels
    trust: Float32  # (V,) 0 unseen .. 1.


class Outlines(NamedTuple):
    """Pictures that a view's edges are sought in, and of people where none are."""

    silhouette: CropImage  # probability that it is the athlete
    arms: Image  # (h, w) likewise, that it is a lower arm
    people: Image  # (h / 2, w / 2) where somebody else is; or empty


class BrightnessTerms(NamedTuple):
    """Weights of the residuals of brightness."""

    sigma: float  # grey levels; scale of the Geman-McClure weight
    nuisance_weight: float  # prior of each of the light's nuisances
    segment_weight: Array  # (16,)


class ContourTerms(NamedTuple):
    """Search range and weights of the residuals of the contour."""

    reach: float  # pixels to either side
    sigma: float  # pixels
    weight: float


@njit(cache=True, nogil=True, error_model="numpy")
def photometric(
    skin: SkinPoints, pixels: Array, facing: Float32, camera: Pinhole, crop: CropImage, template: Template,
    terms: BrightnessTerms, sums: SegmentSums, cost: Array,
) -> None:  # fmt: skip
    """Brightness of each visible point against its template, accumulated into each segment's 6 x 6.

    The residual is ``I(project(x)) - T * (1 + g + s . n)``. Light is fixed in the world, so a limb that turns changes
    its shading; the gain ``g`` and the shading gradient ``s`` of each segment in this view are eliminated (Schur
    complement) with a prior, so that no motion is inferred from what shading could explain. ``pixels`` (V, 2) and
    ``facing`` (V,) are of the pose that visibility was tested in, or near it. ``cost`` (16, 2) gains weighted squares
    and weights.
    """
    image, left, top, scale = crop
    height, width = image.shape
    points, normals, sigma = skin.points, skin.normals, terms.sigma
    hessians, gradients, centre = sums
    rows, weights, joint = np.empty((WIDTH, len(points))), np.empty(len(points)), np.empty((WIDTH, WIDTH))
    count, before = 0, -1
    for n in range(len(points)):
        s = skin.segment[n]
        if s != before:  # points come segment by segment
            if count > 0:
                _gather(rows, weights, count, terms.nuisance_weight, joint, hessians[before], gradients[before])
            count, before = 0, s
        if facing[n] < BRIGHTNESS.least_facing or template.trust[n] <= 0.0 or terms.segment_weight[s] <= 0.0:
            continue
        x = (pixels[n, 0] - left) / scale
        y = (pixels[n, 1] - top) / scale
        if x < 2.0 or y < 2.0 or x >= width - 3.0 or y >= height - 3.0:
            continue
        value, du, dv = bilinear_with_gradient(image, x, y)
        residual = value - template.value[n]
        weight = geman_mcclure(residual, sigma) * template.trust[n] * min(1.0, 2.0 * facing[n])
        weight = weight * terms.segment_weight[s] / (sigma * sigma)
        across, down, depth = ray(points[n, 0], points[n, 1], points[n, 2], camera)
        a0, a1, a2 = pixel_gradient(across, down, depth, camera, du / scale, dv / scale)
        rx, ry, rz = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
        weights[count] = weight
        rows[0, count], rows[1, count], rows[2, count] = a0, a1, a2
        rows[3, count], rows[4, count], rows[5, count] = ry * a2 - rz * a1, rz * a0 - rx * a2, rx * a1 - ry * a0
        rows[RESIDUAL, count], rows[7, count] = -residual, -template.value[n]
        for k in range(3):
            rows[8 + k, count] = -template.value[n] * normals[n, k]
        count += 1
        cost[s, 0] += weight * residual * residual
        cost[s, 1] += weight * sigma * sigma
    if count > 0:
        _gather(rows, weights, count, terms.nuisance_weight, joint, hessians[before], gradients[before])


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(
    rows: Array, weights: Array, count: int, nuisance_weight: float, joint: Array, hessian: Array, gradient: Array
) -> None:
    """Add the normal equations of the first ``count`` columns of ``rows`` to a segment's, its nuisances eliminated."""
    _products(rows, weights, count, joint)
    for k in range(NUISANCES):
        joint[7 + k, 7 + k] += nuisance_weight
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
    skin: SkinPoints, edges: Indices, seen: ProjectedSkin, camera: Pinhole, z_buffer: ZBuffer,
    outlines: Outlines, terms: ContourTerms, found: PointResiduals, cost: Array,
) -> int:  # fmt: skip
    """Occluding contour of the body against silhouette and arms: fills in ``found`` and returns how many there are.

    Where the normal turns away from the camera between the two ends of a mesh edge lies a contour point. It counts if
    nothing hides it. Along its normal in the image, within reach, the edge of the ``silhouette`` is sought: the
    crossing of 1/2 that falls towards the outside (which is the check of the contour's normal) and lies nearest, unless
    another part of the body has its own edge there. If another part lies just outside, the point counts only if it is
    before that and of a segment that is known from the rest by its colours: then the edge of the ``arms`` is sought,
    unless the other arm is there.

    Where somebody else (``people``) is or begins, no edge is sought.

    The residual is the signed distance to the edge, weighted by Geman-McClure. ``cost`` (16, 3) gains, of the
    silhouettes' edges alone, squared distances, points with an edge found and points sought.
    """
    silhouette, arms, people = outlines
    shape = silhouette.image.shape
    scale, count = z_buffer.scale, 0
    stride = 2 if terms.reach > 12.0 else 1  # pixels: a coarse search needs no fine steps
    far = terms.reach + stride
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        ends = seen.above[i], seen.above[j]
        if (ends[0] > 0.0) == (ends[1] > 0.0) or seen.depth[i] < 0.0 or seen.depth[j] < 0.0:
            continue
        s = skin.segment[i]
        t = ends[0] / (ends[0] - ends[1])
        x, y, z = _mix(skin.points, i, j, t)
        nu, nv = _image_normal(_mix(skin.normals, i, j, t), camera)
        if nu == 0.0 and nv == 0.0:
            continue
        across, down, away = ray(x, y, z, camera)
        u, v = to_pixel(across, down, camera)
        # hidden, or before another part of the body?
        zu, zv = (u - z_buffer.left) / scale, (v - z_buffer.top) / scale
        du, dv = nu / scale, nv / scale
        if away > _at(z_buffer, zu - 1.5 * du, zv - 1.5 * dv)[0] + CONTOUR.hidden_m:
            continue
        outside, others = _at(z_buffer, zu + 2.0 * du, zv + 2.0 * dv)
        beyond = min(outside, _at(z_buffer, zu + 4.0 * du, zv + 4.0 * dv)[0])
        before = beyond < np.inf
        if before and (BEFORE_BODY_M[s] <= 0.0 or beyond < away + CONTOUR.in_front_m):
            continue
        px, py = u - silhouette.left, v - silhouette.top
        if min(px - far * abs(nu), py - far * abs(nv)) < 1.0:
            continue
        if px + far * abs(nu) >= shape[1] - 2.0 or py + far * abs(nv) >= shape[0] - 2.0:
            continue
        if before:
            shown, explained, within = arms, ARMS, min(terms.reach, BEFORE_BODY_M[s] * camera.focal / away)
            if others & ARMS & ~GROUP[s]:  # the two arms look alike
                continue
        else:
            if _somebody(people, px + 3.0 * nu, py + 3.0 * nv) or _somebody(people, px, py):
                continue
            shown, explained, within = silhouette.image, WHOLE_BODY, terms.reach
            cost[s, 2] += terms.weight
        offset, slope = _crossing(shown, px, py, nu, nv, stride, int(np.ceil(within / stride)))
        if abs(offset) > within:
            continue
        if _somebody(people, px + (offset - 3.0) * nu, py + (offset - 3.0) * nv):  # that one's own outline
            continue
        # the edge of another part of the body, which that part explains: no limb is drawn to it
        there = _at(z_buffer, zu + (offset - 2.0) * du, zv + (offset - 2.0) * dv)[1] & explained
        if there != 0 and there & GROUP[s] == 0:
            continue
        # a soft or tilted edge (its gradient not along our normal) says little about where we are
        _, gx, gy = bilinear_with_gradient(shown, px + offset * nu, py + offset * nv)
        steepness = np.sqrt(gx * gx + gy * gy)
        aligned = -(gx * nu + gy * nv) / max(steepness, 1e-9)
        if steepness < CONTOUR.least_slope or aligned < 0.5:
            continue
        robust = geman_mcclure(offset, CONTOUR.robust_sigmas * terms.sigma)
        weight = robust * aligned * min(1.0, slope / CONTOUR.clear_fall) * terms.weight
        found.owner[count] = s
        found.rows[count, 0] = weight / (terms.sigma * terms.sigma)
        found.rows[count, 1] = offset
        found.rows[count, 2:5] = pixel_gradient(across, down, away, camera, nu, nv)
        found.rows[count, 5:] = x, y, z
        count += 1
        if not before:
            cost[s, 0] += terms.weight * offset * offset
            cost[s, 1] += terms.weight
    return count


@njit(cache=True, nogil=True, inline="always")
def _somebody(people: Image, x: float, y: float) -> bool:
    """True where ``people`` (h / 2, w / 2) has somebody at a pixel."""
    i, j = int(y / 2.0), int(x / 2.0)
    return 0 <= i < people.shape[0] and 0 <= j < people.shape[1] and people[i, j] > 0


@njit(cache=True, nogil=True, inline="always")
def _image_normal(normal: Vector, camera: Pinhole) -> tuple[float, float]:
    """Unit vector of a world ``normal`` as seen in the image; 0 where it points at the camera."""
    r = camera.rotation
    nu = r[0] * normal[0] + r[1] * normal[1] + r[2] * normal[2]
    nv = r[3] * normal[0] + r[4] * normal[1] + r[5] * normal[2]
    length = np.sqrt(nu * nu + nv * nv)
    return (nu / length, nv / length) if length >= 1e-6 else (0.0, 0.0)


@njit(cache=True, nogil=True, inline="always")
def _mix(values: Array, i: int, j: int, share: float) -> Vector:
    """Linear interpolation between rows ``i`` and ``j``."""
    return (
        values[i, 0] + share * (values[j, 0] - values[i, 0]),
        values[i, 1] + share * (values[j, 1] - values[i, 1]),
        values[i, 2] + share * (values[j, 2] - values[i, 2]),
    )


@njit(cache=True, nogil=True, inline="always")
def _at(z_buffer: ZBuffer, column: float, row: float) -> tuple[float, int]:
    """Depth and parts of the body at a pixel of the z-buffer; outside of it nearer than anything, and none."""
    i, j = int(np.rint(row)), int(np.rint(column))
    inside = 0 <= i < z_buffer.depth.shape[0] and 0 <= j < z_buffer.depth.shape[1]
    return (float(z_buffer.depth[i, j]), int(z_buffer.cover[i, j])) if inside else (-np.inf, 0)


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(
    probability: Image, x: float, y: float, nu: float, nv: float, stride: int, steps: int
) -> tuple[float, float]:
    """Signed distance along ``(nu, nv)`` to the nearest crossing of 1/2, and the fall of the probability in a stride
    there; infinite where there is none within so many ``steps`` to either side."""
    inner = outer = bilinear(probability, x, y)
    for step in range(1, steps + 1):
        k = stride * step
        further_in = bilinear(probability, x - k * nu, y - k * nv)
        further_out = bilinear(probability, x + k * nu, y + k * nv)
        nearest, fall = np.inf, 0.0
        if further_in >= CONTOUR.edge and inner < CONTOUR.edge:
            fall = further_in - inner
            nearest = stride * (further_in - CONTOUR.edge) / fall - k
        if outer >= CONTOUR.edge and further_out < CONTOUR.edge:
            other = k - stride + stride * (outer - CONTOUR.edge) / (outer - further_out)
            if other < abs(nearest):
                nearest, fall = other, outer - further_out
        if nearest < np.inf:
            return nearest, fall
        inner, outer = further_in, further_out
    return np.inf, 0.0
