"""Views cut out around the body, and where its skin stands in them: what is kept of the footage while it is tracked.

An `Observation` is what the residuals look at, as a pyramid; a `Cut` is that and what limbs are judged by; a
`PlacedView` is the skin of a posed body, projected and tested for what is visible.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.body.skeleton import Body, forward, place
from pzcap.io.detections import NOBODY
from pzcap.limbs.search import BELIEF_SCALE, GROUP, Ground, ground
from pzcap.limbs.skin_colour_model import SkinColourModel
from pzcap.localisation.panorama_sampler import Window
from pzcap.segmentation.foreground import Expected
from pzcap.tracking import keypoint_residuals, visibility
from pzcap.tracking.camera_refinement import CameraPrior, corrected
from pzcap.tracking.keypoint_residuals import in_world
from pzcap.types import Array, Camera, Float32, Image, Pose, Silhouette

LEVELS = 4
"""Pyramid levels: each halves the one below it."""
DEPTH_TOLERANCE_M = 0.03
Z_SCALE = 2.0
"""Pixels of a view that one of a z-buffer is wide."""
_SURE = 3.0  # log-odds that count in full


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One view, cut out around the body. Pixel ``(i, j)`` of level ``l`` stands at ``(left, top) + 2^l (j, i)``."""

    camera: Camera
    left: int
    top: int
    grey: tuple[Image, ...]  # LEVELS images
    probability: Image  # (h, w) 0..255 of the finest level: that it is the athlete
    arms: Image  # (h, w) 0..255 that it is one of her lower arms, as `pzcap.limbs.skin_colour_model` has it


def observe(image: Image, probability: Image, arms: Image, camera: Camera, left: int, top: int) -> Observation:
    """Prepare a cut-out whose top-left pixel stands at ``(left, top)`` of the view."""
    levels = [_smooth(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8))]
    for _ in range(LEVELS - 1):
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), np.uint8))
    return Observation(camera, left, top, tuple(levels), _smooth(probability), arms)


def _smooth(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A view cut out around the body: what is kept of it until both directions of time have used it."""

    seen: Observation
    belief: Float32  # (h / 4, w / 4) of `pzcap.limbs.search.Ground`
    person: Array | None = None  # (26, 3) what a detector found of the body, as in `pzcap.io.detections`
    aim: CameraPrior | None = None  # how well the camera is known; None: as if it could not be better

    def corrected(self, step: Array) -> Cut:
        """The same, its camera corrected by a ``step`` (2,) of pan and log focal."""
        if self.aim is None:
            return self
        camera, aim = corrected(self.seen.camera, self.aim, step)
        return replace(self, seen=replace(self.seen, camera=camera), aim=aim)

    def ground(self, placed: PlacedView) -> Ground:
        """What the limbs are judged by, the body being where it was ``placed``."""
        seen = self.seen
        corner = np.array([seen.left, seen.top]) + 0.5 * (BELIEF_SCALE - 1)
        origin = (corner - [placed.z_left, placed.z_top]) / Z_SCALE
        shift = np.column_stack([BELIEF_SCALE / Z_SCALE * np.eye(2), origin])
        return ground(seen.camera, corner, self.belief, seen.arms, placed.cover, shift)


def cut_out(
    body: Body, image: Image, silhouette: Silhouette, camera: Camera, pose: Pose, margin: float,
    complexion: SkinColourModel, people: Array = NOBODY, aim: CameraPrior | None = None,
) -> Cut | None:  # fmt: skip
    """The part of a view around the body, copied so that the frame itself can be let go. None where it is not seen.

    Of the ``people`` that a detector found, the one nearest to the ``pose`` is the athlete.
    """
    frames = forward(body, pose)
    window = _around(place(body, frames)[0], camera, margin)
    if window is None:
        return None
    left, top, right, bottom = window
    part = np.s_[top:bottom, left:right]
    sure = np.clip(silhouette.evidence[top // 2 : bottom // 2, left // 2 : right // 2] / _SURE, -1.0, 1.0)
    size = ((right - left) // BELIEF_SCALE, (bottom - top) // BELIEF_SCALE)
    belief = cv2.resize(sure, size, interpolation=cv2.INTER_AREA)
    here, probability = image[part], silhouette.probability[part]
    seen = observe(here, probability, complexion.arms(here, probability), camera, left, top)
    person = keypoint_residuals.nearest(in_world(body.landmarks, frames), camera, people) if len(people) else None
    return Cut(seen, np.asarray(belief, np.float32), person, aim)


def expect(body: Body, pose: Pose, sigma_m: float, camera: Camera, margin: float) -> Expected | None:
    """What a silhouette is told of a pose that is expected, its joints to within ``sigma_m``. None where the body is
    out of view."""
    points, normals = place(body, forward(body, pose))
    window = _around(points, camera, margin)
    if window is None:
        return None
    left, top, right, bottom = window
    placed = place_view(body, points, project(points, normals, camera), camera)
    # pixels of the z-buffer to half pixels of the window, whose centres lie between its pixels
    origin = (np.array([left, top]) + 0.5 - [placed.z_left, placed.z_top]) / Z_SCALE
    shift = np.column_stack([np.eye(2), origin])
    size = ((right - left) // 2, (bottom - top) // 2)
    linear = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    inside = (cv2.warpAffine(placed.mask.astype(np.float32), shift, size, flags=linear) > 0.5).astype(np.uint8)
    apart = cv2.distanceTransform(inside, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 3)
    sigma_px = sigma_m * camera.focal_px / float(np.mean(placed.skin.depth[placed.skin.depth > 0.0]))
    return Expected(left, top, np.asarray(Z_SCALE * apart, np.float32), sigma_px)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """The skin of a posed body from one camera, seen or not."""

    pixels: Array  # (V, 2) a coordinate after the other in memory
    depth: Array  # (V,) -1 behind the camera
    above: Array  # (V,) metres that the camera stands above the skin's tangent: negative where the skin faces away


def project(points: Array, normals: Array, camera: Camera) -> Skin:
    """Where placed skin (V, 3), as `pzcap.body.skeleton.place` has it, stands in a view."""
    skin = Skin(np.empty((len(points), 2), order="F"), np.empty(len(points)), np.empty(len(points)))
    pose = camera.world_T_cam
    visibility.project(points, pose, camera.focal_px, camera.principal_px, camera.k1, skin.pixels, skin.depth)
    visibility.above(points, normals, pose, skin.above)
    return skin


@dataclass(frozen=True, slots=True, eq=False)
class PlacedView:
    """What of a posed body is visible in one view."""

    skin: Skin
    facing: Float32  # (V,) cosine to the ray where visible, else 0
    z_buffer: Float32
    cover: NDArray[np.uint8]  # bits of `pzcap.limbs.search.GROUP`, of all that lies there
    z_left: int
    z_top: int

    @property
    def mask(self) -> NDArray[np.bool_]:
        return np.isfinite(self.z_buffer)


def place_view(body: Body, points: Array, skin: Skin, camera: Camera) -> PlacedView:
    """Test what is visible of placed skin (V, 3), as ``skin`` in the view."""
    scale = Z_SCALE
    left, top, width, height = _window(skin, camera, 12)
    z_buffer = np.empty((int(height // scale) + 1, int(width // scale) + 1), np.float32)
    cover, facing = np.empty(z_buffer.shape, np.uint8), np.empty(len(points), np.float32)
    surface = body.surface
    visibility.rasterise(
        skin.pixels, skin.depth, surface.faces, surface.segment, GROUP, left, top, scale, z_buffer, cover
    )
    visibility.visible(
        points, skin.above, skin.pixels, skin.depth, camera.world_T_cam, z_buffer, left, top, scale, DEPTH_TOLERANCE_M,
        facing,
    )  # fmt: skip
    return PlacedView(skin, facing, z_buffer, cover, left, top)


def _window(skin: Skin, camera: Camera, margin: int) -> tuple[int, int, int, int]:
    """Left, top, width and height around the points seen; it may stand over the image's edge, but is never huge."""
    box = np.empty(4)
    visibility.bounds(skin.pixels, skin.depth, box)
    if box[2] < box[0]:
        return 0, 0, 2, 2
    left, top = max(int(box[0]) - margin, -camera.width), max(int(box[1]) - margin, -camera.height)
    right, bottom = min(int(box[2]) + margin, 2 * camera.width), min(int(box[3]) + margin, 2 * camera.height)
    return left, top, max(right - left, 2), max(bottom - top, 2)


def _around(points: Array, camera: Camera, margin: float) -> Window | None:
    """Part of the view that holds the skin's points (V, 3), and ``margin`` of its size around them, of whole pixels of
    a belief; None where the skin is out of view."""
    pixels, depth = np.empty((len(points), 2), order="F"), np.empty(len(points))
    visibility.project(points, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, pixels, depth)
    box = np.empty(4)
    visibility.bounds(pixels, depth, box)
    if box[2] < box[0]:
        return None
    low, high = box[:2], box[2:]
    pad = margin * float(np.max(high - low)) + 16
    left, top = (int(v) // 2 * 2 for v in np.clip(np.floor(low - pad), 0, None))
    right = left + (int(min(np.ceil(high[0] + pad), camera.width)) - left) // BELIEF_SCALE * BELIEF_SCALE
    bottom = top + (int(min(np.ceil(high[1] + pad), camera.height)) - top) // BELIEF_SCALE * BELIEF_SCALE
    return (left, top, right, bottom) if right - left >= 32 and bottom - top >= 32 else None
