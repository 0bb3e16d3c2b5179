"""Poses of panning cameras to each other from a body that moves before them, where no calibration object tells them.

A camera that has swept the hall knows in which direction of its head it sees a keypoint; its head stands level, to what
a spirit level leaves. Between two level heads four numbers are open: a heading and a place. Every heading is tried, and
the place that suits it follows from the epipolar constraint ``t . (d x R d') = 0``, which is linear in it; further
cameras are placed by the points that two have seen, as linearly. Then all is adjusted together, the points eliminated:

    r = B' R' (X - t - R o) / distance        B (3, 2) beside a ray, o where it starts in the head's frame

with the heads' lean known to a third of a degree. What one length all around is remains open, and where the whole
stands: scale, heading and place in the world are the null space of the normal equations, left where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.initialisation.tuning import HEADS
from pzcap.solver.robust import geman_mcclure, normal_sigma
from pzcap.types import Array, Indices, Mask, PzcapError


class HeadRays(NamedTuple):
    """Rays of N moving points from C cameras, each in the frame of its head."""

    origins: Array  # (C, N, 3)
    directions: Array  # (C, N, 3) unit vectors
    confidence: Array  # (C, N) 0 where a camera does not see it
    doubt: float = HEADS.doubt  # so many rays of a camera tell as much as one
    on_floor: bool = False  # the points lie on the floor, which tells how all heads lean together

    def some(self, rows: Indices | slice) -> HeadRays:
        """The rays of some of the points."""
        values = (self.origins[:, rows], self.directions[:, rows], self.confidence[:, rows])
        return HeadRays(*values, self.doubt, self.on_floor)


@dataclass(frozen=True, slots=True, eq=False)
class Heads:
    """Heads in a world that is level, and whose unit of length is unknown, with the points that they have seen."""

    rotation: Array  # (C, 3, 3) world from head
    place: Array  # (C, 3)
    placed: Mask  # (C,) False: too little is seen from there
    points: Array  # (N, 3)
    seen: Mask  # (N,) from two cameras or more, which agree
    sigma_rad: float  # of a ray
    covariance: Array  # (6 C, 6 C) of turn in the head's frame and place, what is common to all left out

    def moved(self, rotation: Array, scale: float, shift: Array) -> Heads:
        """The same in another world: turned, scaled, then shifted."""
        block = np.zeros((6, 6))
        block[:3, :3], block[3:, 3:] = np.eye(3), scale * rotation
        change = np.kron(np.eye(len(self.place)), block)
        return Heads(
            rotation @ self.rotation, scale * self.place @ rotation.T + shift, self.placed,
            scale * self.points @ rotation.T + shift, self.seen, self.sigma_rad, change @ self.covariance @ change.T,
        )  # fmt: skip


def place_heads(rays: HeadRays) -> Heads:
    """Find how the cameras stand to each other. Raises PzcapError where no two of them tell."""
    count = len(rays.origins)
    some = rays.some(np.linspace(0, rays.confidence.shape[1] - 1, HEADS.first_points).astype(np.int64))
    pairs = [
        (*_pair(some, one, other), one, other)
        for one, other in combinations(range(count), 2)
        if np.sum((some.confidence[one] > 0.0) & (some.confidence[other] > 0.0)) >= HEADS.fewest_points
    ]
    if not pairs:
        raise PzcapError("no two cameras see the athlete together")
    worth, yaw, baseline, one, other = max(pairs, key=lambda pair: pair[0])
    if worth < HEADS.least_worth:
        raise PzcapError("the keypoints of no two cameras agree about how these stand to each other")
    rotation, place = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    rotation[other], place[other] = _about_z(np.array([yaw]))[0], baseline
    placed = np.isin(np.arange(count), (one, other))
    while True:
        points, seen = _intersected(some, rotation, place, placed)
        common = (seen & (some.confidence > 0.0)).sum(axis=1)
        left = np.flatnonzero(~placed & (common >= HEADS.fewest_points)).tolist()
        if not left:
            break
        found = [(*_resected(some, c, points, seen), c) for c in left]
        agreement, yaw, where, c = max(found, key=lambda one: one[0])
        if agreement < HEADS.least_agreement:
            break
        rotation[c], place[c], placed[c] = _about_z(np.array([yaw]))[0], where, True
        if placed.sum() > HEADS.first_adjusted:  # fewer rays meet whatever the cameras do
            rotation, place = _adjusted(some, rotation, place, placed).pose
    return adjust(rays, rotation, place, placed)


def adjust(rays: HeadRays, rotation: Array, place: Array, placed: Mask) -> Heads:
    """Adjust heads that are known roughly, and say how well they are known."""
    done = _adjusted(rays, rotation, place, placed)
    return Heads(*done.pose, placed, done.points, done.seen, done.sigma, done.covariance)


def _about_z(angles_rad: Array) -> Array:
    """(Y, 3, 3)"""
    return np.asarray(Rotation.from_euler("z", angles_rad[:, None]).as_matrix())


def _yaws() -> Array:
    return np.deg2rad(np.arange(0.0, 360.0, HEADS.step_deg))


# --------------------------------------------------------------------------------------------------------------
# First values, with every heading tried


def _pair(rays: HeadRays, one: int, other: int) -> tuple[float, float, Array]:
    """Heading of one level camera to another, and the direction in which it stands: what that is worth (the share of
    the rays that agree, times the sine of the angle at which they meet), yaw, and the unit vector (3,)."""
    both = (rays.confidence[one] > 0.0) & (rays.confidence[other] > 0.0)
    first, second = rays.directions[one, both], rays.directions[other, both]
    yaws, scale = _yaws(), np.deg2rad(HEADS.step_deg)
    while True:
        turned = np.einsum("yij,nj->yni", _about_z(yaws), second)
        across = np.cross(first[None], turned)
        weight = np.ones(across.shape[:2])
        for _ in range(HEADS.steps):
            _, vectors = np.linalg.eigh(np.einsum("yn,yni,ynj->yij", weight, across, across))
            way = vectors[:, :, 0]
            lever = np.maximum(np.linalg.norm(np.cross(way[:, None], first[None]), axis=2), HEADS.least_lever)
            off = np.einsum("yni,yi->yn", across, way) / lever
            agree = geman_mcclure(off, scale)
            weight = agree / lever**2
        best = int(np.argmax(agree.sum(axis=1)))
        if scale < HEADS.fine_rad:
            break
        yaws, scale = yaws[best] + np.linspace(-scale, scale, 9), scale / 4.0
    baseline = way[best]
    in_front = [_in_front(first, turned[best], sign * baseline) for sign in (1.0, -1.0)]
    front = in_front[0] if in_front[0].sum() >= in_front[1].sum() else in_front[1]
    baseline = baseline if front is in_front[0] else -baseline
    angle = float(np.median(np.linalg.norm(across[best], axis=1)))
    return float(np.mean(agree[best] * front)) * angle, float(yaws[best]), baseline


def _in_front(first: Array, second: Array, baseline: Array) -> Mask:
    """(N,) True where rays from 0 and from the ``baseline`` meet in front of both."""
    along = np.sum(first * second, axis=1)
    a, b = first @ baseline, second @ baseline
    least = np.maximum(1.0 - along**2, 1e-12)
    return np.asarray(((a - along * b) / least > 0.0) & ((along * a - b) / least > 0.0))


def _resected(rays: HeadRays, camera: int, points: Array, seen: Mask) -> tuple[float, float, Array]:
    """A level camera placed by points that others have seen: share of its rays that agree, yaw, and place (3,)."""
    both = seen & (rays.confidence[camera] > 0.0)
    local, points = rays.directions[camera, both], points[both]
    yaws, scale = _yaws(), np.deg2rad(HEADS.step_deg)
    while True:
        directions = np.einsum("yij,nj->yni", _about_z(yaws), local)
        beside = np.eye(3) - directions[..., :, None] * directions[..., None, :]
        weight = np.ones(directions.shape[:2])
        for _ in range(HEADS.steps):
            normal = np.einsum("yn,ynij->yij", weight, beside) + 1e-9 * np.eye(3)
            where = np.linalg.solve(normal, np.einsum("yn,ynij,nj->yi", weight, beside, points)[..., None])[..., 0]
            way = points[None] - where[:, None]
            length = np.maximum(np.linalg.norm(way, axis=2), 1e-9)
            cosine = np.sum(way * directions, axis=2) / length
            off = np.where(cosine > 0.0, np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), 1.0)
            agree = geman_mcclure(off, scale)
            weight = agree / length**2 + 1e-9
        best = int(np.argmax(agree.sum(axis=1)))
        if scale < HEADS.fine_rad:
            return float(np.mean(agree[best])), float(yaws[best]), where[best]
        yaws, scale = yaws[best] + np.linspace(-scale, scale, 9), scale / 4.0


def _intersected(rays: HeadRays, rotation: Array, place: Array, placed: Mask) -> tuple[Array, Mask]:
    """Points (N, 3) where the rays of the cameras placed so far meet, and which of them do (N,)."""
    origins = place[:, None] + np.einsum("cij,cnj->cni", rotation, rays.origins)
    directions = np.einsum("cij,cnj->cni", rotation, rays.directions)
    usable = (rays.confidence > 0.0) & placed[:, None]
    beside = np.eye(3) - directions[..., :, None] * directions[..., None, :]
    weight = np.where(usable, 1.0, 0.0)
    for _ in range(HEADS.steps):
        normal = np.einsum("cn,cnij->nij", weight, beside) + 1e-9 * np.eye(3)
        right = np.einsum("cn,cnij,cnj->ni", weight, beside, origins)
        points = np.linalg.solve(normal, right[..., None])[..., 0]
        way = points[None] - origins
        length = np.maximum(np.linalg.norm(way, axis=2), 1e-9)
        cosine = np.sum(way * directions, axis=2) / length
        off = np.where(cosine > 0.0, np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), 1.0)
        weight = np.where(usable, geman_mcclure(off, HEADS.agree_rad) / length**2, 0.0)
    return points, np.asarray((usable & (off < HEADS.agree_rad)).sum(axis=0) >= 2)


# --------------------------------------------------------------------------------------------------------------
# All together


class _Adjusted(NamedTuple):
    pose: tuple[Array, Array]  # rotations (C, 3, 3) and places (C, 3)
    points: Array  # (N, 3)
    seen: Mask  # (N,)
    sigma: float  # of a ray, rad
    covariance: Array  # (6 C, 6 C)


def _adjusted(rays: HeadRays, rotation: Array, place: Array, placed: Mask) -> _Adjusted:
    """Gauss-Newton on all heads and points, robust."""
    count = len(rotation)
    rotation, place = rotation.copy(), place.copy()
    points, seen = _intersected(rays, rotation, place, placed)
    usable = (rays.confidence > 0.0) & placed[:, None] & seen
    sideways = _sideways(rays.directions)  # (C, N, 3, 2)
    for number in range(HEADS.iterations):
        local = np.einsum("cji,cnj->cni", rotation, points[None] - place[:, None])  # R' (X - t)
        way = local - rays.origins
        length = np.maximum(np.linalg.norm(way, axis=2), 1e-9)
        residual = np.einsum("cnik,cni->cnk", sideways, way) / length[..., None]
        behind = np.sum(way * rays.directions, axis=2) <= 0.0
        size = np.where(behind, 1.0, np.linalg.norm(residual, axis=2))
        told = residual[usable & ~behind]
        left = max(1.0 - 3.0 * float(seen.sum()) / told.size, 0.1)  # points have taken three of their residuals each
        sigma = max(normal_sigma(told.ravel()) / np.sqrt(left), HEADS.least_sigma_rad)
        scale = HEADS.loose if number < HEADS.iterations // 2 else HEADS.tight
        weight = (
            np.where(usable, geman_mcclure(size, scale * sigma), 0.0) * rays.confidence**2 / (rays.doubt * sigma**2)
        )
        rows = sideways.transpose(0, 1, 3, 2) / length[..., None, None]  # (C, N, 2, 3)
        by_point = rows @ rotation.transpose(0, 2, 1)[:, None]
        by_turn = np.cross(rows, local[:, :, None])
        by_head = np.concatenate([by_turn, -by_point], axis=3)  # (C, N, 2, 6)
        heads = np.zeros((6 * count, 6 * count))
        gradient = np.zeros(6 * count)
        own = np.einsum("cn,cnki,cnkj->cij", weight, by_head, by_head)
        pull = np.einsum("cn,cnki,cnk->ci", weight, by_head, residual)
        for c in range(count):
            part = slice(6 * c, 6 * c + 6)
            up = rotation[c].T @ [0.0, 0.0, 1.0]
            lean = np.cross(np.eye(3)[:2], up)  # d up / d turn
            own[c, :3, :3] += lean.T @ lean / HEADS.lean_rad**2
            pull[c, :3] += lean.T @ up[:2] / HEADS.lean_rad**2
            heads[part, part], gradient[part] = own[c], pull[c]
        stay = HEADS.damping / rays.doubt / (sigma * float(np.median(length))) ** 2
        alone = np.einsum("cn,cnki,cnkj->nij", weight, by_point, by_point) + stay * np.eye(3)
        of_points = np.einsum("cn,cnki,cnk->ni", weight, by_point, residual)
        shared = np.einsum("cn,cnki,cnkj->ncij", weight, by_head, by_point).reshape(-1, 6 * count, 3)
        inverse = np.linalg.inv(alone)
        carried = shared @ inverse
        reduced = heads - np.einsum("nik,njk->ij", carried, shared)
        common = _common(rotation, place, placed, rays.on_floor)
        step, covariance = _solved(reduced, gradient - np.einsum("nik,nk->i", carried, of_points), common, placed)
        step = -step.reshape(count, 6)
        points = points - np.einsum("nij,nj->ni", inverse, of_points + np.einsum("nik,i->nk", shared, step.ravel()))
        rotation = rotation @ Rotation.from_rotvec(step[:, :3]).as_matrix()
        place = place + step[:, 3:]
        if number > HEADS.iterations // 2 and np.abs(step[:, :3]).max() < HEADS.settled_rad:
            break
    sure = usable & (size < HEADS.tight * sigma)
    return _Adjusted((rotation, place), points, np.asarray(sure.sum(axis=0) >= 2), sigma, covariance)


def _common(rotation: Array, place: Array, placed: Mask, on_floor: bool) -> tuple[Array, float]:
    """Motions of all heads (6 C, K) that rays do not tell: place, scale, heading, and how all lean together where the
    floor is to tell that; and the spread of the heads, in which lengths are to be measured."""
    middle = place[placed].mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((place[placed] - middle) ** 2, axis=1))))
    axes = np.eye(3) if on_floor else np.eye(3)[2:]
    found = np.zeros((len(place), 6, 4 + len(axes)))
    found[:, 3:, :3] = np.eye(3)
    found[:, 3:, 3] = place - middle
    for k, axis in enumerate(axes, start=4):
        found[:, :3, k] = axis @ rotation
        found[:, 3:, k] = np.cross(axis, place - middle)
    return found.reshape(-1, 4 + len(axes)), spread


def _solved(normal: Array, right: Array, common: tuple[Array, float], placed: Mask) -> tuple[Array, Array]:
    """The step that solves the normal equations (6 C, 6 C) and moves nothing that is ``common`` to all heads, and the
    covariance of the rest. Heads that are not placed stay."""
    moves, spread = common
    unit = np.tile([1.0, 1.0, 1.0, spread, spread, spread], len(placed))
    free = np.repeat(placed, 6)
    basis, _ = np.linalg.qr((moves / unit[:, None])[free])
    rest = np.eye(len(basis)) - basis @ basis.T
    scaled = rest @ (normal * np.outer(unit, unit))[np.ix_(free, free)] @ rest
    held = scaled + np.trace(scaled) * basis @ basis.T
    covariance = np.zeros_like(normal)
    covariance[np.ix_(free, free)] = rest @ np.linalg.inv(held) @ rest
    covariance *= np.outer(unit, unit)
    return covariance @ right, covariance


def _sideways(directions: Array) -> Array:
    """(..., 3, 2) two unit vectors across each direction."""
    helper = np.where(np.abs(directions[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(helper, directions)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=-1)


def floor_height(heights: Sequence[float] | Array) -> float:
    """Height of the floor by the ``heights`` of feet over time: the lowest of them, but for a few that are wrong."""
    return float(np.percentile(np.asarray(heights), HEADS.floor_percentile))
