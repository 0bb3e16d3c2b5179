"""Transfer of a pixel from the first frame of a match to the second, which sees there what the first shows, with
derivatives: a kernel for features (`bundle_adjustment`) and grey values (`grey_value_equations`) alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.parameters import CENTRE
from pzcap.geometry.camera import HIGHER, SEEN, VIEW, direction_to_pixel_with_derivatives, pixel_to_direction_kernel
from pzcap.geometry.cylinder import NODES, Hall, axis_direction
from pzcap.types import Array

SIDES = 2 * VIEW + HIGHER
"""Number of values, beside the inverse distance, on which a match depends: both views' PARAMETERS and centres, and the
lens's k2, p1 and p2, which they share."""


class Transfer(NamedTuple):
    """A pixel of the first frame as the second sees it; `transfer` fills it in."""

    pixel: Array  # (2,)
    by_views: Array  # (2, SIDES) derivatives by both views and their lens
    by_near: Array  # (2,) and by the inverse distance there
    nodes: NDArray[np.int64]  # (NODES,) of which that is made (`cylinder.near_at`)
    shares: Array  # (NODES,)
    here: Array  # (2, SEEN) scratch, as the next ones: memory that a kernel asks for by the pixel costs half its time
    there: Array  # (2, SEEN)
    by_centre: Array  # (2, 2, 3) parallax by inverse distance times centre: back from the first view, on to the second


@njit(cache=True, nogil=True)
def new_transfer() -> Transfer:
    pixel, by_views, by_near = np.empty(2), np.empty((2, SIDES)), np.empty(2)
    nodes, shares, by_centre = np.zeros(NODES, np.int64), np.zeros(NODES), np.zeros((2, 2, 3))
    return Transfer(pixel, by_views, by_near, nodes, shares, np.empty((2, SEEN)), np.empty((2, SEEN)), by_centre)


@njit(cache=True, nogil=True)
def transfer(first: Array, second: Array, u: float, v: float, hall: Hall, out: Transfer) -> None:
    """Project what the ``first`` view shows at (u, v) into the ``second``, with derivatives; those by the centres are
    to first order, and how the parallax itself turns with the view is left out: some thousandths."""
    pixel, by_views, by_near, nodes, shares, here, there, by_centre = out
    azimuth, slope = pixel_to_direction_kernel(first, u, v)
    direction_to_pixel_with_derivatives(first, azimuth, slope, here)
    near, moved, lifted = 0.0, 0.0, 0.0  # parallax of azimuth and slope, by the inverse distance
    if len(hall[1]):
        away = azimuth - first[0]
        toward = first[0], np.cos(away), np.sin(away)
        centre = first[CENTRE], first[CENTRE + 1], first[CENTRE + 2]
        away, slope, near = axis_direction(hall, away, slope, toward, centre, nodes, shares)
        azimuth = first[0] + away
        back, on = (
            _by_centre(first, azimuth, slope, -1.0, by_centre[0]),
            _by_centre(second, azimuth, slope, 1.0, by_centre[1]),
        )
        moved, lifted = back[0] + on[0], back[1] + on[1]
        # on to the second centre, as `geometry.parallax.parallax` has it
        sin_a, cos_a = np.sin(azimuth - second[0]), np.cos(azimuth - second[0])
        forward, left, up = near * second[CENTRE], near * second[CENTRE + 1], near * second[CENTRE + 2]
        across, ahead = forward * sin_a - left * cos_a, 1.0 - forward * cos_a - left * sin_a
        azimuth += np.arctan2(across, ahead)
        slope = (slope - up) / np.sqrt(across * across + ahead * ahead)
    direction_to_pixel_with_derivatives(second, azimuth, slope, there)
    # the pixel in the first frame stays: its direction moves against what the parameters do to it
    determinant = here[0, 8] * here[1, 9] - here[0, 9] * here[1, 8]
    for row in range(2):
        pixel[row] = there[row, 0]
        back_u = (there[row, 8] * here[1, 9] - there[row, 9] * here[1, 8]) / determinant
        back_v = (there[row, 9] * here[0, 8] - there[row, 8] * here[0, 9]) / determinant
        for k in range(CENTRE):
            by_views[row, k] = -(back_u * here[0, 1 + k] + back_v * here[1, 1 + k])
            by_views[row, VIEW + k] = there[row, 1 + k]
        for k in range(10, SEEN):
            back = back_u * here[0, k] + back_v * here[1, k]
            by_views[row, SIDES - SEEN + k] = there[row, k] - back
        for side in range(2):
            for axis in range(3):
                along = there[row, 8] * by_centre[side, 0, axis] + there[row, 9] * by_centre[side, 1, axis]
                by_views[row, side * VIEW + CENTRE + axis] = near * along
        by_near[row] = there[row, 8] * moved + there[row, 9] * lifted


@njit(cache=True, nogil=True)
def _by_centre(view: Array, azimuth: float, slope: float, sign: float, out: Array) -> tuple[float, float]:
    """Parallax of a direction from the pan axis to the projection centre, by inverse distance; ``out`` (2, 3) takes
    what it is by the centre."""
    sin_a, cos_a = sign * np.sin(azimuth - view[0]), sign * np.cos(azimuth - view[0])
    out[0, 0], out[0, 1], out[1, 0], out[1, 1], out[1, 2] = sin_a, -cos_a, slope * cos_a, slope * sin_a, -sign
    forward, left, up = view[CENTRE], view[CENTRE + 1], view[CENTRE + 2]
    return sin_a * forward - cos_a * left, slope * (cos_a * forward + sin_a * left) - sign * up
