"""Pictures for the report: frames, panoramas and reference images with what was found drawn over them."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.types import Array, CalibrationObject, Camera, Image, Panorama, PanZoomCamera, ReferenceCamera
from pzcap.viewer.drawing import BONE_COLOURS, BONES, KEYFRAME_COLOUR, Colour, image_border, project_edges

_SHIFT = 4  # cv2 draws at 1/16 px
PANORAMA_PX = 1500  # across a picture of a panorama, at most
EMPTY = np.uint8(70)  # where a panorama shows nothing


def data_uri(image: Image, width: int | None = None, quality: int = 82) -> str:
    """A JPEG inside a URI, shrunk to ``width``."""
    if width is not None and width < image.shape[1]:
        size = (width, round(image.shape[0] * width / image.shape[1]))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def draw_strips(image: Image, strips: Iterable[Array], colour: Colour, width: int = 1) -> None:
    """Polylines (N, 2) in pixels, colour in RGB, onto a BGR image."""
    points = [np.round(np.asarray(strip) * 2**_SHIFT).astype(np.int32) for strip in strips]
    cv2.polylines(
        image, points, isClosed=False, color=colour[::-1], thickness=width, lineType=cv2.LINE_AA, shift=_SHIFT
    )


def draw_dots(image: Image, points: Array, colour: Colour, radius: float) -> None:
    """Dots at (N, 2) pixels."""
    for x, y in np.round(np.asarray(points) * 2**_SHIFT).astype(int):
        cv2.circle(image, (int(x), int(y)), round(radius * 2**_SHIFT), colour[::-1], -1, cv2.LINE_AA, _SHIFT)


def draw_figure(image: Image, camera: Camera, figure: Array, colour: Colour | None = None, width: int = 2) -> None:
    """A figure (21, 3) as ``camera`` sees it, in the colours of its sides or in one."""
    pixels, depth = geometry.project(camera, figure)
    if np.any(depth < 0.2) or np.any(np.abs(pixels) > 1e4):
        return
    for (near, far), own in zip(BONES, BONE_COLOURS, strict=True):
        draw_strips(image, [pixels[[near, far]]], colour or own, width)


def visible(camera: Camera, points_m: Array) -> Array:
    """Pixels (N, 2) of world points (N, 3), kept inside the image."""
    pixels, _ = geometry.project(camera, points_m)
    return np.clip(pixels, 0.0, [camera.width - 1.0, camera.height - 1.0])


def reference_picture(image: Image, reference: ReferenceCamera, target: CalibrationObject) -> Image:
    """The calibration object with its corners as detected (yellow) and as projected (red), cut out (Fig. 8)."""
    scale = 2
    large = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8)

    def at(points: Array) -> Array:
        return (np.asarray(points) + 0.5) * scale - 0.5

    edges = [at(edge) for edge in project_edges(reference.camera, target.wireframe_m)]
    draw_strips(large, edges, (80, 120, 255), 2)
    draw_dots(large, at(reference.points_px), (255, 220, 60), 3.0)
    draw_dots(large, at(reference.points_px - reference.residuals_px), (235, 64, 52), 1.5)
    around = np.concatenate([*edges, at(reference.points_px)])
    return cut(large, around, margin=0.12)


def cut(image: Image, around: Array, margin: float) -> Image:
    """The part of ``image`` about points (N, 2), with a margin in shares of their extent."""
    low, high = around.min(axis=0), around.max(axis=0)
    height, width = image.shape[:2]
    left, top = np.clip(np.floor(low - margin * (high - low)), 0, [width - 1, height - 1]).astype(int)
    right, bottom = np.clip(np.ceil(high + margin * (high - low)), [left + 1, top + 1], [width, height]).astype(int)
    return image[top:bottom, left:right]


def close_up(image: Image, camera: Camera, points_m: Array, side: int) -> tuple[Image, Camera]:
    """The square about world points (N, 3), ``side`` pixels wide, and the camera that would have taken it."""
    seen = visible(camera, points_m)
    centre, half = (seen.min(axis=0) + seen.max(axis=0)) / 2, max(0.62 * np.ptp(seen, axis=0).max(), 40.0)
    scale = side / (2 * half)
    corner = centre - half
    # Pixel centres are whole numbers in both images: x' + 1/2 = scale * (x + 1/2 - corner)
    shift = -scale * corner + 0.5 * (scale - 1.0)
    warp = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    picture = cv2.warpAffine(image, warp, (side, side), flags=cv2.INTER_CUBIC)
    principal = scale * camera.principal_px + shift
    return np.asarray(picture, np.uint8), replace(
        camera, width=side, height=side, focal_px=scale * camera.focal_px, principal_px=principal
    )


def panorama_picture(
    panorama: Panorama,
    camera: PanZoomCamera,
    cameras: Sequence[Camera],
    colours: Sequence[Colour],
    figures: Sequence[tuple[Array, bool]],
) -> Image:
    """The part of the panorama that the frames look at, their borders, and figures (21, 3) (Fig. 10).

    A figure that is flagged is a keyframe's and drawn red.
    """
    ahead = np.array([at.world_T_cam[:3, 2] for at in cameras]) @ camera.world_T_head[:3, :3]
    middle = np.arctan2(ahead[:, 1].sum(), ahead[:, 0].sum())
    pans = middle + geometry.wrapped(np.arctan2(ahead[:, 1], ahead[:, 0]) - middle)
    borders = [border_on_panorama(panorama, camera, at, pan) for at, pan in zip(cameras, pans, strict=True)]
    columns = np.concatenate(borders)[:, 0]
    tall = panorama.image.shape[0]
    # a strip, not a tower, where little panned
    half = max(np.ptp(columns) / 2 + 0.06 * panorama.px_per_rad, 1.3 * tall) / panorama.px_per_rad
    centre = (panorama.origin_px[0] - (columns.min() + columns.max()) / 2) / panorama.px_per_rad
    image, corner = window(panorama, centre - half, centre + half, (0, tall))
    scale = min(1.0, PANORAMA_PX / image.shape[1])
    image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    for border, colour in zip(borders, colours, strict=True):
        draw_strips(image, [(border - corner) * scale], colour, 2)
    for figure, is_keyframe in figures:
        pixels = (on_panorama(panorama, camera, figure, centre) - corner) * scale
        for (near, far), own in zip(BONES, BONE_COLOURS, strict=True):
            draw_strips(image, [pixels[[near, far]]], KEYFRAME_COLOUR if is_keyframe else own, 2)
    return image


def window(panorama: Panorama, low_rad: float, high_rad: float, rows: tuple[float, float]) -> tuple[Image, Array]:
    """The part of a panorama between two azimuths (wrapping round) and two rows, and its top left corner's pixel (2,).

    Grey where nothing was pasted. What a partial sweep did not reach is cut off at either end.
    """
    left, right = (round(float(panorama.origin_px[0] - a * panorama.px_per_rad)) for a in (high_rad, low_rad))
    top, bottom = max(int(rows[0]), 0), min(int(rows[1]), panorama.image.shape[0] - 1)
    width = panorama.image.shape[1]
    turn = width if panorama.full_turn else round(2 * np.pi * panorama.px_per_rad)
    columns = np.arange(left, right + 1) % turn
    if not panorama.full_turn and (swept := np.flatnonzero(columns < width)).size:
        columns, left = columns[swept[0] : swept[-1] + 1], left + int(swept[0])
    image = np.where(panorama.valid[..., None], panorama.image, EMPTY)[top : bottom + 1]
    seen = np.where((columns < width)[:, None], image[:, np.minimum(columns, width - 1)], EMPTY)
    return np.asarray(seen, np.uint8), np.array([left, top], float)


def on_panorama(panorama: Panorama, camera: PanZoomCamera, points_m: Array, near_rad: float = 0.0) -> Array:
    """World points (N, 3) to columns and rows (N, 2), unwrapped to lie within half a turn of ``near_rad``."""
    return _unwrapped(panorama, (points_m - camera.world_T_head[:3, 3]) @ camera.world_T_head[:3, :3], near_rad)


def border_on_panorama(panorama: Panorama, camera: PanZoomCamera, at: Camera, near_rad: float = 0.0) -> Array:
    """(N, 2) the border of a frame on the panorama, unwrapped."""
    return _unwrapped(panorama, geometry.rays(at, image_border(at)) @ camera.world_T_head[:3, :3], near_rad)


def _unwrapped(panorama: Panorama, head: Array, near_rad: float) -> Array:
    azimuth = near_rad + geometry.wrapped(np.arctan2(head[:, 1], head[:, 0]) - near_rad)
    return cylinder.to_unwrapped(panorama, azimuth, head[:, 2] / np.hypot(head[:, 0], head[:, 1]))
