"""What the images of one instant say about a pose: silhouettes, appearance and keypoints, as normal equations.

`Evidence` holds the views of one instant (`pzcap.views`) and, for a pose, accumulates the weighted normal equations of
all residuals in the 43 numbers of the pose's tangent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap import landmarks, raster, residuals
from pzcap.body import Body, forward, lift, place, screws
from pzcap.limbs import GROUP, Ground
from pzcap.raster import Float32
from pzcap.shape import ContourRows, Texture
from pzcap.types import SEGMENTS, Array, Pose
from pzcap.views import LEVELS, Z_SCALE, Cut, Observation, PlacedView, place_view

SEGMENT_WIDTH_M = np.array(
    [{"pelvis": 0.3, "lumbar": 0.27, "thorax": 0.3, "head": 0.16, "upper_arm": 0.09, "forearm": 0.07, "hand": 0.05,
      "thigh": 0.15, "shank": 0.1, "foot": 0.08}[n.removeprefix("left_").removeprefix("right_")] for n in SEGMENTS]
)  # fmt: skip


def place_body(body: Body, pose: Pose) -> tuple[Array, Array, Array]:
    """``world_T_segment`` (16, 4, 4), and the skin's points and normals (V, 3) in the world."""
    frames = forward(body, pose)
    points, normals = place(body, frames)
    return frames, points, normals


@dataclass(slots=True, eq=False)
class Appearance:
    """What each point of the skin looked like in one view, per pyramid level, and how far that is to be trusted."""

    value: Float32  # (LEVELS, V)
    trust: Float32  # (V,) 0 unseen .. 1

    @staticmethod
    def unseen(points: int) -> Appearance:
        return Appearance(np.zeros((LEVELS, points), np.float32), np.zeros(points, np.float32))


@dataclass(frozen=True, slots=True)
class Terms:
    """Which residuals count, and how, in one round of iterations."""

    level: int
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
    contour: Array  # (16, 3) squared distances, edges found, edges sought
    brightness: Array  # (16, 2) weighted squares, weights


class Evidence:
    """The views of one instant."""

    def __init__(self, body: Body, cuts: Sequence[Cut | None]) -> None:
        self.body = body
        self.cuts = cuts

    @property
    def detected(self) -> bool:
        """Whether a detector found the body in any view."""
        return any(cut is not None and cut.person is not None for cut in self.cuts)

    def place(self, pose: Pose) -> tuple[Array, Array, Array]:
        """``world_T_segment``, and the skin's points and normals in the world."""
        return place_body(self.body, pose)

    def visibility(self, pose: Pose) -> list[PlacedView | None]:
        """The depth test in every view. It changes slowly with the pose, so it is worth keeping for a few steps."""
        _, points, normals = self.place(pose)
        return [None if c is None else place_view(self.body, points, normals, c.seen.camera) for c in self.cuts]

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
        """Accumulate all residuals at ``pose``, with visibility as ``placed``."""
        frames, hessians, gradients, contour, brightness = self._per_segment(pose, placed, appearances, terms)
        hessian, gradient = lift(hessians, gradients, screws(frames, np.ascontiguousarray(frames[0, :3, 3])))
        return Normal(hessian, gradient, contour, brightness)

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
        return Texture(hessians, gradients)

    def _per_segment(
        self,
        pose: Pose,
        placed: Sequence[PlacedView | None],
        appearances: Sequence[Appearance | None],
        terms: Terms,
    ) -> tuple[Array, Array, Array, Array, Array]:
        """``world_T_segment``; the normal equations (16, 6, 6) and (16, 6) of each segment in its own twist about the
        pelvis joint; and how well each fits, as `Normal` has it."""
        frames, points, normals = self.place(pose)
        centre = np.ascontiguousarray(frames[0, :3, 3])
        hessians, gradients = np.zeros((16, 6, 6)), np.zeros((16, 6))
        contour, brightness = np.zeros((16, 3)), np.zeros((16, 2))
        nuisance = np.full(residuals.NUISANCES, 1.0 / terms.shading_sigma**2)
        for cut, where, appearance in zip(self.cuts, placed, appearances, strict=True):
            if cut is None or where is None:
                continue
            view, camera = cut.seen, cut.seen.camera
            raster.project(
                points, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, where.pixels, where.depth
            )
            scale = float(2**terms.level)
            px_per_m = camera.focal_px / max(float(np.linalg.norm(centre - camera.world_T_cam[:3, 3])), 0.5)
            weight = (SEGMENT_WIDTH_M * px_per_m / scale > 3.0).astype(np.float64)  # too thin to be seen here
            if appearance is not None and terms.brightness_weight > 0:
                residuals.photometric(
                    points, normals, self.body.surface.segment, where.facing, where.pixels, camera.world_T_cam,
                    camera.focal_px, camera.k1, centre, view.grey[terms.level], view.left, view.top, scale,
                    appearance.value[terms.level], appearance.trust, terms.brightness_sigma, nuisance,
                    weight * terms.brightness_weight, hessians, gradients, brightness,
                )  # fmt: skip
            if terms.contour_weight > 0:
                rows, segment, count = self._contour(view, where, points, normals, terms, contour)
                residuals.accumulate(rows, segment, count, centre, hessians, gradients)
            if cut.person is not None and terms.keypoint_weight > 0:
                rows, keypoint = landmarks.residuals(
                    self.body.landmarks, frames, camera, cut.person, terms.keypoint_scale
                )
                rows[:, 0] *= terms.keypoint_weight
                residuals.accumulate(rows, landmarks.SEGMENT[keypoint], len(rows), centre, hessians, gradients)
        return frames, hessians, gradients, contour, brightness

    def contour(self, pose: Pose, placed: Sequence[PlacedView | None], terms: Terms) -> ContourRows:
        """The residuals of the contour alone, one by one."""
        _, points, normals = self.place(pose)
        parts, segments = [np.zeros((0, 8))], [np.zeros(0, np.int64)]
        for cut, where in zip(self.cuts, placed, strict=True):
            if cut is None or where is None:
                continue
            camera = cut.seen.camera
            raster.project(
                points, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, where.pixels, where.depth
            )
            rows, segment, count = self._contour(cut.seen, where, points, normals, terms, np.zeros((16, 3)))
            parts.append(rows[:count])
            segments.append(segment[:count])
        found = np.concatenate(parts)
        return ContourRows(np.concatenate(segments), found[:, 5:], found[:, 2:5], found[:, 1], found[:, 0])

    def _contour(
        self, view: Observation, where: PlacedView, points: Array, normals: Array, terms: Terms, cost: Array
    ) -> tuple[Array, NDArray[np.int64], int]:
        camera, surface = view.camera, self.body.surface
        rows, segment = np.empty((len(surface.edges), 8)), np.empty(len(surface.edges), np.int64)
        count = residuals.contour(
            points, normals, surface.segment, surface.edges, where.depth, camera.world_T_cam, camera.focal_px,
            camera.principal_px, camera.k1, where.z_buffer, where.cover, GROUP, where.z_left, where.z_top, Z_SCALE,
            view.probability, view.left, view.top, terms.reach_px, terms.contour_sigma_px,
            np.full(len(SEGMENTS), terms.contour_weight), rows, segment, cost,
        )  # fmt: skip
        return rows, segment, count

    def learn(self, placed: Sequence[PlacedView | None], appearances: Sequence[Appearance | None], rate: float) -> None:
        """Let the appearance of what is visible adapt by ``rate``; new points are taken as they are."""
        for cut, where, appearance in zip(self.cuts, placed, appearances, strict=True):
            if cut is None or where is None or appearance is None:
                continue
            view = cut.seen
            values = np.empty((LEVELS, len(where.depth)), np.float32)
            for level in range(LEVELS):
                raster.sample(view.grey[level], view.left, view.top, float(2**level), where.pixels, values[level])
            seen = (where.facing > 0.25) & np.all(values >= 0, axis=0)
            fresh = seen & (appearance.trust <= 0)
            step = np.where(fresh, 1.0, np.where(seen, rate, 0.0)).astype(np.float32)
            appearance.value += step * (values - appearance.value)
            appearance.trust = np.where(
                fresh, np.float32(0.3), np.where(seen, np.minimum(appearance.trust + 0.2, 1.0), 0.98 * appearance.trust)
            ).astype(np.float32)
