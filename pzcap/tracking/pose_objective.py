"""What the images of one instant say about a pose: silhouettes, appearance and keypoints, as normal equations.

`PoseObjective` holds the views of one instant (`pzcap.tracking.observation`) and, for a pose, accumulates the weighted
normal equations of all residuals in the 43 numbers of the pose's tangent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.body import landmarks
from pzcap.body.shape_estimation import ContourRows, Texture
from pzcap.body.skeleton import Body, forward, lift, place, screws
from pzcap.limbs.search import GROUP, Ground
from pzcap.limbs.skin_colour_model import LOWER_ARM
from pzcap.tracking import keypoint_residuals, residuals, visibility
from pzcap.tracking.camera_refinement import MarginalisedCamera, eliminate
from pzcap.tracking.observation import LEVELS, Z_SCALE, Cut, Observation, PlacedView, Skin, place_view, project
from pzcap.types import SEGMENTS, Array, Camera, Float32, Image, Pose

SEGMENT_WIDTH_M = np.array(
    [{"pelvis": 0.3, "lumbar": 0.27, "thorax": 0.3, "head": 0.16, "upper_arm": 0.09, "forearm": 0.07, "hand": 0.05,
      "thigh": 0.15, "shank": 0.1, "foot": 0.08}[n.removeprefix("left_").removeprefix("right_")] for n in SEGMENTS]
)  # fmt: skip
BEFORE_BODY_M = np.where(LOWER_ARM, SEGMENT_WIDTH_M, 0.0)
"""(16,) How far an edge is sought of what may lie before the body: further off it is the other side's."""
USUAL_PX_PER_M: Final = 130.0
"""Magnification that the pyramid level of `Terms` is meant for: an athlete 220 pixels tall."""
_THIN_PX: Final = 3.0  # a segment less wide than this is not seen at a pyramid's level
_MISSED_PX2: Final = 25.0  # of an edge that the last round does not find within its reach
_TOO_NEAR_M: Final = 0.5
LEARNING: Final = 0.25  # cosine: of skin that is seen more obliquely nothing is learned


@dataclass(slots=True, eq=False)
class Appearance:
    """What each point of the skin looked like in one view, per pyramid level, and how far that is to be trusted."""

    value: Float32  # (LEVELS, V)
    trust: Float32  # (V,) 0 unseen .. 1

    def copy(self) -> Appearance:
        return Appearance(self.value.copy(), self.trust.copy())

    def with_other(self, other: Appearance) -> Appearance:
        """What both have seen, each by its trust."""
        trust = self.trust + other.trust
        share = np.divide(other.trust, trust, out=np.zeros_like(trust), where=trust > 0.0)
        value = self.value + share * (other.value - self.value)
        return Appearance(value, np.maximum(self.trust, other.trust))

    @staticmethod
    def unseen(points: int) -> Appearance:
        return Appearance(np.zeros((LEVELS, points), np.float32), np.zeros(points, np.float32))


@dataclass(frozen=True, slots=True)
class Terms:
    """Which residuals count, and how, in one round of iterations."""

    level: int  # of the brightness, in a view of `USUAL_PX_PER_M`
    reach_px: float  # how far from the body's contour the silhouette's edge is sought
    contour_sigma_px: float
    brightness_sigma: float  # grey levels; scale of the robust weight
    contour_weight: float  # neighbouring contour points err together: each counts for this much of an independent one
    brightness_weight: float
    shading_sigma: float  # relative change of a limb's brightness that light may explain
    keypoint_weight: float = 0.0  # as that of the contour: a detector errs alike in all views
    keypoint_scale: float = 3.0  # sigmas; of the robust weight


@dataclass(slots=True, eq=False)
class Normal:
    """Normal equations of a pose, and how well each segment fits."""

    hessian: Array  # (43, 43)
    gradient: Array  # (43,)
    contour: Array  # (16, 3) squared distances (px2), edges found, edges sought
    brightness: Array  # (16, 2) weighted squares, weights
    free: list[MarginalisedCamera | None]  # a view each: its camera, which has been eliminated


def misfit_px2(contour: Array, unseen_px2: float) -> Array:
    """Mean squared distance of each segment's outline from the silhouettes (S,), of what `Normal` has as ``contour``
    (S, 3). An edge that is not found counts as far away as it was sought; of a segment without any outline
    ``unseen_px2`` is assumed, with the weight of three edges."""
    squares, found, sought = contour.T
    return np.asarray((squares + _MISSED_PX2 * (sought - found) + 3.0 * unseen_px2) / (sought + 3.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Posed:
    """The body in a pose."""

    pose: Pose
    frames: Array  # world_T_segment (16, 4, 4)
    points: Array  # (V, 3) of the skin, world
    normals: Array  # (V, 3)
    skins: list[Skin | None]  # a view each


class PoseObjective:
    """The views of one instant. Their cameras get better with every pose that is found (`correct`)."""

    def __init__(self, body: Body, cuts: Sequence[Cut | None]) -> None:
        self.body = body
        self.cuts = cuts
        self._placed: _Posed | None = None  # where the body was placed last: residuals are asked for there, too

    @property
    def detected(self) -> bool:
        """Whether a detector found the body in any view."""
        return any(cut is not None and cut.person is not None for cut in self.cuts)

    def visibility(self, pose: Pose) -> list[PlacedView | None]:
        """The depth test in every view. It changes slowly with the pose, so it is worth keeping for a few steps."""
        self._placed = posed = self._posed(pose)
        return [
            None if cut is None or skin is None else place_view(self.body, posed.points, skin, cut.seen.camera)
            for cut, skin in zip(self.cuts, posed.skins, strict=True)
        ]

    def _posed(self, pose: Pose) -> _Posed:
        if self._placed is not None and self._placed.pose is pose:
            return self._placed
        frames = forward(self.body, pose)
        points, normals = place(self.body, frames)
        skins = [None if cut is None else project(points, normals, cut.seen.camera) for cut in self.cuts]
        return _Posed(pose, frames, points, normals, skins)

    def grounds(self, placed: Sequence[PlacedView | None]) -> list[Ground | None]:
        """What the limbs are judged by, the body being where it was ``placed``."""
        return [None if c is None or p is None else c.ground(p) for c, p in zip(self.cuts, placed, strict=True)]

    def normal(
        self,
        pose: Pose,
        placed: Sequence[PlacedView | None],
        appearances: Sequence[Appearance | None],
        terms: Terms,
    ) -> Normal:
        """Accumulate all residuals at ``pose``, with visibility as ``placed``; what the cameras may be off by is
        eliminated (`pzcap.tracking.camera_refinement`)."""
        frames, hessians, gradients, contour, brightness = self._per_segment(pose, placed, appearances, terms)
        centre = np.ascontiguousarray(frames[0, :3, 3])
        twists = screws(frames, centre)
        hessian, gradient = lift(hessians.sum(axis=0), gradients.sum(axis=0), twists)
        free = [
            None
            if cut is None or cut.aim is None
            else eliminate(cut.seen.camera, cut.aim, frames, centre, twists, own, pull, hessian, gradient)
            for cut, own, pull in zip(self.cuts, hessians, gradients, strict=True)
        ]
        return Normal(hessian, gradient, contour, brightness, free)

    def texture(
        self,
        pose: Pose,
        placed: Sequence[PlacedView | None],
        appearances: Sequence[Appearance | None],
        terms: Terms,
    ) -> Texture:
        """The residuals of brightness alone, segment by segment."""
        alone = replace(terms, contour_weight=0.0, keypoint_weight=0.0)
        _, hessians, gradients, _, _ = self._per_segment(pose, placed, appearances, alone)
        return Texture(hessians.sum(axis=0), gradients.sum(axis=0))

    def correct(self, free: Sequence[MarginalisedCamera | None], step: Array) -> None:
        """Correct the camera of each view by what follows from a ``step`` (43,) of the pose."""
        self.cuts = [
            cut if cut is None or one is None else cut.corrected(one.step(step))
            for cut, one in zip(self.cuts, free, strict=True)
        ]
        self._placed = None

    def _per_segment(
        self,
        pose: Pose,
        placed: Sequence[PlacedView | None],
        appearances: Sequence[Appearance | None],
        terms: Terms,
    ) -> tuple[Array, Array, Array, Array, Array]:
        """``world_T_segment``; the normal equations (C, 16, 6, 6) and (C, 16, 6) that each view makes of each segment
        in its own twist about the pelvis joint; and how well each fits, as `Normal` has it."""
        posed = self._posed(pose)
        frames, points, normals = posed.frames, posed.points, posed.normals
        centre = np.ascontiguousarray(frames[0, :3, 3])
        all_hessians, all_gradients = np.zeros((len(self.cuts), 16, 6, 6)), np.zeros((len(self.cuts), 16, 6))
        contour, brightness = np.zeros((16, 3)), np.zeros((16, 2))
        nuisance = np.full(residuals.NUISANCES, 1.0 / terms.shading_sigma**2)
        for cut, where, skin, appearance, hessians, gradients in zip(
            self.cuts, placed, posed.skins, appearances, all_hessians, all_gradients, strict=True
        ):
            if cut is None or where is None or skin is None:
                continue
            view, camera = cut.seen, cut.seen.camera
            magnification = px_per_m(camera, centre)
            if appearance is not None and terms.brightness_weight > 0:
                level = view_level(terms.level, magnification)
                scale = float(2**level)
                thick = (SEGMENT_WIDTH_M * magnification > _THIN_PX * scale).astype(np.float64)
                residuals.photometric(
                    points, normals, self.body.surface.segment, where.facing, skin.pixels, camera.world_T_cam,
                    camera.focal_px, camera.k1, centre, view.grey[level], view.left, view.top, scale,
                    appearance.value[level], appearance.trust, terms.brightness_sigma, nuisance,
                    terms.brightness_weight * thick, hessians, gradients, brightness,
                )  # fmt: skip
            if terms.contour_weight > 0:
                rows, segment, count = self._contour(view, where, skin, points, normals, terms, contour)
                residuals.accumulate(rows, segment, count, centre, hessians, gradients)
            if cut.person is not None and terms.keypoint_weight > 0:
                rows, keypoint = keypoint_residuals.residuals(
                    self.body.landmarks, frames, camera, cut.person, terms.keypoint_scale
                )
                rows[:, 0] *= terms.keypoint_weight
                residuals.accumulate(rows, landmarks.SEGMENT[keypoint], len(rows), centre, hessians, gradients)
        return frames, all_hessians, all_gradients, contour, brightness

    def contour(self, pose: Pose, placed: Sequence[PlacedView | None], terms: Terms) -> ContourRows:
        """The residuals of the contour alone, one by one."""
        posed = self._posed(pose)
        parts, segments = [np.zeros((0, 8))], [np.zeros(0, np.int64)]
        for cut, where, skin in zip(self.cuts, placed, posed.skins, strict=True):
            if cut is None or where is None or skin is None:
                continue
            unused = np.zeros((16, 3))
            rows, segment, count = self._contour(cut.seen, where, skin, posed.points, posed.normals, terms, unused)
            parts.append(rows[:count])
            segments.append(segment[:count])
        found = np.concatenate(parts)
        return ContourRows(np.concatenate(segments), found[:, 5:], found[:, 2:5], found[:, 1], found[:, 0])

    def _contour(
        self, view: Observation, where: PlacedView, skin: Skin, points: Array, normals: Array, terms: Terms, cost: Array
    ) -> tuple[Array, NDArray[np.int64], int]:
        camera, surface = view.camera, self.body.surface
        rows, segment = np.empty((len(surface.edges), 8)), np.empty(len(surface.edges), np.int64)
        count = residuals.contour(
            points, normals, surface.segment, surface.edges, skin.depth, skin.above, camera.world_T_cam,
            camera.focal_px, camera.principal_px, camera.k1, where.z_buffer, where.cover, GROUP, where.z_left,
            where.z_top, Z_SCALE, view.probability, view.arms, BEFORE_BODY_M, view.left, view.top, terms.reach_px,
            terms.contour_sigma_px, terms.contour_weight, rows, segment, cost,
        )  # fmt: skip
        return rows, segment, count

    def learn(self, placed: Sequence[PlacedView | None], appearances: Sequence[Appearance | None], rate: float) -> None:
        """Let the appearance of what is visible adapt by ``rate``; new points are taken as they are."""
        for cut, where, appearance in zip(self.cuts, placed, appearances, strict=True):
            if cut is not None and where is not None and appearance is not None:
                view = cut.seen
                _adapt(
                    view.grey, view.left, view.top, where.skin.pixels, where.facing, rate, appearance.value,
                    appearance.trust,
                )  # fmt: skip


def px_per_m(camera: Camera, point: Array) -> float:
    """How large something at a ``point`` (3,) of the world is seen."""
    return camera.focal_px / max(math.dist(point, camera.world_T_cam[:3, 3]), _TOO_NEAR_M)


def view_level(usual: int, magnification: float) -> int:
    """The pyramid level on which a pose is off by as many pixels as on the ``usual`` one in the usual view: it is off
    by metres."""
    return min(max(usual + round(math.log2(magnification / USUAL_PX_PER_M)), 0), LEVELS - 1)


@njit(cache=True, nogil=True)
def _adapt(
    grey: tuple[Image, ...], left: float, top: float, pixels: Array, facing: Float32, rate: float, value: Float32,
    trust: Float32,
) -> None:  # fmt: skip
    """Move the appearance of all points that face the camera by ``rate`` to what a pyramid has at their ``pixels``."""
    height, width = grey[-1].shape
    coarsest = 2.0 ** (len(grey) - 1)
    for n in range(len(pixels)):
        x, y = pixels[n, 0] - left, pixels[n, 1] - top
        within = 1.0 <= x / coarsest < width - 2.0 and 1.0 <= y / coarsest < height - 2.0
        if facing[n] <= LEARNING or not within:
            trust[n] *= np.float32(0.98)
            continue
        fresh = trust[n] <= 0.0
        scale = 1.0
        for level in range(len(grey)):
            here = visibility.bilinear(grey[level], x * scale, y * scale)
            value[level, n] += (1.0 if fresh else rate) * (here - value[level, n])
            scale *= 0.5
        trust[n] = 0.3 if fresh else min(trust[n] + 0.2, 1.0)
