"""The panorama's cylinder about the pan axis (the paper's equations 3-6, for a calibrated camera), and the hall's
inverse distance.

`pzcap.geometry.camera` takes its points to pixels, `pzcap.localisation.panorama_sampler` back.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from pzcap.geometry.camera import View
from pzcap.geometry.parallax import parallax, parallax_back
from pzcap.types import Array, Float32, InverseDepthMap, Panorama

GRID = 16  # maps are smooth: they are computed at every sixteenth pixel and interpolated, to 0.0003 px


def to_unwrapped(panorama: Panorama, azimuth_rad: Array, slope: Array) -> Array:
    """Directions of the head frame (...) to panorama pixels (..., 2), which may lie beyond the ends of a full turn."""
    return np.asarray(panorama.origin_px - np.stack([azimuth_rad, slope], axis=-1) * panorama.px_per_rad)


def to_panorama(panorama: Panorama, azimuth_rad: Array, slope: Array) -> Array:
    """`to_unwrapped`, the columns of a full turn brought into [0, width), those of a partial one near its middle."""
    points_px = to_unwrapped(panorama, azimuth_rad + whole_turns(panorama, azimuth_rad), slope)
    if panorama.full_turn:
        points_px[..., 0] = np.mod(points_px[..., 0], panorama.image.shape[1])
    return points_px


def whole_turns(panorama: Panorama, azimuth_rad: Array | float) -> Array:
    """Whole turns, radians, to be added to azimuths (...) so that a partial panorama has them: its own go on beyond
    half a turn where the sweep came from behind the camera. 0 of a full turn, which has all of them."""
    if panorama.full_turn:
        return np.zeros(np.shape(azimuth_rad))
    middle_rad = (panorama.origin_px[0] - (panorama.image.shape[1] - 1) / 2) / panorama.px_per_rad
    return np.asarray(2 * np.pi * np.round((middle_rad - azimuth_rad) / (2 * np.pi)))


def from_panorama(panorama: Panorama, points_px: Array) -> tuple[Array, Array]:
    """Panorama pixels (..., 2) to directions of the head frame: azimuth (...) and slope (...)."""
    offset = (panorama.origin_px - points_px) / panorama.px_per_rad
    return offset[..., 0], offset[..., 1]


Hall = tuple[float, Array, Array, Array, Array]  # the fields of `types.InverseDepthMap`, for kernels


def kernel_hall(surroundings: InverseDepthMap) -> Hall:
    return surroundings.height_m, surroundings.walls, surroundings.departures, surroundings.slopes, surroundings.lean


def inverse_distance(surroundings: InverseDepthMap, azimuth_rad: Array, slope: Array) -> Array:
    """Inverse horizontal distance, 1 / m, of what is seen in these directions (...)."""
    azimuth, slope = np.broadcast_arrays(azimuth_rad, slope)
    near = np.zeros(azimuth.size)
    if len(surroundings.walls):
        _near_all(kernel_hall(surroundings), azimuth.ravel(), slope.ravel(), near)
    return near.reshape(azimuth.shape)


BESIDE: Final = 0.01
"""Of a projection centre so far from the axis, in metres or camera heights, the hall that it sees is looked up where it
stands from the axis, and not where it is seen."""
NODES: Final = 6
FOOT: Final = 0.01
"""Inverse heights of the camera over which the floor passes into a wall. Were it an edge, a wall that is too far off
would be held there by its foot: of the floor's pixels none would say that it should be nearer. Where the projection
centre is 12 cm off the axis, twice as much makes the focal length 0.04 % too short."""


@njit(cache=True, nogil=True)
def near_at(hall: Hall, azimuth: float, slope: float, nodes: NDArray[np.int64], shares: Array) -> float:
    """`inverse_distance` in one direction, for other kernels; linear between neighbours. ``nodes`` (NODES,) takes the
    indices of what it is made of, in walls followed by departures, and ``shares`` (NODES,) the derivatives by these."""
    height, walls, departures, slopes, lean = hall
    rows, around = departures.shape
    up = min(max((slope - slopes[0]) / (slopes[1] - slopes[0]), 0.0), 1.0) * (rows - 1)
    row = min(int(up), rows - 2)
    turns = azimuth / (2 * np.pi)
    left = (turns - np.floor(turns)) * around  # faster than the remainder
    column = min(int(left), around - 1)
    beyond = column + 1 if column + 1 < around else 0
    b, a = up - row, left - column
    rise = lean[0] * np.cos(azimuth) + lean[1] * np.sin(azimuth)
    wall, floor = (1 - a) * walls[column] + a * walls[beyond], (rise - slope) / height
    nodes[0], nodes[1] = column, beyond
    nodes[2], nodes[3] = around * (row + 1) + column, around * (row + 1) + beyond
    nodes[4], nodes[5] = nodes[2] + around, nodes[3] + around
    shares[2], shares[3], shares[4], shares[5] = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    nearer = (
        1.0 + shares[2] * departures[row, column] + shares[3] * departures[row, beyond]
        + shares[4] * departures[row + 1, column] + shares[5] * departures[row + 1, beyond]
    )  # fmt: skip
    apart = np.sqrt((wall - floor) ** 2 + (FOOT / height) ** 2)
    nearest = 0.5 * (wall + floor + apart)  # the larger of the two, but for the foot
    before = 0.5 * (1.0 + (wall - floor) / apart) * nearer
    shares[0], shares[1] = before * (1 - a), before * a
    for k in range(2, NODES):
        shares[k] *= nearest
    return nearest * nearer


@njit(cache=True, nogil=True, error_model="numpy")
def axis_direction(
    hall: Hall, azimuth: float, slope: float, toward: tuple[float, float, float], centre: tuple[float, float, float],
    nodes: NDArray[np.int64], shares: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Azimuth, slope and inverse distance, from the pan axis, of what is seen from a ``centre``, forward, left and up
    of it; ``toward`` are the pan, and cosine and sine of ``azimuth``, which counts from that. Where the centre is far
    from the axis, the hall is looked up again where it is. ``nodes`` and ``shares`` as in `near_at`."""
    pan, cos_a, sin_a = toward
    forward, left, up = centre
    near = near_at(hall, pan + azimuth, slope, nodes, shares)
    turned, level = parallax_back(cos_a, sin_a, slope, near, forward, left, up)
    if forward * forward + left * left > BESIDE * BESIDE:
        near = near_at(hall, pan + azimuth + turned, level, nodes, shares)
        turned, level = parallax_back(cos_a, sin_a, slope, near, forward, left, up)
    return azimuth + turned, level, near


@njit(cache=True, nogil=True)
def _near_all(hall: Hall, azimuth: Array, slope: Array, near: Array) -> None:
    nodes, shares = np.empty(NODES, np.int64), np.empty(NODES)
    for n in range(len(near)):
        near[n] = near_at(hall, azimuth[n], slope[n], nodes, shares)


def from_centre(panorama: Panorama, view: View, azimuth_rad: Array, slope: Array) -> tuple[Array, Array]:
    """Directions (...) of the panorama, as they are seen from the projection centre."""
    near = inverse_distance(panorama.surroundings, azimuth_rad, slope)
    d_azimuth, d_slope = parallax(view, azimuth_rad, slope, near)
    return azimuth_rad + d_azimuth, slope + d_slope


def smooth_map(function: Callable[[Array], Array], width: int, height: int) -> tuple[Float32, Float32]:
    """Evaluate ``function``, pixels (..., 2) to pixels (..., 2), for a whole image: columns and rows, each (H, W).

    It has to be smooth: it is evaluated at every GRID pixels and interpolated by cubic splines. Straight lines would
    all err to the same side, and make the panorama a hundred thousandth too high.
    """
    (u, across), (v, down) = _splines(width), _splines(height)
    nodes = function(np.stack(np.meshgrid(u, v), axis=-1))
    column, row = (down @ nodes[..., k] @ across.T for k in range(2))
    return column.astype(np.float32), row.astype(np.float32)


@lru_cache(maxsize=64)
def _splines(size: int) -> tuple[Array, Array]:
    """Nodes (N,) of a grid over so many pixels, and beyond; what each adds to the spline at every pixel (size, N)."""
    nodes = np.arange(-GRID, size + 2 * GRID, GRID, dtype=np.float64)
    return nodes, np.asarray(make_interp_spline(nodes, np.eye(len(nodes)), k=3)(np.arange(size)))
