"""The common field of view: where on the floor somebody who stands is seen whole by every camera (Fig. 1).

A camera that is fixed stays at its reference pose. One that pans is turned towards the body, at the reference focal
length. One that zooms, too, is zoomed in as far as its range lets the whole body stay in the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from pzcap.geometry import camera as geometry
from pzcap.types import Array, Mask, PanZoomCamera, PzcapError

Value = TypeVar("Value", bound=np.generic)
FREEDOMS: Final = ("fixed", "pan", "pan-zoom")
ZOOM_STEP: Final = 0.03  # of log focal, between the focal lengths that are tried
CELL_M: Final = 0.1  # of the floor


@dataclass(frozen=True, slots=True)
class Standing:
    """Somebody who stands, as the upright rectangle that a camera sees."""

    height_m: float = 1.75
    width_m: float = 0.5


FEET: Final = Standing(0.0, 0.0)
"""A point of the floor."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Squares of the floor between the cameras."""

    points_m: Array  # (N, 2) their middles
    inside: Mask  # (N,) within the cameras' convex hull
    shape: tuple[int, int]  # rows along y, columns along x; their product is N
    cell_m: float

    def area_m2(self, where: Mask) -> float:
        """Of the squares ``where`` (N,)."""
        return float(np.sum(where & self.inside)) * self.cell_m**2

    def grid(self, values: NDArray[Value]) -> NDArray[Value]:
        """Values (N,) as rows and columns."""
        return values.reshape(self.shape)


def floor_between(cameras: Sequence[PanZoomCamera], cell_m: float) -> Floor:
    """The floor within the convex hull of the cameras. PzcapError for fewer than three."""
    if len(cameras) < 3:
        raise PzcapError("a common field of view has an area between three cameras or more; fewer were reconstructed")
    corners = np.array([camera.world_T_head[:2, 3] for camera in cameras])
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y = (np.arange(a + cell_m / 2, b, cell_m) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return Floor(points, np.asarray(Delaunay(corners).find_simplex(points) >= 0), (len(y), len(x)), cell_m)


def zoom_range(tracks: Sequence[Array], reference_px: float) -> Array:
    """Focal lengths to try, ascending: from the shortest to the longest of ``tracks`` and the reference."""
    focals = np.concatenate([*tracks, [reference_px]])
    return np.geomspace(focals.min(), focals.max(), 2 + int(np.log(focals.max() / focals.min()) / ZOOM_STEP))


def height_px(camera: PanZoomCamera, floor_m: Array, body: Standing, freedom: str, focals_px: Array) -> Array:
    """Height (N,) px of ``body`` in the picture, at points (N, 2) of the floor; -1 where it is not whole in it.

    ``focals_px``: what a camera that zooms can choose from, ascending.
    """
    to_centre = camera.world_T_head[:2, 3] - floor_m
    aside = np.column_stack([to_centre[:, 1], -to_centre[:, 0]])
    aside *= body.width_m / 2 / np.maximum(np.hypot(*to_centre.T), 1e-9)[:, None]
    corners = np.zeros((len(floor_m), 5, 3))  # the rectangle's, and where it stands
    for k, (side, height) in enumerate([(1, 0), (-1, 0), (1, 1), (-1, 1), (0, 0)]):
        corners[:, k, :2], corners[:, k, 2] = floor_m + side * aside, height * body.height_m
    head = (corners - camera.world_T_head[:3, 3]) @ camera.world_T_head[:3, :3]
    azimuth, slope = np.arctan2(head[..., 1], head[..., 0]), head[..., 2] / np.hypot(head[..., 0], head[..., 1])
    if freedom != "fixed":
        azimuth = azimuth - azimuth[:, 4:]
    tall, fits = np.full(len(floor_m), -1.0), np.arange(len(floor_m))
    for focal in focals_px if freedom == "pan-zoom" else [camera.lens.reference_focal_px]:
        view = geometry.view_at(camera, 0.0, camera.tilt_rad, float(focal))
        pixels, ahead = geometry.direction_to_pixel(view, azimuth[fits], slope[fits])
        inside = ahead & np.all((pixels >= -0.5) & (pixels <= [camera.lens.width - 0.5, camera.lens.height - 0.5]), -1)
        whole = inside.all(axis=1)
        fits = fits[whole]  # what is cut off stays so when zoomed in further
        tall[fits] = np.ptp(pixels[whole, :, 1], axis=1)
    return tall


def common_height_px(
    cameras: Sequence[PanZoomCamera], floor: Floor, body: Standing, freedom: str, focals_px: Array
) -> Array:
    """The same in the camera that sees the body smallest; -1 where one does not see it whole."""
    return np.min([height_px(camera, floor.points_m, body, freedom, focals_px) for camera in cameras], axis=0)
