"""Limbs: the postures that one may take, and how far the silhouettes bear them out.

A limb that has come to lie over the trunk in all views has no contour, and Gauss-Newton no slope to follow. So limbs
are also judged by area, as three cones. A pixel that shows the athlete and that no other part of the body covers is
worth what its colour says for it, one of the hall costs as much; so is, to an arm, one that another part covers but
that has a lower arm's colour. A limb's support is what it covers, in square metres at its own distance summed over the
views.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pzcap.body import kinematics
from pzcap.body.joint_limits import LIMIT_HIGH, LIMIT_LOW
from pzcap.body.kinematics import difference, forward, joint_angles, retract
from pzcap.body.skeleton import DOF_AXES, DOF_SEGMENT, LIMBS, Body
from pzcap.geometry.pinhole import Pinhole, pinhole, ray, to_pixel
from pzcap.tracking.observation import Placed, Views
from pzcap.tracking.pixel_time import exposed_frames
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.tuning import APPEARANCE, VIEW
from pzcap.tracking.visibility import ARMS, GROUP, HEAD
from pzcap.types import DOF, PARENTS, Array, Float32, Pose

_TURNED: Final = tuple(np.flatnonzero(np.isin(DOF_SEGMENT, limb[:2])) for limb in LIMBS)
"""Degrees of freedom (4,) that turn a limb: its ball joint about its own three axes, then its hinge."""


def _postures() -> Array:
    swings = [(0.0, 0.0)]
    for size, count in ((0.5, 6), (1.0, 9)):
        angles = 2 * np.pi * np.arange(count) / count
        swings += list(zip(size * np.cos(angles), size * np.sin(angles), strict=True))
    return np.array([(x, y, z, h) for x, y in swings for z in (-0.8, 0.0, 0.8) for h in (-0.8, 0.0, 0.8)])


POSTURES: Final[Array] = _postures()
"""(K, 4) Turns of a limb to try when it may be anywhere in its reach, radians: as `turned` takes them."""


_EDGE: Final = np.ones((3, 3), np.uint8)  # pixels of a ground about the body's edge that say nothing: they show both


class LimbMotion(NamedTuple):
    """A limb in one frame, and how fast it moves there."""

    pose: Pose  # of the whole body, of which the limb alone counts
    rates: Array  # (16, 12) of the segments, as in `pixel_time.rates_between`


def turned(limb: int, pose: Pose, turn: Array) -> Pose:
    """The pose with one limb turned by (4,): its ball joint about its own three axes, then its hinge."""
    delta = np.zeros(DOF)
    delta[_TURNED[limb]] = turn
    return retract(pose, delta)


def turn_to(limb: int, start: Pose, end: Pose) -> Array:
    """The turn (4,) that takes a limb from one pose to another."""
    return difference(end, start)[_TURNED[limb]]


def bounded(limb: int, pose: Pose, turns: Array) -> Array:
    """The ``turns`` (K, 4) of a limb as far as its hinge can make them."""
    bent = joint_angles(pose)[_TURNED[limb][3]]
    return np.column_stack([turns[:, :3], np.clip(bent + turns[:, 3], *APPEARANCE.hinge_range_rad) - bent])


def beyond_limits(limb: int, pose: Pose, turns: Array) -> Array:
    """(K,) Squared radians by which a limb's ball joint, turned by ``turns`` (K, 4), is beyond its limits."""
    rows, start = _TURNED[limb][:3], pose.rotations[LIMBS[limb][0]]
    turned = Rotation.from_quat(kinematics.turn(np.tile(start, (len(turns), 1)), turns[:, :3]), scalar_first=True)
    angles = turned.as_rotvec()
    return np.asarray(np.sum((angles - np.clip(angles, LIMIT_LOW[rows], LIMIT_HIGH[rows])) ** 2, axis=1))


def posed(body: Body, limb: int, pose: Pose, turns: Array) -> Array:
    """(K, 3, 4, 4) the segments of a limb in the world, turned as each of ``turns`` (K, 4) has it."""
    segments, count = list(LIMBS[limb]), len(turns)
    increments = np.zeros((count, 3, 3))
    increments[:, 0], increments[:, 1] = turns[:, :3], turns[:, 3:] * DOF_AXES[_TURNED[limb][3]]
    rotations = kinematics.turn(np.tile(pose.rotations[segments], (count, 1)), increments.reshape(-1, 3))
    offsets, parents = body.offsets_m[segments], np.arange(-1, 3 * count - 1)
    parents[::3] = -1
    in_parent = kinematics.chain(offsets[0], rotations, np.tile(offsets, (count, 1)), parents).reshape(count, 3, 4, 4)
    return np.asarray(forward(body, pose)[PARENTS[segments[0]]] @ in_parent)


# --------------------------------------------------------------------------------------------------------------
# Support by the silhouettes


@dataclass(frozen=True, slots=True, eq=False)
class _Cones:
    """The limbs as three cones each, one a link."""

    tips_m: Array  # (4, 3, 3) the far end of each in its segment; the near end is the joint
    radii_m: Array  # (4, 3, 2) at the near and the far end
    reach_m: Array  # (4,) length of each limb


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Evidence of the colours of one view, and what of it the body covers. Pixel ``(i, j)`` of a map stands at
    ``corner + VIEW.belief_scale * (j, i)`` of the view."""

    number: int  # of the view
    camera: Pinhole
    corner: Array  # (2,)
    belief: Float32  # (h, w) -1 hall .. 1 body
    cover: NDArray[np.uint8]  # (h, w) bits of `pzcap.tracking.visibility.GROUP`
    bare: Float32  # (h, w) belief in a lower arm, 0 .. 1, by its colours


class Patch(NamedTuple):
    """The surroundings of a limb in one view."""

    number: int  # of the view
    camera: Pinhole
    free: Float32  # (h, w) the belief; where another part of the body covers, that in an arm before it
    corner: Array  # (2,)


def support(objective: PoseObjective, pose: Pose, placed: Placed) -> Array:
    """Per limb (4, 2), square metres of silhouette that it alone explains, and of the hall that it lies on, the body
    being where it was ``placed``."""
    body, maps = objective.body, grounds(objective.views, placed)
    frames = forward(body, pose)
    return np.array([
        judged(
            body, limb, in_views(objective, limb, frames[None, list(segments)]), patches(body, limb, frames, maps)
        )[0]
        for limb, segments in enumerate(LIMBS)
    ])  # fmt: skip


def in_views(objective: PoseObjective, limb: int, posed: Array, rates: Array | None = None) -> list[Array]:
    """A limb ``posed`` (K, 3, 4, 4) where it was when each view was exposed, moving at ``rates`` (K, 16, 12); None: as
    the ``objective`` has them."""
    known = objective.rates if rates is None else rates
    own = None if known is None else known[..., list(LIMBS[limb]), :]
    return [
        posed if view is None else exposed_frames(posed, own, view.camera, view.exposure) for view in objective.views
    ]


def grounds(views: Views, placed: Placed) -> list[Ground]:
    """The maps that limbs are judged by in each view, the body being where it was ``placed``."""
    found, scale, nearest = [], VIEW.belief_scale, cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    for number, (view, where) in enumerate(zip(views, placed, strict=True)):
        if view is None or where is None:
            continue
        buffer, size = where.z_buffer, view.belief.shape[::-1]
        corner = np.array([view.left, view.top]) + 0.5 * (scale - 1)
        origin = (corner - [buffer.left, buffer.top]) / buffer.scale
        shift = np.column_stack([scale / buffer.scale * np.eye(2), origin])
        cover = np.asarray(cv2.warpAffine(buffer.cover, shift, size, flags=nearest), np.uint8)
        likely = cv2.resize(view.arms, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        bare = np.maximum(likely / np.float32(127.5) - np.float32(1.0), np.float32(0.0))
        found.append(Ground(number, pinhole(view.camera), corner, view.belief, cover, bare))
    return found


def mismatch(views: Views, placed: Placed) -> float:
    """Area in which body and silhouettes differ, all views together, a share of the body's: the geometric mean of what
    shows the athlete beside the body, and of the hall that it covers. Somebody else who is not told from the athlete
    makes the one large, odd light the other; a body that is lost, both."""
    beside, on_hall, size = 0.0, 0.0, 0
    for ground in grounds(views, placed):
        covered = ground.cover > 0
        clear = cv2.dilate(covered.astype(np.uint8), _EDGE) == 0
        beside += float(np.maximum(ground.belief, 0.0)[clear].sum())
        on_hall -= float(np.minimum(ground.belief, 0.0)[covered].sum())
        size += int(covered.sum())
    return math.sqrt(beside * on_hall) / size if size else 0.0


def patches(body: Body, limb: int, frames: Array, grounds: Sequence[Ground]) -> list[Patch]:
    """The surroundings of a limb in each view that shows them, the body being at ``frames`` (16, 4, 4)."""
    root, own = LIMBS[limb][0], GROUP[LIMBS[limb][0]]
    found = []
    for ground in grounds:
        box = _box(ground, frames[root, :3, 3], _cones(body).reach_m[limb])
        if box is None:
            continue
        others = ground.cover[box] & ~own
        bare = ground.bare[box] if own & ARMS else np.float32(0.0)
        before = np.where(others & (ARMS | HEAD), np.float32(0.0), bare)  # these may have the colours of a lower arm
        corner = ground.corner + VIEW.belief_scale * np.array([box[1].start, box[0].start])
        found.append(Patch(ground.number, ground.camera, np.where(others, before, ground.belief[box]), corner))
    return found


def judged(body: Body, limb: int, exposed: Sequence[Array], patches: Sequence[Patch]) -> Array:
    """(K, 2) what a limb explains, and what of the hall it lies on, for each of its postures, ``exposed`` as `in_views`
    has them."""
    cones, areas = _cones(body), np.zeros((len(exposed[0]), 2))
    for patch in patches:
        posed = exposed[patch.number]
        far = posed[..., :3, 3] + np.einsum("ksij,sj->ksi", posed[..., :3, :3], cones.tips_m[limb])
        ends = np.ascontiguousarray(np.stack([posed[..., :3, 3], far], axis=2))
        _paint(ends, cones.radii_m[limb], patch, areas)
    return areas


@lru_cache(maxsize=4)
def _cones(body: Body) -> _Cones:
    """Fitted to the skin: how thick it is near its joint, and near the next."""
    tips, radii = np.zeros((len(LIMBS), 3, 3)), np.zeros((len(LIMBS), 3, 2))
    for index, limb in enumerate(LIMBS):
        for link, segment in enumerate(limb):
            points = body.surface.points_m[body.surface.segment == segment]
            tip = body.offsets_m[segment + 1] if link < 2 else points[np.argmax(np.linalg.norm(points, axis=1))]
            along = points @ tip / (tip @ tip)
            beside = np.linalg.norm(points - along[:, None] * tip, axis=1)
            tips[index, link] = tip
            radii[index, link] = [np.median(beside[np.abs(along - at) < 0.3]) for at in (0.15, 0.85)]
    return _Cones(tips, radii, np.linalg.norm(tips, axis=2).sum(axis=1))


def _box(ground: Ground, centre_m: Array, radius_m: float) -> tuple[slice, slice] | None:
    """The part of a ground's maps that shows what lies within ``radius_m`` of a point; None where there is none."""
    camera = ground.camera
    across, down, depth = ray(centre_m[0], centre_m[1], centre_m[2], camera)
    if depth < APPEARANCE.nearest_limb_m:
        return None
    radius = radius_m * camera.focal / (VIEW.belief_scale * depth)
    pixel = np.array(camera.principal) + camera.focal * np.array([across, down])
    centre = (pixel - ground.corner) / VIEW.belief_scale
    left, top = np.maximum(centre - radius, 0.0).astype(int)
    right, bottom = np.minimum(centre + radius + 1.0, ground.belief.shape[::-1]).astype(int)
    return (slice(top, bottom), slice(left, right)) if right > left and bottom > top else None


@njit(cache=True, nogil=True, error_model="numpy")
def _paint(ends: Array, radii: Array, patch: Patch, areas: Array) -> None:
    """Add to ``areas`` (K, 2) what the cones ``ends`` (K, 3, 2, 3) cover, of body and of hall, in one view.

    A pixel that several cones cover counts once.
    """
    camera, free, corner, scale = patch.camera, patch.free, patch.corner, VIEW.belief_scale
    height, width = free.shape
    painted, painter = np.zeros((height, width)), np.full((height, width), -1)
    xy, radius = np.empty((2, 2)), np.empty(2)
    for k in range(len(ends)):
        for s in range(ends.shape[1]):
            seen, m_per_px = True, 0.0
            for e in range(2):
                across, down, depth = ray(ends[k, s, e, 0], ends[k, s, e, 1], ends[k, s, e, 2], camera)
                seen = seen and depth >= APPEARANCE.nearest_limb_m
                u, v = to_pixel(across, down, camera)
                m_per_px = scale * depth / camera.focal
                xy[e, 0], xy[e, 1], radius[e] = (u - corner[0]) / scale, (v - corner[1]) / scale, radii[s, e] / m_per_px
            if not seen:
                continue
            dx, dy = xy[1, 0] - xy[0, 0], xy[1, 1] - xy[0, 1]
            per_squared = 1.0 / (dx * dx + dy * dy + 1e-9)
            widest = max(radius[0], radius[1]) + 0.5
            first_row, last_row = int(min(xy[0, 1], xy[1, 1]) - widest), int(max(xy[0, 1], xy[1, 1]) + widest) + 1
            first, last = int(min(xy[0, 0], xy[1, 0]) - widest), int(max(xy[0, 0], xy[1, 0]) + widest) + 1
            for i in range(max(first_row, 0), min(last_row, height - 1) + 1):
                for j in range(max(first, 0), min(last, width - 1) + 1):
                    px, py = j - xy[0, 0], i - xy[0, 1]
                    t = min(max((px * dx + py * dy) * per_squared, 0.0), 1.0)
                    ox, oy = px - t * dx, py - t * dy
                    away, reach = ox * ox + oy * oy, radius[0] + t * (radius[1] - radius[0]) + 0.5
                    if away >= reach * reach:
                        continue
                    share = min(reach - np.sqrt(away), 1.0)
                    before = painted[i, j] if painter[i, j] == k else 0.0
                    if share <= before:
                        continue
                    painted[i, j], painter[i, j] = share, k
                    value = (share - before) * free[i, j] * m_per_px * m_per_px
                    areas[k, 0] += max(value, 0.0)
                    areas[k, 1] += max(-value, 0.0)
