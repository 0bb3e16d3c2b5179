"""Support of a limb by the silhouettes, and the postures in which it may be searched for.

Gauss-Newton follows a slope. A limb that has come to lie over the trunk in all views has none: its contour is hidden,
and the arm in the silhouette beside it is explained by nothing. So every limb is also judged by area, as three cones.
A pixel that shows the athlete and that no other part of the body covers is worth what its colour says for it, one of
the hall costs as much; so is, to an arm, one that another part covers but that has a lower arm's colour. A limb's
support is what it covers, in square metres at its own distance summed over the views.
Where both passes have lost a limb, some hundred postures of its two first joints are judged by it
(`pzcap.tracking.reacquisition`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.body import kinematics
from pzcap.body.kinematics import difference, forward
from pzcap.body.skeleton import DOF_SEGMENT, Body
from pzcap.types import HINGE_AXES, PARENTS, SEGMENTS, Array, Camera, Float32, Image, Pose

LIMBS: Final[tuple[tuple[int, ...], ...]] = ((4, 5, 6), (7, 8, 9), (10, 11, 12), (13, 14, 15))
"""Segments of the arms and the legs: a ball joint, a hinge and a ball joint each."""
_HEAD: Final = 32
GROUP: Final[NDArray[np.uint8]] = np.array(
    [next((2 << k for k, limb in enumerate(LIMBS) if s in limb), 1) for s in range(len(SEGMENTS))], np.uint8
)
GROUP[SEGMENTS.index("head")] |= _HEAD
"""(16,) One bit a part of the body: the trunk with the head, then each limb; the head has one besides."""
ARMS: Final = int(GROUP[LIMBS[0][0]] | GROUP[LIMBS[1][0]])
_BARE: Final = np.uint8(ARMS | _HEAD)  # what may have the colours of a lower arm
BELIEF_SCALE: Final = 4
RELUCTANCE_M2: Final = 0.002
"""Gain that a turn of one radian must bring."""
_HINGE_RANGE_RAD: Final = (0.0, 2.6)


def _postures() -> Array:
    swings = [(0.0, 0.0)]
    for size, count in ((0.5, 6), (1.0, 9)):
        angles = 2 * np.pi * np.arange(count) / count
        swings += list(zip(size * np.cos(angles), size * np.sin(angles), strict=True))
    return np.array([(x, y, z, h) for x, y in swings for z in (-0.8, 0.0, 0.8) for h in (-0.8, 0.0, 0.8)])


POSTURES: Final[Array] = _postures()
"""(K, 4) Turns of a limb to try when it may be anywhere in its reach, radians: as `LimbSearch.turned` takes them."""
_AS_IT_IS: Final[Array] = np.zeros((1, 4))
_STRAIGHT: Final[Array] = np.array([[1.0, 0.0, 0.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Evidence of the colours of one view, and what of it the body covers. Pixel ``(i, j)`` of a map stands at
    ``corner + BELIEF_SCALE * (j, i)`` of the view."""

    camera: Camera
    corner: Array  # (2,)
    belief: Float32  # (h, w) -1 hall .. 1 body
    cover: NDArray[np.uint8]  # (h, w) bits of GROUP
    bare: Float32  # (h, w) belief in a lower arm, 0 .. 1, by its colours


def ground(
    camera: Camera, corner: Array, belief: Float32, arms: Image, cover: NDArray[np.uint8], shift: Array
) -> Ground:
    """Judge one view: ``arms`` (H, W), 0..255, is as `pzcap.limbs.skin_colour_model` has it, ``cover`` as
    `pzcap.tracking.visibility.rasterise` left it; ``shift`` (2, 3) takes pixels of the belief to pixels of it."""
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    here = np.asarray(cv2.warpAffine(cover, shift, belief.shape[::-1], flags=nearest), np.uint8)
    likely = cv2.resize(arms, belief.shape[::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
    bare = np.maximum(likely / np.float32(127.5) - np.float32(1.0), np.float32(0.0))
    return Ground(camera, corner, belief, here, bare)


@dataclass(frozen=True, slots=True, eq=False)
class _Cones:
    """A limb as three cones, one a link."""

    tips_m: Array  # (3, 3) the far end of each in its segment; the near end is the joint
    radii_m: Array  # (3, 2) at the near and the far end


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """The surroundings of a limb in one view."""

    camera: Camera
    free: Float32  # (h, w) the belief; where another part of the body covers, that in an arm before it
    corner: Array  # (2,)
    m_per_px: float


class LimbSearch:
    """Judges the limbs of one body."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._cones = [_cones(body, limb) for limb in LIMBS]
        self._reach_m = [float(np.linalg.norm(cones.tips_m, axis=1).sum()) for cones in self._cones]

    def support(self, pose: Pose, grounds: Sequence[Ground | None]) -> Array:
        """Per limb (4, 2), square metres of silhouette that it alone explains, and of the hall that it lies on."""
        frames = forward(self._body, pose)
        return np.array([
            self.judge(limb, pose, frames, _AS_IT_IS, self.patches(limb, frames, grounds))[0]
            for limb in range(len(LIMBS))
        ])  # fmt: skip

    def bounded(self, limb: int, pose: Pose, tries: Array) -> Array:
        """The turns ``tries`` (K, 4) of a limb that its hinge can make."""
        second = LIMBS[limb][1]
        bent = float(kinematics.between(_STRAIGHT, pose.rotations[[second]])[0] @ _hinge(second))
        return np.column_stack([tries[:, :3], np.clip(bent + tries[:, 3], *_HINGE_RANGE_RAD) - bent])

    def turned(self, limb: int, pose: Pose, turn: Array) -> Pose:
        """The pose with one limb turned by (4,): its ball joint about its own three axes, then its hinge."""
        first, second, _ = LIMBS[limb]
        rotations = pose.rotations.copy()
        turns = np.stack([turn[:3], turn[3] * _hinge(second)])
        rotations[[first, second]] = kinematics.turn(np.ascontiguousarray(rotations[[first, second]]), turns)
        return Pose(pose.root_position_m, rotations)

    def posed(self, limb: int, pose: Pose, frames: Array, tries: Array) -> Array:
        """(K, 3, 4, 4) the segments of a limb in the world, turned as each of ``tries`` (K, 4) has it."""
        segments = list(LIMBS[limb])
        return _posed(
            np.ascontiguousarray(frames[PARENTS[segments[0]]]), self._body.offsets_m[segments],
            pose.rotations[segments], _hinge(segments[1]), tries,
        )  # fmt: skip

    def patches(self, limb: int, frames: Array, grounds: Sequence[Ground | None]) -> list[Patch]:
        """The surroundings of a limb in each view that shows them."""
        root, reach = frames[LIMBS[limb][0], :3, 3], self._reach_m[limb]
        own = int(GROUP[LIMBS[limb][0]])
        others = np.uint8(255 - own)
        patches = []
        for ground in grounds:
            box = None if ground is None else _box(ground, root, reach)
            if ground is None or box is None:
                continue
            rows, columns = box[0]
            covers = ground.cover[box[0]] & others
            before = np.where(covers & _BARE, np.float32(0.0), ground.bare[box[0]]) if own & ARMS else np.float32(0.0)
            free = np.where(covers, before, ground.belief[box[0]])
            corner = ground.corner + BELIEF_SCALE * np.array([columns.start, rows.start])
            patches.append(Patch(ground.camera, free, corner, box[1]))
        return patches

    def judge(self, limb: int, pose: Pose, frames: Array, tries: Array, patches: Sequence[Patch]) -> Array:
        """(K, 2) what the limb explains, and what of the hall it lies on, turned as each of ``tries`` (K, 4) has it."""
        cones = self._cones[limb]
        both = np.zeros((len(tries), 2))
        posed = self.posed(limb, pose, frames, tries)
        far = posed[..., :3, 3] + np.einsum("ksij,sj->ksi", posed[..., :3, :3], cones.tips_m)
        ends = np.ascontiguousarray(np.stack([posed[..., :3, 3], far], axis=2))
        for patch in patches:
            camera = patch.camera
            _paint(
                ends, cones.radii_m, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, patch.free,
                patch.corner, both,
            )  # fmt: skip
        return both


def turn_to(limb: int, start: Pose, end: Pose) -> Array:
    """The turn (4,) that takes a limb from one pose to another, as `LimbSearch.turned` takes it."""
    return difference(end, start)[np.isin(DOF_SEGMENT, LIMBS[limb][:2])]


def _cones(body: Body, limb: Sequence[int]) -> _Cones:
    """Fitted to the skin: how thick it is near its joint, and near the next."""
    tips, radii = np.zeros((3, 3)), np.zeros((3, 2))
    for link, segment in enumerate(limb):
        points = body.surface.points_m[body.surface.segment == segment]
        tip = body.offsets_m[limb[link + 1]] if link < 2 else points[np.argmax(np.linalg.norm(points, axis=1))]
        along = points @ tip / (tip @ tip)
        beside = np.linalg.norm(points - along[:, None] * tip, axis=1)
        tips[link] = tip
        radii[link] = [np.median(beside[np.abs(along - at) < 0.3]) for at in (0.15, 0.85)]
    return _Cones(tips, radii)


def _hinge(segment: int) -> Array:
    return np.array(HINGE_AXES[SEGMENTS[segment]])


def _box(ground: Ground, centre_m: Array, radius_m: float) -> tuple[tuple[slice, slice], float] | None:
    """The part of a ground's maps that shows what lies within ``radius_m`` of a point, and how many metres a pixel of
    them is there. None where there is none."""
    camera = ground.camera
    seen = camera.world_T_cam[:3, :3].T @ (centre_m - camera.world_T_cam[:3, 3])
    if seen[2] < 0.5:
        return None
    m_per_px = BELIEF_SCALE * float(seen[2]) / camera.focal_px
    centre = (camera.principal_px + camera.focal_px * seen[:2] / seen[2] - ground.corner) / BELIEF_SCALE
    left, top = np.maximum(centre - radius_m / m_per_px, 0.0).astype(int)
    right, bottom = np.minimum(centre + radius_m / m_per_px + 1.0, ground.belief.shape[::-1]).astype(int)
    return ((slice(top, bottom), slice(left, right)), m_per_px) if right > left and bottom > top else None


@njit(cache=True, nogil=True)
def _posed(parent: Array, offsets: Array, rotations: Array, hinge: Array, tries: Array) -> Array:
    """(K, 3, 4, 4) the segments of a limb in the world, turned as each of ``tries`` (K, 4) has it."""
    chain = np.arange(-1, 2)
    turns = np.zeros((3, 3))
    out = np.zeros((len(tries), 3, 4, 4))
    for k in range(len(tries)):
        for i in range(3):
            turns[0, i] = tries[k, i]
            turns[1, i] = tries[k, 3] * hinge[i]
        frames = kinematics.chain(
            offsets[0], kinematics.turn(rotations, turns), offsets, chain
        )  # in the parent's frame
        for s in range(3):
            for i in range(4):
                for j in range(4):
                    for m in range(4):
                        out[k, s, i, j] += parent[i, m] * frames[s, m, j]
    return out


@njit(cache=True, nogil=True)
def _paint(
    ends: Array, radii: Array, world_T_cam: Array, focal: float, principal: Array, k1: float, free: Float32,
    corner: Array, both: Array,
) -> None:  # fmt: skip
    """Add to ``both`` (K, 2) the area that the cones ``ends`` (K, 3, 2, 3) cover, of body and of hall, in one view.

    A pixel that several cones cover counts once.
    """
    height, width = free.shape
    painted = np.zeros((height, width))
    painter = np.full((height, width), -1)
    xy, radius = np.empty((2, 2)), np.empty(2)
    for k in range(len(ends)):
        for s in range(ends.shape[1]):
            seen = True
            m_per_px = 0.0
            for e in range(2):
                x, y, z = 0.0, 0.0, 0.0
                for i in range(3):
                    d = ends[k, s, e, i] - world_T_cam[i, 3]
                    x += world_T_cam[i, 0] * d
                    y += world_T_cam[i, 1] * d
                    z += world_T_cam[i, 2] * d
                if z < 0.5:
                    seen = False
                    break
                x /= z
                y /= z
                scale = focal * (1.0 + k1 * (x * x + y * y))
                xy[e, 0] = (principal[0] + scale * x - corner[0]) / BELIEF_SCALE
                xy[e, 1] = (principal[1] + scale * y - corner[1]) / BELIEF_SCALE
                m_per_px = BELIEF_SCALE * z / focal
                radius[e] = radii[s, e] / m_per_px
            if not seen:
                continue
            dx, dy = xy[1, 0] - xy[0, 0], xy[1, 1] - xy[0, 1]
            squared = dx * dx + dy * dy + 1e-9
            widest = max(radius[0], radius[1]) + 0.5
            first_row, last_row = int(min(xy[0, 1], xy[1, 1]) - widest), int(max(xy[0, 1], xy[1, 1]) + widest) + 1
            first, last = int(min(xy[0, 0], xy[1, 0]) - widest), int(max(xy[0, 0], xy[1, 0]) + widest) + 1
            for i in range(max(first_row, 0), min(last_row, height - 1) + 1):
                for j in range(max(first, 0), min(last, width - 1) + 1):
                    px, py = j - xy[0, 0], i - xy[0, 1]
                    t = min(max((px * dx + py * dy) / squared, 0.0), 1.0)
                    ox, oy = px - t * dx, py - t * dy
                    share = min(radius[0] + t * (radius[1] - radius[0]) - np.sqrt(ox * ox + oy * oy) + 0.5, 1.0)
                    if share <= 0.0:
                        continue
                    if painter[i, j] != k:
                        painter[i, j] = k
                        painted[i, j] = 0.0
                    more = share - painted[i, j]
                    if more <= 0.0:
                        continue
                    painted[i, j] = share
                    value = more * free[i, j] * m_per_px * m_per_px
                    both[k, 0] += max(value, 0.0)
                    both[k, 1] += max(-value, 0.0)
