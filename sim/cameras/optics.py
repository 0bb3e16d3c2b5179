"""Geometry and lens of the simulated cameras: tripod, head, projection, distortion, vignetting.

Written independently of `pzcap.geometry.camera`: the two have the conventions of `pzcap.types` in common, no code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pzcap.types import Array, PzcapError
from sim.ranges import Range

_PLACES_M = (
    (-10.5, -8.0), (10.5, -8.0), (10.5, 8.0), (-10.5, 8.0),
    # along the walls: from the middle of one the calibration object, which is square with them, shows one face
    (4.5, -8.8), (12.5, 6.0), (-4.5, 8.8), (-12.5, -6.0),
)  # fmt: skip
_HEAD_R_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_FIXED_POINTS = 25  # of the distortion beyond k1: each step takes off nine tenths of the error, at least
_LUMA = (0.299, 0.587, 0.114)  # BT.601
_EXACT = 1e-9  # of the distance of the image plane: a millionth of a pixel


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
        optical = transform(Rotation.from_euler("y", -(self.tilt_rad + raised_rad)).as_matrix() @ _HEAD_R_CAM)
        optical = optical @ transform(Rotation.from_euler("z", self.roll_rad + rolled_rad).as_matrix())
        travel = c.centre_travel_m * (self.zoom_share(focal_px) - self.zoom_share(self.reference_focal_px))
        axis = transform(np.eye(3), [-c.axis_behind_m, self.beside_m, 0.0])
        pan = transform(Rotation.from_euler("z", pan_rad).as_matrix())
        along = transform(np.eye(3), [0.0, 0.0, float(travel)])
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
    """Put up the tripod of camera 0 to 3 near its corner, of 4 to 7 along a wall, to look over the centre of the
    hall."""
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
        world_T_head=transform((lean * heading).as_matrix(), [x, y, z]),
        beside_m=float(sides[0] * config.axis_beside_m),
        tilt_rad=float(np.deg2rad(tilt_deg)),
        roll_rad=float(np.deg2rad(sides[1] * config.roll_deg)),
        principal_px=centre + config.principal_offset * width * np.array([np.cos(angle), np.sin(angle)]),
    )


def vignette(rig: Rig) -> NDArray[np.float32]:
    """(height, width, 1) brightness, 1 at the principal point, falling with the square of the distance from it."""
    v, u = np.mgrid[: rig.height, : rig.width]
    r2 = (u - rig.principal_px[0]) ** 2 + (v - rig.principal_px[1]) ** 2
    corner = (rig.width**2 + rig.height**2) / 4
    return (1 - (1 - rig.config.vignetting) * r2 / corner).astype(np.float32)[..., None]


def transform(rotation: Array, translation: Array | list[float] | None = None) -> Array:
    """(4, 4) a rotation and a translation, by default none."""
    result = np.eye(4)
    result[:3, :3] = rotation
    if translation is not None:
        result[:3, 3] = translation
    return result
