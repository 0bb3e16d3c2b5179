"""What the images of one instant say about a pose: silhouettes and appearance, as normal equations.

An `Observation` is one view cut out around the body, as a pyramid. `Evidence` holds the views of one instant and, for a
pose, accumulates the weighted normal equations of all residuals in the 43 numbers of the pose's tangent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap import raster, residuals
from pzcap.body import Body, forward, lift, place, screws
from pzcap.foreground import LOG_ODDS_STEPS, ForegroundConfig, refine
from pzcap.foreground import evidence as colour_evidence
from pzcap.limbs import BELIEF_SCALE, GROUP, Ground, ground
from pzcap.shape import ContourRows
from pzcap.types import SEGMENTS, Array, Camera, Image, Pose, Silhouette

Float32 = NDArray[np.float32]

LEVELS = 3
"""Pyramid levels: each halves the one below it."""
DEPTH_TOLERANCE_M = 0.03
_Z_SCALE = 2.0
_SURE = 3.0  # log-odds that count in full

SEGMENT_WIDTH_M = np.array(
    [{"pelvis": 0.3, "lumbar": 0.27, "thorax": 0.3, "head": 0.16, "upper_arm": 0.09, "forearm": 0.07, "hand": 0.05,
      "thigh": 0.15, "shank": 0.1, "foot": 0.08}[n.removeprefix("left_").removeprefix("right_")] for n in SEGMENTS]
)  # fmt: skip


def place_body(body: Body, pose: Pose) -> tuple[Array, Array, Array]:
    """``world_T_segment`` (16, 4, 4), and the skin's points and normals (V, 3) in the world."""
    frames = forward(body, pose)
    points, normals = place(body, frames)
    return frames, points, normals


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One view, cut out around the body. Pixel ``(i, j)`` of level ``l`` stands at ``(left, top) + 2^l (j, i)``."""

    camera: Camera
    left: int
    top: int
    grey: tuple[Float32, ...]  # LEVELS images
    probability: Float32  # (h, w) 0..1 of the finest level


def observe(image: Image, probability: Image, camera: Camera, left: int, top: int) -> Observation:
    """Prepare a cut-out whose top-left pixel stands at ``(left, top)`` of the view."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    levels = [np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 0.7), np.float32)]
    for _ in range(LEVELS - 1):
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), np.float32))
    return Observation(camera, left, top, tuple(levels), _smooth(probability))


def _smooth(probability: Image) -> Float32:
    return np.asarray(cv2.GaussianBlur(probability, (0, 0), 0.7), np.float32) / np.float32(255.0)


@dataclass(slots=True, eq=False)
class Cut:
    """A view cut out around the body: what is kept of it until both directions of time have used it."""

    image: Image  # (h, w, 3)
    background: Image  # (h, w, 3)
    colours: NDArray[np.int8]  # (h, w) of `pzcap.foreground.evidence`
    belief: Float32  # (h / 4, w / 4) of `pzcap.limbs.Ground`
    seen: Observation

    def look_again(self, predicted: PlacedView, config: ForegroundConfig) -> None:
        """Cut the silhouette once more, with the body where it is predicted."""
        seen = self.seen
        height, width = seen.probability.shape
        outline = signed_distance(predicted, seen.left, seen.top, width, height)
        better = _smooth(refine(self.image, self.background, self.colours, outline, config))
        self.seen = Observation(seen.camera, seen.left, seen.top, seen.grey, better)

    def looked(self) -> None:
        """The silhouette will not be cut again: let go what that needs."""
        self.image = self.background = np.zeros((0, 0, 3), np.uint8)
        self.colours = np.zeros((0, 0), np.int8)

    def ground(self, placed: PlacedView) -> Ground:
        """What the limbs are judged by, the body being where it was ``placed``."""
        seen = self.seen
        corner = np.array([seen.left, seen.top]) + 0.5 * (BELIEF_SCALE - 1)
        origin = (corner - [placed.z_left, placed.z_top]) / _Z_SCALE
        shift = np.column_stack([BELIEF_SCALE / _Z_SCALE * np.eye(2), origin])
        return ground(seen.camera, corner, self.belief, placed.cover, shift)


def cut_out(
    body: Body, image: Image, silhouette: Silhouette, camera: Camera, pose: Pose, margin: float,
    config: ForegroundConfig,
) -> Cut | None:  # fmt: skip
    """The part of a view around the body, copied so that the frame itself can be let go. None where it is not seen."""
    window = body_window(body, pose, camera, margin)
    if window is None:
        return None
    left, top, right, bottom = window
    part = np.s_[top:bottom, left:right]
    image, background = image[part].copy(), silhouette.background[part].copy()
    colours = colour_evidence(image, background, camera, left, top, config)
    sure = np.clip(colours.astype(np.float32) / (LOG_ODDS_STEPS * _SURE), -1.0, 1.0)
    small = (colours.shape[1] // BELIEF_SCALE, colours.shape[0] // BELIEF_SCALE)
    sure = sure[: BELIEF_SCALE * small[1], : BELIEF_SCALE * small[0]]
    belief = cv2.resize(sure, small, interpolation=cv2.INTER_AREA)
    return Cut(
        image, background, colours, np.asarray(belief, np.float32),
        observe(image, silhouette.probability[part], camera, left, top),
    )  # fmt: skip


@dataclass(slots=True, eq=False)
class Appearance:
    """What each point of the skin looked like in one view, per pyramid level, and how far that is to be trusted."""

    value: Float32  # (LEVELS, V)
    trust: Float32  # (V,) 0 unseen .. 1

    @staticmethod
    def unseen(points: int) -> Appearance:
        return Appearance(np.zeros((LEVELS, points), np.float32), np.zeros(points, np.float32))


@dataclass(slots=True, eq=False)
class PlacedView:
    """The skin of a posed body in one view."""

    pixels: Array  # (V, 2)
    depth: Array  # (V,)
    facing: Float32  # (V,) cosine to the ray where visible, else 0
    z_buffer: Float32
    cover: NDArray[np.uint8]  # bits of `pzcap.limbs.GROUP`, of all that lies there
    z_left: int
    z_top: int

    @property
    def mask(self) -> NDArray[np.bool_]:
        return np.isfinite(self.z_buffer)


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


@dataclass(slots=True, eq=False)
class Normal:
    """Normal equations of a pose, and how well each segment fits."""

    hessian: Array  # (43, 43)
    gradient: Array  # (43,)
    contour: Array  # (16, 3) squared distances, edges found, edges sought
    brightness: Array  # (16, 2) weighted squares, weights


def place_view(body: Body, points: Array, normals: Array, camera: Camera, scale: float = _Z_SCALE) -> PlacedView:
    """Project the placed skin and test what is visible."""
    pixels, depth = np.empty((len(points), 2)), np.empty(len(points))
    raster.project(points, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, pixels, depth)
    left, top, width, height = _window(pixels, depth, camera, 12)
    z_buffer = np.empty((int(height // scale) + 1, int(width // scale) + 1), np.float32)
    cover = np.empty(z_buffer.shape, np.uint8)
    group = GROUP[body.surface.segment]
    raster.rasterise(pixels, depth, body.surface.faces, group, left, top, scale, z_buffer, cover)
    facing = np.empty(len(points), np.float32)
    raster.visible(
        points, normals, pixels, depth, np.ascontiguousarray(camera.world_T_cam[:3, 3]), z_buffer, left, top, scale,
        DEPTH_TOLERANCE_M, facing,
    )  # fmt: skip
    return PlacedView(pixels, depth, facing, z_buffer, cover, left, top)


def _window(pixels: Array, depth: Array, camera: Camera, margin: int) -> tuple[int, int, int, int]:
    """Left, top, width and height around the points seen; it may stand over the image's edge, but is never huge."""
    box = np.empty(4)
    raster.bounds(pixels, depth, box)
    if box[2] < box[0]:
        return 0, 0, 2, 2
    left, top = max(int(box[0]) - margin, -camera.width), max(int(box[1]) - margin, -camera.height)
    right, bottom = min(int(box[2]) + margin, 2 * camera.width), min(int(box[3]) + margin, 2 * camera.height)
    return left, top, max(right - left, 2), max(bottom - top, 2)


def body_window(body: Body, pose: Pose, camera: Camera, margin: float) -> tuple[int, int, int, int] | None:
    """Part of the view (left, top, right, bottom) that holds the body, and ``margin`` of its size around it; None where
    the body is out of view."""
    points, _ = place(body, forward(body, pose))
    pixels, depth = np.empty((len(points), 2)), np.empty(len(points))
    raster.project(points, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, pixels, depth)
    box = np.empty(4)
    raster.bounds(pixels, depth, box)
    if box[2] < box[0]:
        return None
    low, high = box[:2], box[2:]
    pad = margin * float(np.max(high - low)) + 16
    left, top = (int(v) for v in np.clip(np.floor(low - pad), 0, None))
    right = int(min(np.ceil(high[0] + pad), camera.width))
    bottom = int(min(np.ceil(high[1] + pad), camera.height))
    return (left, top, right, bottom) if right - left >= 32 and bottom - top >= 32 else None


class Evidence:
    """The views of one instant."""

    def __init__(self, body: Body, cuts: Sequence[Cut | None]) -> None:
        self.body = body
        self.cuts = cuts

    def place(self, pose: Pose) -> tuple[Array, Array, Array]:
        """``world_T_segment``, and the skin's points and normals in the world."""
        return place_body(self.body, pose)

    def visibility(self, pose: Pose) -> list[PlacedView | None]:
        """The depth test in every view. It changes slowly with the pose, so it is worth keeping for a few steps."""
        _, points, normals = self.place(pose)
        return [None if c is None else place_view(self.body, points, normals, c.seen.camera) for c in self.cuts]

    def look_again(self, placed: Sequence[PlacedView | None], config: ForegroundConfig) -> None:
        """Cut the silhouettes once more, with the body where it was ``placed``."""
        for cut, where in zip(self.cuts, placed, strict=True):
            if cut is not None and where is not None:
                cut.look_again(where, config)

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
        hessian, gradient = lift(hessians, gradients, screws(frames, centre))
        return Normal(hessian, gradient, contour, brightness)

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
            camera.principal_px, camera.k1, where.z_buffer, where.cover, GROUP, where.z_left, where.z_top, _Z_SCALE,
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


def signed_distance(placed: PlacedView, left: int, top: int, width: int, height: int) -> Float32:
    """Pixels from the outline of the placed body, positive inside, over a window (height, width) of the view."""
    shift = np.array([[_Z_SCALE, 0.0, placed.z_left - left], [0.0, _Z_SCALE, placed.z_top - top]])
    mask = cv2.warpAffine(placed.mask.astype(np.float32), shift, (width, height), flags=cv2.INTER_LINEAR) > 0.5
    inside = mask.astype(np.uint8)
    return np.asarray(
        cv2.distanceTransform(inside, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 3), np.float32
    )
