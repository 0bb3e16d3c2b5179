"""Whether a limb looks like itself where it was found, and where else it does: the way back for a hidden arm.

Silhouettes say nothing of an arm that is held before the trunk, in any view. Its texture does: sleeve, skin and seams
stand out from the cloth behind them. So a limb is also judged by its skin: what looks as it is known to, less what does
not, in square metres summed over the views. What a posture of a limb is worth is then said by both, silhouettes
(`pzcap.limbs.search`) and likeness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.body.skeleton import Body, forward
from pzcap.limbs.search import BELIEF_SCALE, GROUP, LIMBS, RELUCTANCE_M2, LimbSearch, Patch
from pzcap.tracking import visibility
from pzcap.tracking.observation import DEPTH_TOLERANCE_M, Z_SCALE, PlacedView
from pzcap.tracking.pose_objective import LEARNING, Appearance, PoseObjective, px_per_m, view_level
from pzcap.types import PARENTS, Array, Camera, Float32, Image, Pose

_WORTH: Final = 6.0  # square metres of silhouette that one of likeness is worth
_UNLIKE: Final = 15.0  # grey levels by which a point half looks otherwise
_EVEN: Final = 0.58  # 1 looks as it should, and is no hall: what comes to this is neither like nor unlike
_GAIN: Final = (0.8, 1.25)  # what a limb that turns may darken or brighten by
_ELSEWHERE: Final = np.float32(0.5)  # trust in what another view has seen
_SPARSE: Final = 2  # of so many points of the skin one is looked at
_LEVELS: Final = (2, 1)  # of the pyramid, in the usual view: from afar, and from near


@dataclass(frozen=True, slots=True, eq=False)
class _Skin:
    """Some points of a limb's skin, in the frames of its segments."""

    rows: NDArray[np.int64]  # (N,) of the body's surface
    link: NDArray[np.int64]  # (N,) which of the limb's segments they are on
    points_m: Array  # (N, 3)
    normals: Array  # (N, 3)
    area_m2: Array  # (N,) of skin that each stands for
    others: NDArray[np.int64]  # (F, 3) faces of all the rest of the body


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """One view of a limb: the image, what the limb is known to look like there, and what may hide it."""

    camera: Camera
    image: Image
    belief: Float32  # of `pzcap.limbs.search.Ground`
    left: int
    top: int
    scale: float  # pixels of the view that one of the image is wide
    template: Float32  # (N,)
    trust: Float32  # (N,)
    z_buffer: Float32
    z_left: int
    z_top: int


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """A frame made ready to judge postures of one limb."""

    pose: Pose
    frames: Array  # world_T_segment (16, 4, 4)
    patches: list[Patch]
    far: list[_Sight]
    near: list[_Sight]


@dataclass(frozen=True, slots=True, eq=False)
class Postures:
    """Some postures of a limb in one frame."""

    turns: Array  # (K, 4) as `pzcap.limbs.search.LimbSearch.turned` takes them
    worth_m2: Array  # (K,)
    moved_m: Array  # (K, 2, 3) its joints from where the glance has them, in the frame of what it is fixed to


class LimbAppearance:
    """Judges the limbs of one body."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._limbs = LimbSearch(body)
        self._skins = [_skin(body, limb) for limb in LIMBS]

    def of(
        self, pose: Pose, evidence: PoseObjective, placed: Sequence[PlacedView | None], known: Sequence[Appearance]
    ) -> Array:
        """(4,) of each limb, square metres: what looks like itself less what does not, the body being where it was
        ``placed`` and its skin ``known`` to look so in each view."""
        frames = forward(self._body, pose)
        alike = np.empty(len(LIMBS))
        for limb, segments in enumerate(LIMBS):
            sights = self._sights(limb, pose, evidence, placed, known, _LEVELS[-1])
            alike[limb] = _compared(self._skins[limb], frames[None, list(segments)], sights)[0]
        return alike

    def support(self, pose: Pose, evidence: PoseObjective, placed: Sequence[PlacedView | None]) -> Array:
        """`LimbSearch.support`, the body being where it was ``placed``."""
        return self._limbs.support(pose, evidence.grounds(placed))

    def worth(self, pose: Pose, evidence: PoseObjective, known: Sequence[Appearance]) -> Array:
        """(4,) of each limb, square metres: what it explains of the silhouettes, less what it covers of the hall
        (`LimbSearch.support`), and how much it looks like itself."""
        frames, placed = forward(self._body, pose), evidence.visibility(pose)
        alike = np.empty(len(LIMBS))
        for limb, segments in enumerate(LIMBS):  # as `postures` has it
            sights = self._sights(limb, pose, evidence, self._behind(limb, placed), known, _LEVELS[-1])
            alike[limb] = _compared(self._skins[limb], frames[None, list(segments)], sights)[0]
        body, hall = self.support(pose, evidence, placed).T
        return np.asarray(body - hall + _WORTH * alike)

    def glance(self, limb: int, pose: Pose, evidence: PoseObjective, known: Sequence[Appearance]) -> Glance:
        """Make a frame ready to judge postures of one limb near that of ``pose``."""
        frames, placed = forward(self._body, pose), evidence.visibility(pose)
        behind = self._behind(limb, placed)
        far, near = (self._sights(limb, pose, evidence, behind, known, level) for level in _LEVELS)
        return Glance(pose, frames, self._limbs.patches(limb, frames, evidence.grounds(placed)), far, near)

    def postures(self, limb: int, glance: Glance, turns: Array, *, afar: bool) -> Postures:
        """Judge a limb turned by ``turns`` (K, 4), in coarse images if only ``afar``; the rest of the body is where the
        ``glance`` has it."""
        turns = self._limbs.bounded(limb, glance.pose, turns)
        posed = self._limbs.posed(limb, glance.pose, glance.frames, turns)
        body, hall = self._limbs.judge(limb, glance.pose, glance.frames, turns, glance.patches).T
        alike = _compared(self._skins[limb], posed, glance.far if afar else glance.near)
        worth = body - hall + _WORTH * alike - RELUCTANCE_M2 * np.sum(turns**2, axis=1)
        first, *others = LIMBS[limb]
        moved = posed[:, 1:, :3, 3] - glance.frames[others, :3, 3]
        return Postures(turns, worth, moved @ glance.frames[PARENTS[first], :3, :3])

    def turned(self, limb: int, pose: Pose, turn: Array) -> Pose:
        """`LimbSearch.turned`."""
        return self._limbs.turned(limb, pose, turn)

    def _sights(
        self, limb: int, pose: Pose, evidence: PoseObjective, placed: Sequence[PlacedView | None],
        known: Sequence[Appearance], usual_level: int,
    ) -> list[_Sight]:  # fmt: skip
        rows = self._skins[limb].rows
        sights = []
        for cut, where, look in zip(evidence.cuts, placed, known, strict=True):
            if cut is None or where is None:
                continue
            seen = cut.seen
            level = view_level(usual_level, px_per_m(seen.camera, pose.root_position_m))
            sights.append(
                _Sight(
                    seen.camera, seen.grey[level], cut.belief, seen.left, seen.top, 2.0**level,
                    look.value[level][rows], look.trust[rows], where.z_buffer, where.z_left, where.z_top,
                )
            )  # fmt: skip
        return sights

    def _behind(self, limb: int, placed: Sequence[PlacedView | None]) -> list[PlacedView | None]:
        """The views without the limb: what would hide it elsewhere."""
        found: list[PlacedView | None] = []
        for where in placed:
            if where is None:
                found.append(None)
                continue
            z_buffer, cover = np.empty_like(where.z_buffer), np.empty_like(where.cover)
            visibility.rasterise(
                where.skin.pixels, where.skin.depth, self._skins[limb].others, self._body.surface.segment, GROUP,
                where.z_left, where.z_top, Z_SCALE, z_buffer, cover,
            )  # fmt: skip
            found.append(PlacedView(where.skin, where.facing, z_buffer, cover, where.z_left, where.z_top))
        return found


def shared(known: Sequence[Appearance]) -> list[Appearance]:
    """What each view has ``known`` of the skin, and what it has not, as the other views have it: a limb that turns
    shows one camera what others have seen, and but for a gain it looks the same."""
    trust, value = np.array([look.trust for look in known]), np.array([look.value for look in known])
    mean = np.einsum("cv,clv->lv", trust, value) / np.maximum(trust.sum(axis=0), np.float32(1e-6))
    elsewhere = _ELSEWHERE * trust.max(axis=0)
    return [
        Appearance(np.where(look.trust > 0.0, look.value, mean), np.maximum(look.trust, elsewhere)) for look in known
    ]


def _skin(body: Body, limb: Sequence[int]) -> _Skin:
    surface = body.surface
    rows = np.flatnonzero(np.isin(surface.segment, limb))[::_SPARSE]
    points, normals = np.ascontiguousarray(surface.points_m[rows]), np.ascontiguousarray(surface.normals[rows])
    others = surface.faces[~np.isin(surface.segment[surface.faces[:, 0]], limb)]
    return _Skin(rows, surface.segment[rows] - limb[0], points, normals, _SPARSE * surface.area_m2[rows], others)


def _compared(skin: _Skin, posed: Array, sights: Sequence[_Sight]) -> Array:
    """(K,) square metres that look alike, less those that do not, of a limb that is ``posed`` (K, 3, 4, 4)."""
    alike = np.zeros(len(posed))
    for sight in sights:
        camera = sight.camera
        _compare(
            np.ascontiguousarray(posed), skin.points_m, skin.normals, skin.link, skin.area_m2, camera.world_T_cam,
            camera.focal_px, camera.principal_px, camera.k1, sight.image, sight.belief, sight.left, sight.top,
            sight.scale, sight.template, sight.trust, sight.z_buffer, sight.z_left, sight.z_top, alike,
        )  # fmt: skip
    return alike


@njit(cache=True, nogil=True, error_model="numpy")
def _compare(
    posed: Array, points: Array, normals: Array, link: NDArray[np.int64], area: Array, world_T_cam: Array, focal: float,
    principal: Array, k1: float, image: Image, belief: Float32, left: int, top: int, scale: float,
    template: Float32, trust: Float32, z_buffer: Float32, z_left: int, z_top: int, alike: Array,
) -> None:  # fmt: skip
    """Add to ``alike`` (K,) the area that looks like the ``template`` (N,) times a gain, its own for each segment, in
    one view, less the area that does not, or is surely hall. Hidden points, and such as are seen too obliquely,
    say nothing."""
    height, width = image.shape
    rows, columns = z_buffer.shape
    camera = visibility.stand(world_T_cam)
    value, doubt, weight = np.empty(len(points)), np.empty(len(points)), np.empty(len(points))
    per_px = scale / BELIEF_SCALE
    for k in range(len(posed)):
        first = 0
        while first < len(points):
            s, last = link[first], first
            m = posed[k, s]
            product, square = 0.0, 0.0
            while last < len(points) and link[last] == s:
                n = last
                last += 1
                weight[n] = 0.0
                x = m[0, 0] * points[n, 0] + m[0, 1] * points[n, 1] + m[0, 2] * points[n, 2] + m[0, 3]
                y = m[1, 0] * points[n, 0] + m[1, 1] * points[n, 1] + m[1, 2] * points[n, 2] + m[1, 3]
                z = m[2, 0] * points[n, 0] + m[2, 1] * points[n, 1] + m[2, 2] * points[n, 2] + m[2, 3]
                nx = m[0, 0] * normals[n, 0] + m[0, 1] * normals[n, 1] + m[0, 2] * normals[n, 2]
                ny = m[1, 0] * normals[n, 0] + m[1, 1] * normals[n, 1] + m[1, 2] * normals[n, 2]
                nz = m[2, 0] * normals[n, 0] + m[2, 1] * normals[n, 1] + m[2, 2] * normals[n, 2]
                dx, dy, dz = camera[9] - x, camera[10] - y, camera[11] - z
                facing = (nx * dx + ny * dy + nz * dz) / np.sqrt(dx * dx + dy * dy + dz * dz)
                across, down, depth = visibility.ray(x, y, z, camera)
                if facing <= LEARNING or trust[n] <= 0.0 or depth < 0.1:
                    continue
                bent = focal * (1.0 + k1 * (across * across + down * down))
                u, v = principal[0] + bent * across, principal[1] + bent * down
                j, i = int(np.rint((u - z_left) / Z_SCALE)), int(np.rint((v - z_top) / Z_SCALE))
                if 0 <= j < columns and 0 <= i < rows and depth > z_buffer[i, j] + DEPTH_TOLERANCE_M:
                    continue
                u, v = (u - left) / scale, (v - top) / scale
                if u < 1.0 or v < 1.0 or u >= width - 2.0 or v >= height - 2.0:
                    continue
                value[n] = visibility.bilinear(image, u, v)
                i, j = min(int(v * per_px), len(belief) - 1), min(int(u * per_px), belief.shape[1] - 1)
                doubt[n] = max(-belief[i, j], 0.0)
                weight[n] = trust[n] * area[n] * facing
                product += weight[n] * value[n] * template[n]
                square += weight[n] * template[n] * template[n]
            if square > 0.0:
                gain = min(max(product / square, _GAIN[0]), _GAIN[1])
                for n in range(first, last):
                    if weight[n] > 0.0:
                        off = (value[n] - gain * template[n]) / _UNLIKE
                        alike[k] += weight[n] * ((1.0 - doubt[n]) / (1.0 + off * off) - _EVEN)
            first = last
