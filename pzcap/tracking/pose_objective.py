"""Objective of a pose, given the images of one instant: residuals of silhouettes, brightness and keypoints.

`PoseObjective` holds the views of one instant (`pzcap.tracking.observation`) and, for a pose, accumulates the weighted
normal equations of all residuals in the 43 numbers of the pose's tangent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.body import landmarks
from pzcap.body.kinematics import forward, place, screws
from pzcap.body.segment_equations import PointResiduals, SegmentSums, accumulate, lift
from pzcap.body.skeleton import Body
from pzcap.geometry.pinhole import pinhole
from pzcap.tracking import keypoint_residuals, residuals
from pzcap.tracking.camera_refinement import CameraPrior, MarginalisedCamera, eliminate, segment_twists
from pzcap.tracking.drape import MarginalisedDrape, eliminate_drape, expected_drape, segments_twists
from pzcap.tracking.observation import PYRAMID_LEVELS, Placed, PlacedView, ViewCrop, Views, place_view, project
from pzcap.tracking.pixel_time import (
    AT_ONCE,
    ClockEquations,
    clock_equations,
    exposed,
    exposed_frames,
)
from pzcap.tracking.residuals import BrightnessTerms, ContourTerms, Template
from pzcap.tracking.settings import Terms
from pzcap.tracking.skin_appearance import SomeAppearances
from pzcap.tracking.tuning import BRIGHTNESS, CONTOUR, DRAPE, VIEW
from pzcap.tracking.visibility import ProjectedSkin, SkinPoints, hide_behind
from pzcap.types import Array, Camera, Pose


@dataclass(frozen=True, slots=True, eq=False)
class PoseEquations:
    """Normal equations of a pose, and how well each segment fits."""

    hessian: Array  # (43, 43)
    gradient: Array  # (43,)
    contour: Array  # (16, 3) squared distances (px2), edges found, edges sought
    brightness: Array  # (16, 2) weighted squares, weights
    cameras: list[MarginalisedCamera | None]  # a view each: its camera, which has been eliminated
    views: list[SegmentSums]  # a view each: what its residuals say of the segments, the cameras not eliminated
    twists: Array  # (43, 6) of the pose, about the pelvis joint
    drape: MarginalisedDrape | None  # of loose clothes, which has been eliminated

    @property
    def cost(self) -> float:
        """Weighted squares of contour (px2) and brightness (sigmas squared)."""
        return float(self.contour[:, 0].sum() + self.brightness[:, 0].sum())

    def taken(self) -> PoseEquations:
        """The equations once a step has been taken: cameras and drape have come to their best, and only follow."""
        cameras = [None if one is None else one._replace(pull=np.zeros_like(one.pull)) for one in self.cameras]
        drape = None if self.drape is None else replace(self.drape, ahead=np.zeros_like(self.drape.ahead))
        return replace(self, cameras=cameras, drape=drape)


def misfit_px2(contour: Array, unseen_px2: float) -> Array:
    """Mean squared distance (S,) of each segment's contour from the silhouettes, from the ``contour`` (S, 3) of
    `PoseEquations`. An edge that is not found counts as far away as it was sought; of a segment without any contour
    ``unseen_px2`` is assumed, with the weight of three edges."""
    squares, found, sought = contour.T
    return np.asarray((squares + CONTOUR.missed_px2 * (sought - found) + 3.0 * unseen_px2) / (sought + 3.0))


@dataclass(frozen=True, slots=True, eq=False)
class PosedBody:
    """The body in a pose, and its skin in every view, at the time when that was exposed."""

    pose: Pose
    frames: Array  # world_T_segment (16, 4, 4)
    skins: tuple[SkinPoints, ...]  # a view each
    projected: tuple[ProjectedSkin | None, ...]  # a view each

    @property
    def centre(self) -> Array:
        """(3,) the pelvis joint, about which twists are taken."""
        return np.ascontiguousarray(self.frames[0, :3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class PoseObjective:
    """The views of one instant."""

    body: Body
    views: Views
    rates: Array | None = None  # (16, 12) of the segments, as in `pixel_time.rates_between`; None: they are not known
    drape: Array | None = None  # (16, 3) displacement of loose clothes; None: as it is to be expected

    @property
    def detected(self) -> bool:
        """True where a detector found the body in any view."""
        return any(view is not None and view.person is not None for view in self.views)

    def with_cameras(self, cameras: Sequence[MarginalisedCamera | None], step: Array) -> PoseObjective:
        """The objective with the camera of each view corrected by what follows from a ``step`` (43,) of the pose."""
        return replace(self, views=tuple(
            view if view is None or camera is None else view.corrected(camera.step(step))
            for view, camera in zip(self.views, cameras, strict=True)
        ))  # fmt: skip

    def after(self, normal: PoseEquations, step: Array) -> PoseObjective:
        """The objective with cameras and drape as they follow from a ``step`` (43,) of the pose."""
        moved = self.with_cameras(normal.cameras, step)
        if normal.drape is None:
            return moved
        change = normal.drape.step(segments_twists(step, normal.twists))
        return replace(moved, drape=self._drape() + np.clip(change, -DRAPE.most_m, DRAPE.most_m))

    def _drape(self) -> Array:
        return expected_drape(self.body.loose_m, self.rates) if self.drape is None else self.drape

    def with_clocks(self, clock: Array) -> PoseObjective:
        """The objective with the views exposed by ``clock`` (C,), frame periods."""
        return replace(self, views=tuple(
            view if view is None else replace(view, exposure=view.exposure._replace(clock=float(one)))
            for view, one in zip(self.views, clock, strict=True)
        ))  # fmt: skip

    def posed(self, pose: Pose) -> PosedBody:
        """Put the body in a ``pose``."""
        frames = forward(self.body, pose)
        skin = SkinPoints(*place(self.body, frames), self.body.surface.segment)
        if self.body.loose_m.any():
            skin = skin._replace(points=np.asfortranarray(skin.points + self._drape()[skin.segment]))
        skins = tuple(self._exposed(view, skin, frames) for view in self.views)
        views = (
            None if view is None else project(each.points, each.normals, view.camera)
            for view, each in zip(self.views, skins, strict=True)
        )  # fmt: skip
        return PosedBody(pose, frames, skins, tuple(views))

    def _exposed(self, view: ViewCrop | None, skin: SkinPoints, frames: Array) -> SkinPoints:
        """The ``skin`` where it was when the ``view`` was exposed."""
        if view is None or self.rates is None or view.exposure == AT_ONCE:
            return skin
        return skin._replace(points=exposed(skin, frames, self.rates, view.camera, view.exposure))

    def visibility(self, posed: PosedBody) -> list[PlacedView | None]:
        """The depth test in every view. It changes slowly with the pose, so it is worth keeping for a few steps."""
        placed = [
            None if view is None or skin is None else place_view(self.body, own.points, skin, view.camera)
            for view, own, skin in zip(self.views, posed.skins, posed.projected, strict=True)
        ]
        for view, where in zip(self.views, placed, strict=True):
            if view is not None and where is not None and view.others.size:
                hide_behind(view.others, where.skin, view.left, view.top, where.facing)
        return placed

    def place(self, pose: Pose) -> tuple[PosedBody, list[PlacedView | None]]:
        """Put the body in a ``pose``, and test its visibility."""
        posed = self.posed(pose)
        return posed, self.visibility(posed)

    def normal(self, posed: PosedBody, placed: Placed, appearances: SomeAppearances, terms: Terms) -> PoseEquations:
        """Accumulate all residuals of the ``posed`` body, with visibility as ``placed``; the errors of the cameras are
        eliminated (`pzcap.tracking.camera_refinement`)."""
        sums, contour, brightness = self._per_segment(posed, placed, appearances, terms)
        twists = screws(posed.frames, posed.centre)
        drape, every = None, sums
        if self.body.loose_m.any():
            expected = expected_drape(self.body.loose_m, self.rates)
            sums, of_drape, drape = eliminate_drape(sums, self.body.loose_m, self._drape(), expected)
            every = [*sums, of_drape]
        hessian, gradient = lift(sum_of(every), twists)
        cameras: list[MarginalisedCamera | None] = []
        for view, own in zip(self.views, sums, strict=True):
            if view is None or view.camera_prior is None:
                cameras.append(None)
                continue
            known = view.camera_prior.information, view.camera_prior.correction
            moves = camera_moves(view, view.camera_prior, posed)
            cameras.append(eliminate(own, moves, *known, twists, hessian, gradient))
        return PoseEquations(hessian, gradient, contour, brightness, cameras, sums, twists, drape)

    def clocks(self, posed: PosedBody, normal: PoseEquations) -> list[ClockEquations | None]:
        """Equations of each view's clock, from those of the ``posed`` body; None where its velocity is not known."""
        found: list[ClockEquations | None] = []
        for view, own, camera in zip(self.views, normal.views, normal.cameras, strict=True):
            if view is None or self.rates is None:
                found.append(None)
                continue
            eliminated = None
            if camera is not None and view.camera_prior is not None:
                eliminated = camera, camera_moves(view, view.camera_prior, posed)
            after = view.exposure.clock + view.exposure.late
            velocity = self.rates[:, :6] + after * self.rates[:, 6:]
            found.append(clock_equations(own, velocity, posed.frames, normal.twists, eliminated))
        return found

    def texture(self, posed: PosedBody, placed: Placed, appearances: SomeAppearances, terms: Terms) -> SegmentSums:
        """The residuals of brightness alone, segment by segment."""
        alone = replace(terms, contour_weight=0.0, keypoint_weight=0.0)
        return sum_of(self._per_segment(posed, placed, appearances, alone)[0])

    def _per_segment(
        self, posed: PosedBody, placed: Placed, appearances: SomeAppearances, terms: Terms
    ) -> tuple[list[SegmentSums], Array, Array]:
        """The normal equations that each view makes of each segment, and how well each fits, as `PoseEquations` has
        it."""
        contour, brightness = np.zeros((16, 3)), np.zeros((16, 2))
        every = [SegmentSums.zero(posed.centre) for _ in self.views]
        for view, where, skin, seen, appearance, sums in zip(
            self.views, placed, posed.skins, posed.projected, appearances, every, strict=True
        ):
            if view is None or where is None or seen is None:
                continue
            if appearance is not None and terms.brightness_weight > 0:
                magnification = px_per_m(view.camera, posed.centre)
                level = view_level(terms.level, magnification)
                image, template = view.image_at(level), Template(appearance.value[level], appearance.trust)
                thick = (residuals.SEGMENT_WIDTH_M * magnification > BRIGHTNESS.thinnest_px * image.scale).astype(float)
                weights = 1.0 / terms.shading_sigma**2, terms.brightness_weight * thick
                residuals.photometric(
                    skin, seen.pixels, where.facing, pinhole(view.camera), image, template,
                    BrightnessTerms(terms.brightness_sigma, *weights), sums, brightness,
                )  # fmt: skip
            if terms.contour_weight > 0:
                rows, segment = self._contour(view, where, skin, seen, terms, contour)
                accumulate(rows, segment, sums)
            if view.person is not None and terms.keypoint_weight > 0:
                rows, keypoint = keypoint_residuals.residuals(
                    self.body.landmarks, exposed_frames(posed.frames, self.rates, view.camera, view.exposure),
                    view.camera, view.person, terms.keypoint_scale,
                )  # fmt: skip
                rows[:, 0] *= terms.keypoint_weight
                accumulate(rows, landmarks.SEGMENT[keypoint], sums)
        return every, contour, brightness

    def contour(self, posed: PosedBody, placed: Placed, terms: Terms) -> PointResiduals:
        """The residuals of the contour alone, one by one, each owned by a segment."""
        found = [PointResiduals.empty(0)]
        for view, where, skin, seen in zip(self.views, placed, posed.skins, posed.projected, strict=True):
            if view is not None and where is not None and seen is not None:
                found.append(self._contour(view, where, skin, seen, terms, np.zeros((16, 3))))
        rows, segment = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return PointResiduals(rows, segment)

    def _contour(
        self, view: ViewCrop, where: PlacedView, skin: SkinPoints, seen: ProjectedSkin, terms: Terms, cost: Array
    ) -> PointResiduals:
        edges, camera = self.body.surface.edges, pinhole(view.camera)
        found = PointResiduals.empty(len(edges))
        sought = ContourTerms(terms.reach_px, terms.contour_sigma_px, terms.contour_weight)
        count = residuals.contour(skin, edges, seen, camera, where.z_buffer, view.outlines, sought, found, cost)
        return found.first(count)


def camera_moves(view: ViewCrop, prior: CameraPrior, posed: PosedBody) -> Array:
    """Pan and zoom of a view's camera as motions of the segments of the ``posed`` body."""
    return segment_twists(view.camera.world_T_cam, prior.pan_axis, posed.frames, posed.centre)


def sum_of(sums: Sequence[SegmentSums]) -> SegmentSums:
    """The normal equations of all views together."""
    hessians, gradients = (np.sum([each[k] for each in sums], axis=0) for k in range(2))
    return SegmentSums(hessians, gradients, sums[0].centre)


def px_per_m(camera: Camera, point: Array) -> float:
    """Magnification of what is at a ``point`` (3,) of the world."""
    return camera.focal_px / max(math.dist(point, camera.world_T_cam[:3, 3]), VIEW.nearest_m)


def view_level(usual: int, magnification: float) -> int:
    """The pyramid level on which a pose is off by as many pixels as on the ``usual`` one in the usual view: it is off
    by metres."""
    return min(max(usual + round(math.log2(magnification / VIEW.usual_px_per_m)), 0), PYRAMID_LEVELS - 1)
