"""Views cut out around the body, and the body's skin in them: what is kept of the footage while it is tracked.

A `ViewInput` is a camera's frame as it comes; a `ViewCrop` is the part of it around the body, as the residuals take it;
a `PlacedView` is the skin of a posed body, projected and tested for visibility.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import cv2
import numpy as np

from pzcap.body.kinematics import forward, place
from pzcap.body.skeleton import Body
from pzcap.geometry.pinhole import pinhole, projected
from pzcap.io.detections import NOBODY
from pzcap.localisation.panorama_sampler import Window
from pzcap.segmentation.expected import Expected
from pzcap.segmentation.others import other_people
from pzcap.tracking import keypoint_residuals, visibility
from pzcap.tracking.camera_refinement import CameraPrior, corrected
from pzcap.tracking.pixel_time import AT_ONCE, Exposure
from pzcap.tracking.residuals import CropImage, Outlines
from pzcap.tracking.skin_colour_model import SkinColourModel
from pzcap.tracking.tuning import VIEW
from pzcap.tracking.visibility import GROUP, ProjectedSkin, ZBuffer, empty_z_buffer
from pzcap.types import Array, Camera, Float32, Image, Mask, Pose, Silhouette

PYRAMID_LEVELS: Final = 4  # each halves the one below it


@dataclass(frozen=True, slots=True, eq=False)
class ViewInput:
    """One camera's part of an instant."""

    image: Image  # (H, W, 3)
    camera: Camera
    silhouette: Silhouette
    people: Array = field(default_factory=lambda: NOBODY)  # (P, 26, 3) a detector's, as in `pzcap.io.detections`
    camera_prior: CameraPrior | None = None  # None: the camera is not to be corrected
    exposure: Exposure = AT_ONCE


@dataclass(frozen=True, slots=True, eq=False)
class ViewCrop:
    """A view cut out around the body. Pixel ``(i, j)`` of level ``l`` stands at ``(left, top) + 2^l (j, i)``."""

    camera: Camera
    left: int
    top: int
    pyramid: tuple[Image, ...]  # PYRAMID_LEVELS grey images
    probability: Image  # (h, w) 0..255 of the finest level: that it is the athlete
    arms: Image  # (h, w) 0..255 that it is one of the lower arms, as `pzcap.tracking.skin_colour_model` has it
    belief: Float32  # (h / 4, w / 4) -1 hall .. 1 body, of `ViewTuning.belief_scale`
    others: Image  # (h / 2, w / 2) where somebody else is, as in `pzcap.segmentation.others`; or (0, 0): nobody is
    undivided: Float32  # (h / 2, w / 2) log-odds of people, where it was not known who is the athlete; or (0, 0)
    person: Array | None = None  # (26, 3) what a detector found of the body, as in `pzcap.io.detections`
    camera_prior: CameraPrior | None = None  # None: the camera is not to be corrected
    exposure: Exposure = AT_ONCE

    def image_at(self, level: int) -> CropImage:
        """The grey image of a pyramid level."""
        return CropImage(self.pyramid[level], float(self.left), float(self.top), 2.0**level)

    @property
    def silhouette(self) -> CropImage:
        """The probability that it is the athlete."""
        return CropImage(self.probability, float(self.left), float(self.top), 1.0)

    @property
    def outlines(self) -> Outlines:
        """Pictures that its edges are sought in."""
        return Outlines(self.silhouette, self.arms, self.others)

    def corrected(self, step: Array) -> ViewCrop:
        """The same, its camera corrected by a ``step`` (2,) of pan and log focal."""
        if self.camera_prior is None:
            return self
        camera, prior = corrected(self.camera, self.camera_prior, step)
        return replace(self, camera=camera, camera_prior=prior)


def prepare(
    image: Image, probability: Image, arms: Image, belief: Float32, camera: Camera, corner: tuple[int, int]
) -> ViewCrop:
    """Make a crop, whose top-left pixel stands at ``corner`` of the view, from its ``image`` (h, w, 3) and what
    `ViewCrop` has of it. The arrays are read-only."""
    levels = [_smooth(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8))]
    for _ in range(PYRAMID_LEVELS - 1):
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), np.uint8))
    nobody = np.zeros((0, 0), np.uint8)
    nothing = np.zeros((0, 0), np.float32)
    crop = ViewCrop(camera, *corner, tuple(levels), _smooth(probability), arms, belief, nobody, nothing)
    for each in (*crop.pyramid, crop.probability, crop.arms):
        each.setflags(write=False)
    crop.belief.setflags(write=False)
    return crop


def _smooth(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.uint8)


def _belief(evidence: Float32, skin: Image) -> Float32:
    """The belief of a crop, from its ``evidence`` (h / 2, w / 2), log-odds, and the probability (h, w), 0..255, of the
    colours of ``skin``. Where it has those, it is no sure hall: an arm may be before wood."""
    size = skin.shape[1] // VIEW.belief_scale, skin.shape[0] // VIEW.belief_scale
    odds = np.clip(evidence / VIEW.full_log_odds, -1.0, 1.0)
    belief = cv2.resize(odds, size, interpolation=cv2.INTER_AREA)
    bare = cv2.resize(skin, size, interpolation=cv2.INTER_AREA) / 127.5 - 1.0
    return np.asarray(np.where(belief < 0.0, belief * (1.0 - np.maximum(bare, 0.0)), belief), np.float32)


def crop_view(
    body: Body, view: ViewInput, pose: Pose, margin: float, skin_colours: SkinColourModel, lost: bool = False
) -> ViewCrop | None:
    """The part of a view around the body, copied so that the frame itself can be let go. None where it is not seen.

    Of the people that a detector found, the one nearest to the ``pose`` is the athlete. Where the athlete is ``lost``,
    the view was cut out by `anywhere`, and `divided` is for whoever knows better.
    """
    frames, camera, silhouette = forward(body, pose), view.camera, view.silhouette
    window = _around(place(body, frames)[0], camera, margin)
    if window is None:
        return None
    left, top, right, bottom = window
    part = np.s_[top:bottom, left:right]
    image, probability = view.image[part], silhouette.probability[part]
    skin = skin_colours.arms(image, np.full_like(probability, 255))
    belief = _belief(silhouette.evidence[top // 2 : bottom // 2, left // 2 : right // 2], skin)
    others = silhouette.others[top // 2 : bottom // 2, left // 2 : right // 2].copy()
    hers = probability
    if others.any():
        hers = np.where(others.repeat(2, axis=0).repeat(2, axis=1) > 0, np.uint8(0), probability)
    crop = prepare(image, probability, skin_colours.arms(image, hers), belief, camera, (left, top))
    person = keypoint_residuals.nearest(keypoint_residuals.in_world(body.landmarks, frames), camera, view.people)
    others = others if others.any() else crop.others
    undivided = silhouette.evidence[top // 2 : bottom // 2, left // 2 : right // 2].copy() if lost else crop.undivided
    return replace(
        crop, others=others, undivided=undivided, person=person, camera_prior=view.camera_prior, exposure=view.exposure
    )


def divided(body: Body, view: ViewCrop, pose: Pose, sigma_m: float) -> ViewCrop:
    """The view of somebody who was lost, with the others told from the athlete by an expected ``pose``, as in
    `expect`."""
    if not view.undivided.size:
        return view
    height, width = view.undivided.shape
    window = view.left, view.top, view.left + 2 * width, view.top + 2 * height
    distance_px, sigma_px = _outline(body, place(body, forward(body, pose)), sigma_m, view.camera, window)
    others = other_people(view.undivided, distance_px, sigma_px)
    if not others.any():
        return view
    size = view.belief.shape[::-1]
    told = cv2.resize(1.0 - others.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return replace(view, others=others, belief=np.asarray(view.belief * told, np.float32))


def expect(body: Body, pose: Pose, sigma_m: float, camera: Camera, margin: float) -> Expected | None:
    """Prior of the silhouette from an expected ``pose``, its joints known to ``sigma_m``. None where the body is out of
    view."""
    placed = place(body, forward(body, pose))
    window = _around(placed[0], camera, margin)
    if window is None:
        return None
    return Expected(*window[:2], *_outline(body, placed, sigma_m, camera, window), pose.root_position_m)


def anywhere(body: Body, pose: Pose, camera: Camera, margin: float) -> Expected | None:
    """The part of a view around a body that is lost, in which anybody may be the athlete."""
    window = _around(place(body, forward(body, pose))[0], camera, margin)
    if window is None:
        return None
    left, top, right, bottom = window
    return Expected(left, top, np.ones(((bottom - top) // 2, (right - left) // 2), np.float32), VIEW.anywhere_px)


def _outline(
    body: Body, skin: tuple[Array, Array], sigma_m: float, camera: Camera, window: Window
) -> tuple[Float32, float]:
    """Distance (h, w), pixels, of the half pixels of a ``window`` from the outline of the placed ``skin``, positive
    inside; and its standard deviation."""
    left, top, right, bottom = window
    placed = place_view(body, skin[0], project(*skin, camera), camera)
    buffer = placed.z_buffer
    # pixels of the z-buffer to half pixels of the window, whose centres lie between its pixels
    origin = (np.array([left, top]) + 0.5 - [buffer.left, buffer.top]) / buffer.scale
    shift = np.column_stack([np.eye(2), origin])
    size = ((right - left) // 2, (bottom - top) // 2)
    linear = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    inside = (cv2.warpAffine(placed.mask.astype(np.float32), shift, size, flags=linear) > 0.5).astype(np.uint8)
    apart = cv2.distanceTransform(inside, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 3)
    depth = placed.skin.depth[placed.skin.depth > 0.0]
    sigma_px = sigma_m * camera.focal_px / float(np.mean(depth)) if len(depth) else VIEW.anywhere_px
    return np.asarray(buffer.scale * apart, np.float32), sigma_px


@dataclass(frozen=True, slots=True, eq=False)
class PlacedView:
    """The skin of a posed body in one view, and what of it is visible."""

    skin: ProjectedSkin
    facing: Float32  # (V,) cosine to the ray where visible, else 0
    z_buffer: ZBuffer  # its bits are of `pzcap.tracking.visibility.GROUP`

    @property
    def mask(self) -> Mask:
        """Pixels of the z-buffer that the body covers."""
        return np.isfinite(self.z_buffer.depth)


Views = Sequence[ViewCrop | None]  # one instant, a crop a camera; None where it has none
Placed = Sequence[PlacedView | None]  # the body in each view, as its visibility was tested


def project(points: Array, normals: Array, camera: Camera) -> ProjectedSkin:
    """Placed skin (V, 3), as `pzcap.body.kinematics.place` has it, in a view."""
    skin = ProjectedSkin(*projected(points, camera), np.empty(len(points)))
    visibility.camera_above(points, normals, pinhole(camera).centre, skin.above)
    return skin


def place_view(body: Body, points: Array, skin: ProjectedSkin, camera: Camera) -> PlacedView:
    """Test which of the placed skin's ``points`` (V, 3), in the view as ``skin`` has them, are visible."""
    z_buffer, facing = empty_z_buffer(_window(skin, camera, 12), VIEW.z_scale), np.empty(len(points), np.float32)
    visibility.rasterise(skin.pixels, skin.depth, body.surface.faces, GROUP[body.surface.segment], z_buffer)
    visibility.visible(points, skin, pinhole(camera).centre, z_buffer, VIEW.depth_tolerance_m, facing)
    return PlacedView(skin, facing, z_buffer)


def _window(skin: ProjectedSkin, camera: Camera, margin: int) -> tuple[int, int, int, int]:
    """Left, top, width and height around the points seen; it may stand over the image's edge, but is never huge."""
    box = visibility.bounds(skin.pixels, skin.depth)
    if box is None:
        return 0, 0, 2, 2
    size = np.array([camera.width, camera.height])
    left, top = np.maximum(box[0].astype(int) - margin, -size).tolist()
    right, bottom = np.minimum(box[1].astype(int) + margin, 2 * size).tolist()
    return left, top, max(right - left, 2), max(bottom - top, 2)


def _around(points: Array, camera: Camera, margin: float) -> Window | None:
    """Part of the view that holds the skin's points (V, 3), and ``margin`` of its size around them, of whole pixels of
    a belief; None where the skin is out of view."""
    box = visibility.bounds(*projected(points, camera))
    if box is None:
        return None
    low, high = box
    pad, scale = margin * float(np.max(high - low)) + 16, VIEW.belief_scale
    left, top = (int(v) // 2 * 2 for v in np.clip(np.floor(low - pad), 0, None))
    right = left + (int(min(np.ceil(high[0] + pad), camera.width)) - left) // scale * scale
    bottom = top + (int(min(np.ceil(high[1] + pad), camera.height)) - top) // scale * scale
    return (left, top, right, bottom) if right - left >= 32 and bottom - top >= 32 else None
