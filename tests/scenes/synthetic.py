"""A hall seen from one point: a procedural cylinder of texture, and frames of a pan-zoom camera rendered from it.

Test material for calibration and localisation alone: no depth, no simulator, all truth known. Rendering goes through
rotation matrices of its own, so that a mistake in `pzcap.geometry.camera` cannot cancel out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from pzcap.types import Array, CalibrationObject, Image, Marker

SLOPES = 0.75  # the cylinder reaches this far up and down


@dataclass(frozen=True)
class Optics:
    """The camera that renders; half the size of a real one keeps the tests quick."""

    width: int = 320
    height: int = 240
    reference_focal_px: float = 440.0
    tilt_rad: float = np.deg2rad(-4.0)
    roll_rad: float = np.deg2rad(0.5)
    principal_px: tuple[float, float] = (161.5, 118.0)  # at the reference focal length
    principal_slope_px: tuple[float, float] = (0.8, -0.5)  # for each unit of log focal
    k1: float = -0.04
    k1_slope: float = 0.05
    vignetting: float = 0.2  # darker by this share in the corners
    noise: float = 2.0  # grey levels


@lru_cache(maxsize=2)
def hall(seed: int, px_per_rad: int = 1000) -> Image:
    """(H, W, 3) texture of the full turn; rich at all scales, not repeating."""
    rng = np.random.default_rng(seed)
    width, height = round(2 * np.pi * px_per_rad), round(2 * SLOPES * px_per_rad)
    image = np.zeros((height, width, 3), np.float32)
    cells = width
    amplitude = 12.0
    while cells >= 8:
        coarse = rng.normal(size=(max(2, cells * height // width), cells, 3)).astype(np.float32)
        wrapped = np.hstack([coarse, coarse[:, :1]])
        grid_x = (np.arange(width, dtype=np.float32) * cells / width)[None].repeat(height, 0)
        grid_y = (np.arange(height, dtype=np.float32) * (len(coarse) - 1) / height)[:, None].repeat(width, 1)
        image += amplitude * cv2.remap(wrapped, grid_x, grid_y, cv2.INTER_LINEAR)
        cells //= 2
    image += 120.0
    for size, count in ((0.25, 60), (0.1, 300), (0.04, 1500), (0.015, 6000)):
        for _ in range(count):
            centre = rng.uniform((0, 0), (width, height))
            half = px_per_rad * size * rng.uniform(0.2, 0.5, 2)
            colour = tuple(float(c) for c in rng.uniform(30, 220, 3))
            box = cv2.boxPoints((tuple(centre), tuple(2 * half), float(rng.choice([0.0, 0.0, rng.uniform(0, 90)]))))
            for shift in (-width, 0, width):
                if -300 < centre[0] + shift < width + 300:
                    points = np.round((box + np.array([shift, 0.0])) * 16).astype(np.int32)
                    cv2.fillConvexPoly(image, points, colour, cv2.LINE_AA, 4)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7), 0, 255).astype(np.uint8)


def render(
    optics: Optics,
    pan_rad: float,
    focal_px: float,
    seed: int = 0,
    *,
    gain: float = 1.0,
    noise_seed: int = 0,
    with_object: bool = False,
) -> Image:
    """The frame that the camera sees, (H, W, 3); the calibration object stands 8 m off at pan 0."""
    texture, px_per_rad = _wrapped_hall(seed)
    head_R_cam = rotation_z(pan_rad) @ rotation_y(-optics.tilt_rad) @ _FORWARD @ rotation_z(optics.roll_rad)
    rays, darker = _rays(optics, focal_px)
    directions = rays @ head_R_cam.T
    azimuth = np.arctan2(directions[..., 1], directions[..., 0])
    slope = directions[..., 2] / np.hypot(directions[..., 0], directions[..., 1])
    columns = ((np.pi - azimuth) * px_per_rad - 0.5 + _MARGIN).astype(np.float32)
    rows = ((SLOPES - slope) * px_per_rad - 0.5).astype(np.float32)
    fine = cv2.remap(texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if with_object:
        draw_object(fine, directions)
    frame = cv2.resize(fine.astype(np.float32), (optics.width, optics.height), interpolation=cv2.INTER_AREA)
    frame *= (gain * darker)[..., None].astype(np.float32)
    frame += np.random.default_rng(noise_seed).normal(0, optics.noise, frame.shape).astype(np.float32)
    return np.clip(np.round(frame), 0, 255).astype(np.uint8)


_FORWARD = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])  # head_R_cam of a level camera at pan 0
_MARGIN = 8  # pixels on either side of the texture that repeat the other one


@lru_cache(maxsize=2)
def _wrapped_hall(seed: int) -> tuple[Image, float]:
    """The texture with a margin, so that the full turn closes, and its pixels to the radian."""
    texture = hall(seed)
    return cv2.copyMakeBorder(texture, 0, 0, _MARGIN, _MARGIN, cv2.BORDER_WRAP), texture.shape[1] / (2 * np.pi)


@lru_cache(maxsize=4)  # a sweep has one focal length
def _rays(optics: Optics, focal_px: float) -> tuple[Array, Array]:
    """Directions (3 H, 3 W, 3) of nine rays a pixel in the camera frame, and what vignetting leaves (H, W) of light."""
    log_zoom = np.log(focal_px / optics.reference_focal_px)
    principal = np.array(optics.principal_px) + log_zoom * np.array(optics.principal_slope_px)
    k1 = optics.k1 + log_zoom * optics.k1_slope
    factor = 3
    sub = (np.arange(factor) + 0.5) / factor - 0.5
    u = (np.arange(optics.width)[:, None] + sub).ravel()
    v = (np.arange(optics.height)[:, None] + sub).ravel()
    x, y = np.meshgrid((u - principal[0]) / focal_px, (v - principal[1]) / focal_px)
    bent = np.hypot(x, y)
    straight = bent.copy()
    for _ in range(10):  # each leaves less than a twentieth of the error
        straight = bent / (1 + k1 * straight**2)
    shrunk = 1 + k1 * straight**2
    radius = np.hypot(*np.meshgrid(np.arange(optics.width) - principal[0], np.arange(optics.height) - principal[1]))
    radius /= np.hypot(optics.width, optics.height) / 2
    return np.stack([x / shrunk, y / shrunk, np.ones_like(x)], axis=-1), 1 - optics.vignetting * radius**2


def frames(optics: Optics, pans_rad: Array) -> list[tuple[int, Image]]:
    """Numbered frames of a sweep at the reference focal length, each with noise of its own."""
    focal = optics.reference_focal_px
    return [(i, render(optics, pan, focal, noise_seed=i)) for i, pan in enumerate(pans_rad)]


def hall_at(azimuth: Array, slope: Array) -> Array:
    """Grey level of the synthetic hall."""
    texture = hall(0)
    px_per_rad = texture.shape[1] / (2 * np.pi)
    column = np.round((np.pi - azimuth) * px_per_rad - 0.5).astype(int) % texture.shape[1]
    return texture[np.round((SLOPES - slope) * px_per_rad - 0.5).astype(int), column].astype(float)


OBJECT_CENTRE = np.array([8.0, 0.0, -0.6])  # head frame, metres
BOARD = 400  # pixels to the metre of a drawn board


def calibration_object() -> CalibrationObject:
    """Two boards at a right angle with 3 x 3 markers each; the world frame is the head frame at pan 0."""
    markers = []
    for face, (corner, across) in enumerate(_faces()):
        for i in range(9):
            x, y = 0.15 + 0.6 * (i % 3), 0.15 + 0.6 * (i // 3)
            quad = [(x, y), (x + 0.5, y), (x + 0.5, y + 0.5), (x, y + 0.5)]
            corners = np.array([corner + a * across + b * np.array([0, 0, -1.0]) for a, b in quad])
            markers.append(Marker(9 * face + i, corners))
    return CalibrationObject("DICT_4X4_50", tuple(markers), np.zeros((0, 2, 3)))


def _faces() -> list[tuple[Array, Array]]:
    """Top left corner of each 2 m board, and the direction of its rows."""
    edge = OBJECT_CENTRE + np.array([-1.4, 0.0, 1.0])  # where the boards meet, towards the camera
    left, right = np.array([-1, -1, 0]) / np.sqrt(2), np.array([1, -1, 0]) / np.sqrt(2)
    return [(edge - 2.0 * left, left), (edge, right)]


def draw_object(fine: Image, directions: Array) -> None:
    """Paint the boards where the rays ``directions`` (H, W, 3) from the origin hit them."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    down = np.array([0, 0, -1.0])
    for face, (corner, across) in enumerate(_faces()):
        board = np.full((2 * BOARD, 2 * BOARD), 235, np.uint8)
        for i in range(9):
            x, y = round((0.15 + 0.6 * (i % 3)) * BOARD), round((0.15 + 0.6 * (i // 3)) * BOARD)
            cells = cv2.aruco.generateImageMarker(dictionary, 9 * face + i, 6)
            marker = cv2.resize(cells, (BOARD // 2, BOARD // 2), interpolation=cv2.INTER_NEAREST)
            board[y : y + BOARD // 2, x : x + BOARD // 2] = np.maximum(marker, 20)
        normal = np.cross(across, down)
        distance = (corner @ normal) / (directions @ normal)
        hit = directions * distance[..., None] - corner
        column, row = (hit @ across) * BOARD - 0.5, (hit @ down) * BOARD - 0.5
        inside = (distance > 0) & (np.abs(hit @ across - 1) < 1) & (np.abs(hit @ down - 1) < 1)
        drawn = cv2.remap(board, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR)
        fine[inside] = drawn[inside][:, None]


def rotation_y(angle: float) -> Array:
    return np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])


def rotation_z(angle: float) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])


def clean(optics: Optics) -> Optics:
    """The same camera without what the paper does not model."""
    return replace(
        optics, tilt_rad=0.0, roll_rad=0.0, k1=0.0, k1_slope=0.0, principal_slope_px=(0.0, 0.0), vignetting=0.0,
        principal_px=((optics.width - 1) / 2, (optics.height - 1) / 2),
    )  # fmt: skip
