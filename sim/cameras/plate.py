"""The plate: the undistorted picture that is rendered, and the image that a lens makes of it, at once or row by row."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pzcap.types import Array, Image
from sim.cameras.optics import Rig, transform

_GRID_PX = 8  # spacing of the points whose distortion is computed; between them it is interpolated, to 0.006 px
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Column and row on the plate that each pixel sees."""


@dataclass(frozen=True, slots=True)
class Plate:
    """The undistorted picture that is rendered, in image pixels: centred, and larger than the image all round.

    It may be rendered finer than the image, by a factor ``scale`` that is a multiple of 1/4, and by a camera that is
    turned clockwise about the optical axis.
    """

    width: int
    height: int
    turned_rad: float
    up_px: float = 0.0  # of its middle above the optical axis

    def size(self, scale: float) -> tuple[int, int]:
        """Width and height in its own pixels."""
        return round(self.width * scale), round(self.height * scale)

    def turn(self, world_T_cam: Array) -> Array:
        """(4, 4) the camera that takes it, where the image's is ``world_T_cam``."""
        return world_T_cam @ transform(Rotation.from_euler("z", self.turned_rad).as_matrix())

    def vertical_view_deg(self, focal_px: float) -> float:
        return float(np.rad2deg(2 * np.arctan(self.height / (2 * focal_px))))


def plate_for(rig: Rig, focal_px: float, turned_rad: float = 0.0) -> Plate:
    """The smallest plate, so turned, that has data under every pixel of the image."""
    corner = np.hypot(rig.width, rig.height) / 2 / focal_px
    reach = max(float(_undistorted(np.array(corner), rig.k1(focal_px))) / corner, 1.0)
    if rig.config.k2 or rig.config.p1 or len(rig.stretches) > 1:
        reach = max(reach, _reach_beyond(rig, focal_px))
    shift = np.abs(rig.principal_px - (np.array([rig.width, rig.height]) - 1) / 2)
    sides = np.array([rig.width, rig.height]) * reach + 2 * reach * shift
    cos, sin = math.cos(turned_rad), abs(math.sin(turned_rad))
    width, height = (4 * math.ceil(side / 4 - 1e-9) for side in sides @ [[cos, sin], [sin, cos]])
    return Plate(width, height, turned_rad)


def _reach_beyond(rig: Rig, focal_px: float) -> float:
    """Factor by which what the image shows is larger than it, at most, through a lens that k1 does not describe."""
    edges = np.linspace(-1.0, 1.0, 33)
    rim = np.array([place for along in edges for side in (-1.0, 1.0) for place in ((along, side), (side, along))])
    x, y = rim.T * np.array([[rig.width], [rig.height]]) / 2 / focal_px
    seen = _undistorted(np.hypot(*rig.by_k1_alone(x, y, rig.k1(focal_px))), rig.k1(focal_px))
    return float((seen / np.hypot(x, y)).max()) * max(rig.stretches)


@lru_cache(maxsize=3)  # through a sweep they stay the same
def lens_maps(rig: Rig, plate: Plate, focal_px: float, scale: float, stretch: float = 1.0) -> Maps:
    """For each pixel of the image, made ``scale`` times finer, the column and row that it sees on a plate as fine.

    Of light whose image is larger than that of green by the factor ``stretch``. Both (scale * height, scale * width).
    Rows count from the *bottom*, as OpenGL hands pictures over.
    """
    size = fine_size(rig, scale)
    cells = -(-size // _GRID_PX) + 2  # one more on each side, so that none of the image is extrapolated
    coarse = [_coarse_px(np.arange(n), scale) for n in cells]
    x, y = np.meshgrid(*((axis - p) / (focal_px * stretch) for axis, p in zip(coarse, rig.principal_px, strict=True)))
    x, y = rig.by_k1_alone(x, y, rig.k1(focal_px))
    radius = np.maximum(np.hypot(x, y), 1e-12)
    factor = _undistorted(radius, rig.k1(focal_px)) / radius * focal_px * scale
    cos, sin = math.cos(plate.turned_rad), math.sin(plate.turned_rad)
    x, y = (cos * x + sin * y) * factor, (cos * y - sin * x) * factor
    columns, rows = (side / 2 - 0.5 for side in plate.size(scale))
    grid = np.stack([x + columns, rows - y], axis=-1).astype(np.float32)
    whole = _enlarged(grid)[_GRID_PX : _GRID_PX + size[1], _GRID_PX : _GRID_PX + size[0]]
    maps = np.ascontiguousarray(whole[..., 0]), np.ascontiguousarray(whole[..., 1])
    for seen in maps:
        seen.setflags(write=False)
    return maps


def fine_size(rig: Rig, scale: float) -> NDArray[np.int64]:
    """(2,) width and height of the image, made ``scale`` times finer."""
    return np.round(np.array([rig.width, rig.height]) * scale).astype(int)


def _coarse_px(cells: NDArray[np.int64], scale: float) -> Array:
    """Columns, or rows, of the image at which the grid's ``cells`` stand; the second is the image's first."""
    return np.asarray(((cells - 0.5) * _GRID_PX) / scale - 0.5)


class Moment(NamedTuple):
    """A camera at one moment."""

    world_T_cam: Array  # (4, 4)
    focal_px: float


class RolledRows(NamedTuple):
    """Some rows of the image, made finer, each of which has a camera of its own; where they see on a plate."""

    rows: range
    skipped: int  # rows of the grids' second cell that are above them
    grids: list[tuple[Array, Array]]  # of each of `Rig.stretches`: px of the plate right and up from the optical axis


def roll(
    rig: Rig, plate: Moment, cameras_of: Callable[[Array], tuple[Array, Array]], rows: range, turned_rad: float,
    scale: float,
) -> RolledRows:  # fmt: skip
    """Grids that `lens_maps` is made of, for ``rows`` of the image, made ``scale`` times finer.

    ``cameras_of`` gives rotation (N, 3, 3) and focal length (N,) of the cameras of rows (N,) of the image, ``plate`` is
    the plate's camera. Rotation, focal length and distortion tell them apart; the millimetres that the centre moves
    meanwhile are left out.
    """
    # of the grid, the cells between whose centres the rows lie
    above = (2 * rows.start + 1 + _GRID_PX) // (2 * _GRID_PX)
    below = (2 * rows.stop - 1 + _GRID_PX) // (2 * _GRID_PX) + 1
    u = _coarse_px(np.arange(-(-fine_size(rig, scale)[0] // _GRID_PX) + 2), scale)
    v = _coarse_px(np.arange(above, below + 1), scale)
    turns, focal_px = cameras_of(v)
    turns = plate.world_T_cam[:3, :3].T @ turns
    k1 = np.array([[rig.k1(each)] for each in focal_px.tolist()])
    cos, sin = math.cos(turned_rad), math.sin(turned_rad)
    grids = []
    for stretch in rig.stretches:
        sides = u - rig.principal_px[0], v[:, None] - rig.principal_px[1]
        x, y = np.broadcast_arrays(*(side / (focal_px[:, None] * stretch) for side in sides))
        x, y = rig.by_k1_alone(x, y, k1)
        radius = np.maximum(np.hypot(x, y), 1e-12)
        straight = _undistorted(radius, k1) / radius
        rays = np.stack([x * straight, y * straight, np.ones_like(x)], axis=-1)
        seen = rays @ turns.transpose(0, 2, 1)
        x, y = np.moveaxis(seen[..., :2] / seen[..., 2:] * (plate.focal_px * scale), -1, 0)
        grids.append((cos * x + sin * y, sin * x - cos * y))
    return RolledRows(rows, rows.start - above * _GRID_PX, grids)


def plate_under(pieces: Sequence[RolledRows], turned_rad: float, scale: float) -> Plate:
    """The smallest plate that has data under all ``pieces``: a strip, if they are of few rows."""
    right, up = ([grid[axis] for piece in pieces for grid in piece.grids] for axis in (0, 1))
    aside = max(float(np.abs(each).max()) for each in right)
    low, high = min(float(each.min()) for each in up), max(float(each.max()) for each in up)
    middle = round((low + high) / 2)  # so that its pixels are those of a plate about the axis
    width, height = (4 * math.ceil((2 * side + 1) / scale / 4) for side in (aside, max(high - middle, middle - low)))
    return Plate(width, height, turned_rad, middle / scale)


def rolled_maps(piece: RolledRows, plate: Plate, scale: float, width: int) -> list[Maps]:
    """The maps of ``piece``, of ``width`` columns, on a plate, as `lens_maps` makes them of a whole image."""
    columns, rows = (side / 2 - 0.5 for side in plate.size(scale))
    shifts = columns, rows - plate.up_px * scale
    maps = []
    for grid in piece.grids:
        whole = [_enlarged((axis + shift).astype(np.float32)) for axis, shift in zip(grid, shifts, strict=True)]
        first = _GRID_PX + piece.skipped
        part = slice(first, first + len(piece.rows)), slice(_GRID_PX, _GRID_PX + width)
        maps.append((whole[0][part], whole[1][part]))
    return maps


def _enlarged(grid: NDArray[np.float32]) -> NDArray[np.float32]:
    size = grid.shape[1] * _GRID_PX, grid.shape[0] * _GRID_PX
    return np.asarray(cv2.resize(grid, size, interpolation=cv2.INTER_LINEAR), np.float32)


def through_lens(plate: Image, maps: Sequence[Maps], rig: Rig) -> Image:
    """Distort a plate and bring it to the image's size, (height, width, ...). maps: as of `sampled`."""
    return shrunk(sampled(plate, maps), rig)


def sampled(plate: Image, maps: Sequence[Maps]) -> Image:
    """Picture that ``maps`` see on a plate: those of all light, or of red, green and blue; a mask as green is."""
    if len(maps) == 1 or plate.ndim == 2:
        columns, rows = maps[len(maps) // 2]
        seen = cv2.remap(plate, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(seen, np.uint8)
    channels = zip(cv2.split(plate), maps, strict=True)
    return np.stack([sampled(np.asarray(channel, np.uint8), [one]) for channel, one in channels], axis=-1)


def shrunk(fine: Image, rig: Rig) -> Image:
    """A picture that is finer than the image, brought to its size."""
    if fine.shape[1] != rig.width:
        fine = np.asarray(cv2.resize(fine, (rig.width, rig.height), interpolation=cv2.INTER_AREA), np.uint8)
    return fine


def _undistorted(radius: Array, k1: float | Array) -> Array:
    """Solve ``r (1 + k1 r^2) = radius`` by Newton's method."""
    r = radius.copy()
    for _ in range(6):
        r -= (r * (1 + k1 * r**2) - radius) / (1 + 3 * k1 * r**2)
    return r
