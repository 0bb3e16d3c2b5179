"""Appearance score of a limb: how much it looks like itself where it was found, and where else it does.

Silhouettes say nothing of an arm that is held before the trunk, in any view. Its texture does: sleeve, skin and seams
stand out from the cloth behind them. So a limb is also judged by its skin: the area that looks as it is known to, less
what does not, in square metres summed over the views. A posture of a limb is then scored by both, silhouettes
(`pzcap.tracking.limbs`) and similarity, and by a detector's keypoints that agree with it, where there are any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from pzcap.body.kinematics import forward, segment_end
from pzcap.body.skeleton import LIMBS, Body
from pzcap.geometry.pinhole import NEAREST_M, Pinhole, pinhole, ray, relative_to, to_pixel
from pzcap.imaging.interpolation import bilinear
from pzcap.tracking import limbs
from pzcap.tracking.keypoint_residuals import agreement
from pzcap.tracking.limbs import POSTURES, Patch, grounds, support
from pzcap.tracking.observation import Placed, PlacedView
from pzcap.tracking.pose_objective import PoseObjective, px_per_m, view_level
from pzcap.tracking.residuals import CropImage, Template
from pzcap.tracking.skin_appearance import Appearances
from pzcap.tracking.tuning import APPEARANCE, BRIGHTNESS, KEYPOINT, VIEW
from pzcap.tracking.visibility import GROUP, ZBuffer, rasterise
from pzcap.types import PARENTS, Array, Float32, Indices, Mask, Pose

_ELSEWHERE: Final[Array] = POSTURES[::7]  # (K, 4) Turns of a limb, few but all over its reach


class _LimbSkin(NamedTuple):
    """Some points of a limb's skin, in the frames of its segments."""

    points: Array  # (N, 3) metres
    normals: Array  # (N, 3)
    link: Indices  # (N,) which of the limb's segments each is on
    area: Array  # (N,) square metres of skin that each stands for


class _LimbView(NamedTuple):
    """One view of a limb: the image, the limb's template there, and what may hide it."""

    number: int  # of the view
    camera: Pinhole
    crop: CropImage
    belief: Float32  # (h, w) -1 hall .. 1 body.
    template: Template  # of the N points
    z_buffer: ZBuffer  # of the body without the limb


@dataclass(frozen=True, slots=True, eq=False)
class LimbContext:
    """A frame made ready to score postures of one limb."""

    pose: Pose
    objective: PoseObjective
    frames: Array  # world_T_segment (16, 4, 4)
    patches: list[Patch]
    coarse: list[_LimbView]
    fine: list[_LimbView]


@dataclass(frozen=True, slots=True, eq=False)
class Postures:
    """Postures of a limb in one frame, and their scores."""

    turns: Array  # (K, 4) as `pzcap.tracking.limbs.turned` takes them
    score_m2: Array  # (K,)
    moved_m: Array  # (K, 2, 3) its joints from where the context has them, in the frame of what it is fixed to


class LimbAppearance:
    """Scores the limbs of one body; without ``similarity`` by silhouettes and keypoints alone."""

    def __init__(self, body: Body, similarity: bool = True, neutral: Array | None = None) -> None:
        self.body = body
        self.weight = APPEARANCE.weight if similarity else 0.0
        # (4,) likeness of each limb (1: as it should be) that is neither like nor unlike
        self.neutral = np.full(len(LIMBS), APPEARANCE.neutral) if neutral is None else neutral
        surface = body.surface

        def skins(stride: int) -> tuple[list[Indices], list[_LimbSkin]]:
            rows_of = [np.flatnonzero(np.isin(surface.segment, limb))[::stride] for limb in LIMBS]
            return rows_of, [
                _LimbSkin(
                    np.ascontiguousarray(surface.points_m[rows]), np.ascontiguousarray(surface.normals[rows]),
                    surface.segment[rows] - limb[0], stride * surface.area_m2[rows],
                )
                for limb, rows in zip(LIMBS, rows_of, strict=True)
            ]  # fmt: skip

        self._rows, self._skins = skins(APPEARANCE.stride)
        self._coarse_rows, self._coarse_skins = skins(APPEARANCE.coarse_stride)
        face_segment = surface.segment[surface.faces[:, 0]]
        self._other_faces = [surface.faces[~np.isin(face_segment, limb)] for limb in LIMBS]

    def calibrated(
        self, poses: Sequence[Pose], objectives: Sequence[PoseObjective], reference: Appearances, sure: Mask
    ) -> LimbAppearance:
        """The same scores with ``neutral`` measured in some frames, whose blur, clothes and codecs make limbs less like
        themselves: halfway between their likeness all over their reach and that where they are ``sure`` to be found,
        (T, 4) of the first T frames."""
        if not self.weight:
            return self
        areas, stride = np.zeros((2, len(LIMBS), 2)), APPEARANCE.calibration_stride
        for t in range(0, len(sure), stride):
            for limb in range(len(LIMBS)):
                context = self.context(limb, poses[t], objectives[t], reference)
                turns = limbs.bounded(limb, context.pose, np.vstack([np.zeros(4), _ELSEWHERE]))
                exposed = limbs.in_views(objectives[t], limb, limbs.posed(self.body, limb, context.pose, turns))
                found, *others = _compared(self._skins[limb], exposed, context.fine)
                areas[0, limb] += sure[t, limb] * found
                areas[1, limb] += np.sum(others, axis=0)
        alike, seen = np.moveaxis(areas, 2, 0)
        elsewhere = alike[1] / np.maximum(seen[1], 1e-9)
        known = seen[0] > APPEARANCE.least_seen_m2
        more = np.where(known, alike[0] / np.maximum(seen[0], 1e-9) - elsewhere, APPEARANCE.usual_more)
        return LimbAppearance(self.body, True, elsewhere + 0.5 * more)

    def similarity(
        self, pose: Pose, objective: PoseObjective, placed: Placed, reference: Appearances, alone: bool = False
    ) -> Array:
        """(4,) of each limb, square metres: what looks like its ``reference`` in each view, less what does not, the
        body being where it was ``placed``; ``alone``: where the limb itself hides nothing."""
        similarity, frames = np.zeros(len(LIMBS)), forward(self.body, pose)
        for limb, segments in enumerate(LIMBS if self.weight else ()):
            where = self._behind(limb, placed) if alone else placed
            views = self._views(self._rows[limb], pose, objective, where, reference, APPEARANCE.fine_level)
            exposed = limbs.in_views(objective, limb, frames[None, list(segments)])
            similarity[limb] = self._similarity(limb, self._skins[limb], exposed, views)[0]
        return similarity

    def score(self, pose: Pose, objective: PoseObjective, reference: Appearances) -> Array:
        """(4,) of each limb, square metres: the silhouettes that it explains, less the hall that it covers
        (`pzcap.tracking.limbs.support`), its similarity, and what the keypoints that agree are worth."""
        placed = objective.place(pose)[1]
        body, hall = support(objective, pose, placed).T
        similarity = self.similarity(pose, objective, placed, reference, alone=True)
        frames = forward(self.body, pose)[None]
        exposed = [limbs.in_views(objective, limb, frames[:, list(segments)]) for limb, segments in enumerate(LIMBS)]
        agree = [self._agreement(limb, objective, each)[0] for limb, each in enumerate(exposed)]
        return np.asarray(body - hall + self.weight * similarity + KEYPOINT.limb_m2 * np.array(agree))

    def _agreement(self, limb: int, objective: PoseObjective, exposed: Sequence[Array]) -> Array:
        """(K,) Number of a limb's keypoints, in all views together, that agree with its postures, ``exposed`` as
        `limbs.in_views` has them."""
        found = np.zeros(len(exposed[0]))
        for view, there in zip(objective.views, exposed, strict=True):
            if view is not None and view.person is not None:
                found += agreement(self.body.landmarks, LIMBS[limb], there, view.camera, view.person)
        return found

    def context(self, limb: int, pose: Pose, objective: PoseObjective, reference: Appearances) -> LimbContext:
        """Make a frame ready to score postures of one limb near that of ``pose``."""
        posed, placed = objective.place(pose)
        behind = self._behind(limb, placed)
        coarse, fine = (
            self._views(rows[limb], pose, objective, behind, reference, level)
            for rows, level in ((self._coarse_rows, APPEARANCE.coarse_level), (self._rows, APPEARANCE.fine_level))
        )
        patches = limbs.patches(self.body, limb, posed.frames, grounds(objective.views, placed))
        return LimbContext(pose, objective, posed.frames, patches, coarse, fine)

    def postures(
        self, limb: int, context: LimbContext, turns: Array, rates: Array | None = None, *, coarse: bool = False
    ) -> Postures:
        """Score a limb turned by ``turns`` (K, 4), in ``coarse`` or in fine images; the rest of the body is where the
        ``context`` has it. It moves at ``rates`` (K, 16, 12); None: as in the context."""
        turns = limbs.bounded(limb, context.pose, turns)
        posed = limbs.posed(self.body, limb, context.pose, turns)
        exposed = limbs.in_views(context.objective, limb, posed, rates)
        body, hall = limbs.judged(self.body, limb, exposed, context.patches).T
        skins, views = (self._coarse_skins, context.coarse) if coarse else (self._skins, context.fine)
        similarity = self._similarity(limb, skins[limb], exposed, views)
        score = body - hall + self.weight * similarity - APPEARANCE.reluctance_m2 * np.sum(turns**2, axis=1)
        score += KEYPOINT.limb_m2 * self._agreement(limb, context.objective, exposed)
        score -= APPEARANCE.limit_m2 * limbs.beyond_limits(limb, context.pose, turns)
        first, *others = LIMBS[limb]
        moved = posed[:, 1:, :3, 3] - context.frames[others, :3, 3]
        return Postures(turns, score, moved @ context.frames[PARENTS[first], :3, :3])

    def _similarity(self, limb: int, skin: _LimbSkin, exposed: Sequence[Array], views: Sequence[_LimbView]) -> Array:
        """(K,) square metres of a limb that look alike, less those that do not, in its postures, ``exposed`` as
        `limbs.in_views` has them."""
        alike, seen = _compared(skin, exposed, views).T
        return np.asarray(alike - self.neutral[limb] * seen)

    def _views(
        self, rows: Indices, pose: Pose, objective: PoseObjective, placed: Placed, reference: Appearances,
        usual_level: int,
    ) -> list[_LimbView]:  # fmt: skip
        found = []
        for number, (view, where, look) in enumerate(zip(objective.views, placed, reference, strict=True)):
            if view is None or where is None:
                continue
            level = view_level(usual_level, px_per_m(view.camera, pose.root_position_m))
            template = Template(look.value[level][rows], look.trust[rows])
            image = view.image_at(level)
            found.append(_LimbView(number, pinhole(view.camera), image, view.belief, template, where.z_buffer))
        return found

    def _behind(self, limb: int, placed: Placed) -> list[PlacedView | None]:
        """The views without the limb: what would hide it elsewhere."""
        bits, found = GROUP[self.body.surface.segment], list(placed)
        for number, where in enumerate(placed):
            if where is not None:
                depth, cover = np.empty_like(where.z_buffer.depth), np.empty_like(where.z_buffer.cover)
                behind = where.z_buffer._replace(depth=depth, cover=cover)
                rasterise(where.skin.pixels, where.skin.depth, self._other_faces[limb], bits, behind)
                found[number] = replace(where, z_buffer=behind)
        return found


def _compared(skin: _LimbSkin, exposed: Sequence[Array], views: Sequence[_LimbView]) -> Array:
    """(K, 2) square metres of a limb that are seen in its postures, ``exposed`` as `limbs.in_views` has them, all views
    together: first as far as they look alike."""
    areas = np.zeros((len(exposed[0]), 2))
    for view in views:
        _compare(np.ascontiguousarray(exposed[view.number]), skin, view, areas)
    return areas


@njit(cache=True, nogil=True, error_model="numpy")
def _compare(posed: Array, skin: _LimbSkin, view: _LimbView, areas: Array) -> None:
    """Add to ``areas`` (K, 2) the area that is seen in one view, first as far as it looks like the template times a
    gain, its own for each segment, and is not surely hall. Hidden points, and such as are seen too obliquely, do not
    count."""
    points, normals, link = skin.points, skin.normals, skin.link
    image, left, top, scale = view.crop
    template, belief, z_buffer = view.template, view.belief, view.z_buffer
    height, width = image.shape
    rows, columns = z_buffer.depth.shape
    value, doubt, weight = np.empty(len(points)), np.empty(len(points)), np.empty(len(points))
    per_px, per_scale, per_cell = scale / VIEW.belief_scale, 1.0 / scale, 1.0 / z_buffer.scale
    least_squared = BRIGHTNESS.learned_facing * BRIGHTNESS.learned_facing
    for k in range(len(posed)):
        first = 0
        while first < len(points):
            last = segment_end(link, first)
            camera = relative_to(posed[k, link[first]], view.camera)
            eye = camera.centre
            product, square = 0.0, 0.0
            for n in range(first, last):
                weight[n] = 0.0
                if template.trust[n] <= 0.0:
                    continue
                px, py, pz = points[n, 0], points[n, 1], points[n, 2]
                dx, dy, dz = eye[0] - px, eye[1] - py, eye[2] - pz
                towards = normals[n, 0] * dx + normals[n, 1] * dy + normals[n, 2] * dz
                away = dx * dx + dy * dy + dz * dz
                if towards <= 0.0 or towards * towards <= least_squared * away:
                    continue
                across, down, depth = ray(px, py, pz, camera)
                if depth < NEAREST_M:
                    continue
                u, v = to_pixel(across, down, camera)
                j = int(np.rint((u - z_buffer.left) * per_cell))
                i = int(np.rint((v - z_buffer.top) * per_cell))
                if 0 <= j < columns and 0 <= i < rows and depth > z_buffer.depth[i, j] + VIEW.depth_tolerance_m:
                    continue
                u, v = (u - left) * per_scale, (v - top) * per_scale
                if u < 1.0 or v < 1.0 or u >= width - 2.0 or v >= height - 2.0:
                    continue
                value[n] = bilinear(image, u, v)
                i, j = min(int(v * per_px), len(belief) - 1), min(int(u * per_px), belief.shape[1] - 1)
                doubt[n] = max(-belief[i, j], 0.0)
                weight[n] = template.trust[n] * skin.area[n] * towards / np.sqrt(away)
                product += weight[n] * value[n] * template.value[n]
                square += weight[n] * template.value[n] * template.value[n]
            if square > 0.0:
                gain = min(max(product / square, APPEARANCE.least_gain), APPEARANCE.largest_gain)
                for n in range(first, last):
                    if weight[n] > 0.0:
                        off = (value[n] - gain * template.value[n]) / APPEARANCE.half_alike
                        areas[k, 0] += weight[n] * (1.0 - doubt[n]) / (1.0 + off * off)
                        areas[k, 1] += weight[n]
            first = last
