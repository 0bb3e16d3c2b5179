"""Drawing, whatever draws it: colours, stick figures, and the borders of frames on a panorama."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.types import PARENTS, SEGMENTS, Array, Camera, Image, Panorama, PanZoomCamera, PanZoomTrack

Colour = tuple[int, int, int]
CAMERA_COLOURS: Final[tuple[Colour, ...]] = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167))
TRUTH_COLOUR: Final[Colour] = (235, 235, 235)
KEYFRAME_COLOUR: Final[Colour] = (235, 64, 52)
SKIN_COLOUR: Final[Colour] = (214, 182, 140)
OUTLINE_COLOUR: Final[Colour] = (255, 80, 190)
KEYPOINT_COLOUR: Final[Colour] = (120, 255, 120)
LEFT_COLOUR: Final[Colour] = (80, 200, 255)
RIGHT_COLOUR: Final[Colour] = (255, 176, 56)
TRUNK_COLOUR: Final[Colour] = (250, 240, 130)

TIPS: Final[tuple[tuple[int, tuple[float, float, float]], ...]] = (
    (3, (0.02, 0.0, 0.27)), (6, (0.0, 0.0, -0.18)), (9, (0.0, 0.0, -0.18)), (12, (0.19, 0.0, -0.07)),
    (15, (0.19, 0.0, -0.07)),
)  # fmt: skip
"""Segments that end in no joint, and about where they end: a figure without head, hands and feet is hard to read."""
BONES: Final = (*((PARENTS[i], i) for i in range(1, 16)), *((joint, 16 + k) for k, (joint, _) in enumerate(TIPS)))
"""Pairs of points of a figure (`figures`) that are joined by a line."""
BONE_COLOURS: Final = tuple(
    LEFT_COLOUR if SEGMENTS[near if far > 15 else far].startswith("left")
    else RIGHT_COLOUR if SEGMENTS[near if far > 15 else far].startswith("right") else TRUNK_COLOUR
    for near, far in BONES
)  # fmt: skip


def figures(joints_m: Array, rotations: Array) -> Array:
    """Joints (F, 16, 3) and TIPS, for rotations (F, 16, 4) as in Pose: (F, 21, 3)."""
    local = [Rotation.from_quat(rotations[:, segment], scalar_first=True) for segment in range(16)]
    world: list[Rotation] = []
    for segment, parent in enumerate(PARENTS):
        world.append(local[segment] if parent < 0 else world[parent] * local[segment])
    tips = [joints_m[:, segment] + world[segment].apply(offset) for segment, offset in TIPS]
    return np.concatenate([joints_m, np.stack(tips, axis=1)], axis=1)


def instants(camera: PanZoomCamera, track: PanZoomTrack) -> list[Camera | None]:
    """The camera of every frame set; None where it was not found."""
    return [geometry.of_track(camera, track, frame) if valid else None for frame, valid in enumerate(track.valid)]


def project_edges(camera: Camera, edges_m: Array) -> list[Array]:
    """Edges (E, 2, 3) as the camera sees them: those in front of it, (2, 2) each."""
    pixels, depth = geometry.project(camera, edges_m.reshape(-1, 3))
    ahead = np.all(depth.reshape(-1, 2) > 0.1, axis=1)
    return list(pixels.reshape(-1, 2, 2)[ahead])


def centred_shift(panorama: Panorama) -> Array:
    """(2,) How far `centred` moves columns and rows."""
    if not panorama.full_turn:
        return np.zeros(2)
    return np.array([panorama.image.shape[1] // 2 - round(panorama.origin_px[0]), 0.0])


def centred(panorama: Panorama) -> Panorama:
    """The same panorama, turned so that the reference pose looks at its middle; a partial one as it is."""
    shift = centred_shift(panorama)
    image, valid = np.roll(panorama.image, int(shift[0]), axis=1), np.roll(panorama.valid, int(shift[0]), axis=1)
    return replace(panorama, image=image, valid=valid, origin_px=panorama.origin_px + shift)


def image_border(at: Camera) -> Array:
    """(N, 2) The border of an image, once round, closed."""
    right, bottom = at.width - 0.5, at.height - 0.5
    corners = np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom), (-0.5, -0.5)])
    steps = np.linspace(0.0, 1.0, 12, endpoint=False)[:, None]
    return np.concatenate([a + steps * (b - a) for a, b in pairwise(corners)] + [corners[-1:]])


def footprint(panorama: Panorama, camera: PanZoomCamera, at: Camera) -> list[Array]:
    """The image border of ``at`` on the panorama: strips (N, 2), cut where a full turn wraps."""
    head = geometry.rays(at, image_border(at)) @ camera.world_T_head[:3, :3]
    azimuth = np.unwrap(np.arctan2(head[:, 1], head[:, 0]))
    azimuth = azimuth + cylinder.whole_turns(panorama, azimuth.mean())
    column, row = cylinder.to_unwrapped(panorama, azimuth, head[:, 2] / np.hypot(head[:, 0], head[:, 1])).T
    if not panorama.full_turn:
        return [np.column_stack([column, row])]
    width = panorama.image.shape[1]
    turn = np.floor(column / width)
    cuts = np.flatnonzero(np.diff(turn)) + 1
    return [np.column_stack([c - t[0] * width, r]) for c, t, r in
            zip(np.split(column, cuts), np.split(turn, cuts), np.split(row, cuts), strict=True)]  # fmt: skip


def outlines(probability: Image) -> list[Array]:
    """Closed outlines (N, 2) of where a silhouette's probability (H, W) is more than one half."""
    solid = (probability > 128).astype(np.uint8)
    contours, _ = cv2.findContours(solid, cv2.RETR_LIST, cv2.CHAIN_APPROX_TC89_L1)
    return [np.concatenate([c[:, 0], c[:1, 0]]).astype(np.float64) for c in contours if cv2.contourArea(c) >= 9.0]
