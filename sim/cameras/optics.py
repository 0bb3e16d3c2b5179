"""Geometry and lens of the simulated cameras: tripod, head, projection, distortion, vignetting.

Written independently of `pzcap.geometry.camera`: the two have the conventions of `pzcap.types` in common, no code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pzcap.ranges import Range
from pzcap.types import Array, Image, PzcapError

_PLACES_M = ((-10.5, -8.0), (10.5, -8.0), (10.5, 8.0), (-10.5, 8.0), (0.0, -8.8), (12.5, 0.0), (0.0, 8.8), (-12.5, 0.0))
_HEAD_R_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_FIXED_POINTS = 25  # of the distortion beyond k1: each step takes off nine tenths of the error, at least
_LUMA = (0.299, 0.587, 0.114)  # BT.601
_EXACT = 1e-9  # of the distance of the image plane: a millionth of a pixel
_GRID_PX = 8  # spacing of the points whose distortion is computed; between them it is interpolated, to 0.006 px


Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Column and row on the plate that each pixel sees."""


@dataclass(frozen=True, slots=True)
class OpticsConfig:
    """Head, lens and tripod, by default those of a careful crew.

    An effect whose size is 0 (vignetting: 1) is exactly absent.
    """

    reference_focal: Annotated[float, Range(0.2, 50.0)] = 1.375
    """Focal length at the reference pose, image widths: 880 px of 640. The calibration object is seen whole, its
    markers 34 px wide from a corner of the hall."""
    zoom_min: Annotated[float, Range(0.05, 20.0)] = 0.7
    """Widest focal length, reference focal lengths."""
    zoom_max: Annotated[float, Range(0.05, 20.0)] = 3.0
    """Longest focal length, reference focal lengths: an athlete 13 m off is seen three quarters of the image tall."""
    k1_wide: Annotated[float, Range(-0.5, 0.5)] = -0.08
    """Radial distortion k1 at the widest focal length: barrel, as of wide zoom lenses. Linear in log focal."""
    k1_long: Annotated[float, Range(-0.5, 0.5)] = 0.02
    """Radial distortion k1 at the longest focal length: pincushion."""
    k2: Annotated[float, Range(-0.5, 0.5)] = 0.0
    """Radial distortion k2 at all focal lengths; 0.05 is what a wide zoom lens has beyond k1."""
    p1: Annotated[float, Range(-0.05, 0.05)] = 0.0
    """Tangential distortion p1 at all focal lengths: a lens element that sits askew. 0.001 is that of a consumer's."""
    lateral_colour_px: Annotated[float, Range(0.0, 10.0)] = 0.0
    """Distance by which red stands further out in the corners than green, and blue less far, px: lateral colour. The
    focal length is that of white light, in which colours weigh as in luma."""
    principal_offset: Annotated[float, Range(0.0, 0.2)] = 0.00625
    """Distance of the principal point from the image's centre, image widths (4 px of 640), in a random direction."""
    vignetting: Annotated[float, Range(0.05, 1.0)] = 0.8
    """Brightness in the corners over that in the centre; it falls with the square of the radius."""
    axis_beside_m: Annotated[float, Range(0.0, 1.0)] = 0.003
    """Distance of the pan axis from the projection centre to either side, m: what a crew with a slide head leaves."""
    axis_behind_m: Annotated[float, Range(-1.0, 1.0)] = 0.005
    """Distance of the pan axis behind the projection centre, m: what a crew with a slide head leaves."""
    centre_travel_m: Annotated[float, Range(-1.0, 1.0)] = 0.005
    """Travel of the projection centre along the optical axis from the widest to the longest focal length, m."""
    tilt_deg: Annotated[float, Range(-80.0, 80.0)] = -4.0
    """Tilt of the locked heads, degrees: a little downwards, so that an athlete on the floor is in the middle."""
    tilt_sigma_deg: Annotated[float, Range(0.0, 20.0)] = 0.7
    """Standard deviation of the tilt from camera to camera, degrees."""
    roll_deg: Annotated[float, Range(0.0, 45.0)] = 0.5
    """Roll of the cameras on their heads, degrees, to either side: what a spirit level leaves."""
    axis_lean_deg: Annotated[float, Range(0.0, 20.0)] = 0.3
    """Lean of the pan axis from the vertical, degrees, at most: what a spirit level leaves."""
    position_sigma_m: Annotated[float, Range(0.0, 2.0)] = 0.2
    """Standard deviation of a tripod's place about its corner of the hall, m, along x and y."""
    settled_deg: Annotated[float, Range(0.0, 5.0)] = 0.0
    """Tilt by which each head has settled, up or down, between the hall's footage and the motion, degrees. 0: none;
    0.05 is what a quick release plate gives way under a heavy lens."""
    sprung_deg: Annotated[float, Range(0.0, 5.0)] = 0.0
    """Amplitude with which tilt and roll ring after each landing of the athlete, degrees; 0: the floor is rigid."""
    sprung_hz: Annotated[float, Range(0.5, 50.0)] = 8.0
    """Frequency at which they ring, Hz: that of a tripod on a sprung floor. It dies away within half a second."""
    bump_deg: Annotated[float, Range(0.0, 20.0)] = 0.0
    """Angle by which somebody bumps one of the tripods in mid-take, for good, degrees: heading, tilt and roll change at
    once. 0: nobody does."""

    def __post_init__(self) -> None:
        if self.zoom_min >= self.zoom_max:
            raise PzcapError(f"zoom_min is {self.zoom_min}, zoom_max {self.zoom_max}; give a lower and a higher one")


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """One camera on its tripod."""

    width: int
    height: int
    config: OpticsConfig
    world_T_head: Array  # (4, 4) z along the pan axis, origin at the projection centre of the reference pose
    beside_m: float  # of the pan axis from the projection centre, to the left
    tilt_rad: float
    roll_rad: float
    principal_px: Array  # (2,)

    @property
    def reference_focal_px(self) -> float:
        return self.config.reference_focal * self.width

    def zoom_share(self, focal_px: float | Array) -> Array:
        """Place of a focal length in the zoom range, by its logarithm: 0 at the widest, 1 at the longest."""
        c = self.config
        return np.log(np.asarray(focal_px) / (self.reference_focal_px * c.zoom_min)) / np.log(c.zoom_max / c.zoom_min)

    def k1(self, focal_px: float) -> float:
        c = self.config
        return float(c.k1_wide + (c.k1_long - c.k1_wide) * self.zoom_share(focal_px))

    def world_T_cam(self, pan_rad: float, focal_px: float, raised_rad: float = 0.0, rolled_rad: float = 0.0) -> Array:
        """(4, 4). The projection centre circles the pan axis and travels along the optical axis as the lens zooms.

        ``raised_rad`` is how far the head is tilted above where it was locked, about the reference pose's centre, and
        ``rolled_rad`` how far it is rolled beyond that.
        """
        c = self.config
        optical = _transform(Rotation.from_euler("y", -(self.tilt_rad + raised_rad)).as_matrix() @ _HEAD_R_CAM)
        optical = optical @ _transform(Rotation.from_euler("z", self.roll_rad + rolled_rad).as_matrix())
        travel = c.centre_travel_m * (self.zoom_share(focal_px) - self.zoom_share(self.reference_focal_px))
        axis = _transform(np.eye(3), [-c.axis_behind_m, self.beside_m, 0.0])
        pan = _transform(Rotation.from_euler("z", pan_rad).as_matrix())
        along = _transform(np.eye(3), [0.0, 0.0, float(travel)])
        return self.world_T_head @ axis @ pan @ np.linalg.inv(axis) @ optical @ along

    def turns(self, pan_rad: Array, raised_rad: Array, rolled_rad: Array) -> Array:
        """(N, 3, 3) rotations as of `world_T_cam` for pan, tilt and roll (N,) each."""
        pan = Rotation.from_euler("z", pan_rad[:, None]).as_matrix()
        tilt = Rotation.from_euler("y", -(self.tilt_rad + raised_rad)[:, None]).as_matrix()
        roll = Rotation.from_euler("z", (self.roll_rad + rolled_rad)[:, None]).as_matrix()
        return np.asarray(self.world_T_head[:3, :3] @ pan @ tilt @ _HEAD_R_CAM @ roll)

    def project(self, world_T_cam: Array, focal_px: float, points_m: Array) -> tuple[Array, Array]:
        """World points (N, 3) to pixels (N, 2) and depth (N,) in metres, which is above 0 where a point can be seen."""
        x, y, depth = ((points_m - world_T_cam[:3, 3]) @ world_T_cam[:3, :3]).T
        xy = np.column_stack([x, y]) / np.where(depth > 0.1, depth, 0.1)[:, None]
        squared = np.sum(xy**2, axis=1, keepdims=True)
        factor = 1 + (self.k1(focal_px) + self.config.k2 * squared) * squared
        tangential = self.config.p1 * np.column_stack([2 * xy[:, 0] * xy[:, 1], squared[:, 0] + 2 * xy[:, 1] ** 2])
        return self.principal_px + focal_px * factor * xy + focal_px * tangential, depth

    def by_k1_alone(self, x: Array, y: Array, k1: float | Array) -> tuple[Array, Array]:
        """Place in the image, normalised, where a lens without k2 and p1 would show what this one shows at (x, y)."""
        k2, p1 = self.config.k2, self.config.p1
        if not (k2 or p1):
            return x, y
        straight_x, straight_y = x, y
        for _ in range(_FIXED_POINTS):
            squared, before = straight_x**2 + straight_y**2, straight_y
            factor = 1 + (k1 + k2 * squared) * squared
            aside, down = 2 * p1 * straight_x * straight_y, p1 * (squared + 2 * straight_y**2)
            straight_x, straight_y = (x - aside) / factor, (y - down) / factor
            if np.abs(straight_y - before).max() < _EXACT:
                break
        factor = 1 + k1 * (straight_x**2 + straight_y**2)
        return straight_x * factor, straight_y * factor

    @property
    def stretches(self) -> tuple[float, ...]:
        """Sizes of the image in red, green and blue against that in white light; one where all are alike."""
        aside = self.config.lateral_colour_px / (math.hypot(self.width, self.height) / 2)
        green = 1.0 - (_LUMA[0] - _LUMA[2]) * aside
        return (green + aside, green, green - aside) if aside else (1.0,)


def build_rig(camera: int, width: int, height: int, config: OpticsConfig, rng: np.random.Generator) -> Rig:
    """Put up the tripod of camera 0 to 3 near its corner, of 4 to 7 near the middle of a wall, to look over the centre
    of the hall."""
    x, y = np.array(_PLACES_M[camera]) + rng.normal(0, 1, 2) * config.position_sigma_m
    z = rng.uniform(1.5, 2.0)
    lean_rad = np.deg2rad(config.axis_lean_deg) * np.sqrt(rng.uniform())
    towards = rng.uniform(0, 2 * np.pi)
    lean = Rotation.from_rotvec(lean_rad * np.array([np.cos(towards), np.sin(towards), 0.0]))
    heading = Rotation.from_euler("z", np.arctan2(-y, -x))
    tilt_deg = config.tilt_deg + config.tilt_sigma_deg * rng.normal()
    sides = rng.choice([-1.0, 1.0], 2)
    angle = rng.uniform(0, 2 * np.pi)
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    return Rig(
        width=width,
        height=height,
        config=config,
        world_T_head=_transform((lean * heading).as_matrix(), [x, y, z]),
        beside_m=float(sides[0] * config.axis_beside_m),
        tilt_rad=float(np.deg2rad(tilt_deg)),
        roll_rad=float(np.deg2rad(sides[1] * config.roll_deg)),
        principal_px=centre + config.principal_offset * width * np.array([np.cos(angle), np.sin(angle)]),
    )


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
        return world_T_cam @ _transform(Rotation.from_euler("z", self.turned_rad).as_matrix())

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


def vignette(rig: Rig) -> NDArray[np.float32]:
    """(height, width, 1) brightness, 1 at the principal point, falling with the square of the distance from it."""
    v, u = np.mgrid[: rig.height, : rig.width]
    r2 = (u - rig.principal_px[0]) ** 2 + (v - rig.principal_px[1]) ** 2
    corner = (rig.width**2 + rig.height**2) / 4
    return (1 - (1 - rig.config.vignetting) * r2 / corner).astype(np.float32)[..., None]


def _undistorted(radius: Array, k1: float | Array) -> Array:
    """Solve ``r (1 + k1 r^2) = radius`` by Newton's method."""
    r = radius.copy()
    for _ in range(6):
        r -= (r * (1 + k1 * r**2) - radius) / (1 + 3 * k1 * r**2)
    return r


def _transform(rotation: Array, translation: Array | list[float] | None = None) -> Array:
    result = np.eye(4)
    result[:3, :3] = rotation
    if translation is not None:
        result[:3, 3] = translation
    return result
