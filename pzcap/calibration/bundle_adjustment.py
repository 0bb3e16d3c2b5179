"""Bundle adjustment of one camera on its head: pans, zooms, tilt, roll and lens from matches between its frames.

Every frame has a pan and a focal length, which it may share with others: the frames of the sweep share the focal
length, those of the zoom run the pan. All share tilt, roll and the lens, polynomials in log focal. A match says that
two pixels of two frames show the same direction; its residual is where the first frame's point would be seen in the
second, minus where it was seen, in pixels of the second. No world points are estimated: between two views from one
point, a rotation carries pixels to pixels (Shum and Szeliski, 2000).

The views are not quite from one point: the slide head leaves the projection centre some millimetres beside the pan
axis, and zooming moves it along the optical axis, which shifts near things by a pixel. How near they are is estimated,
too: a floor, walls, and what departs from these. Lengths are in heights of the camera over the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.parameters import (
    CENTRE,
    CalibrationParameters,
    Sigmas,
    ViewJacobians,
    information,
    retract,
    to_vector,
    view_jacobians,
)
from pzcap.calibration.tuning import BUNDLE
from pzcap.geometry.camera import HIGHER, SEEN, VIEW, direction_to_pixel_with_derivatives, pixel_to_direction_kernel
from pzcap.geometry.cylinder import NODES, Hall, kernel_hall, near_at
from pzcap.solver.gauss_newton import NormalEquations, Prior, Schedule, SolveReport, minimise
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Matches between two frames."""

    first: int
    second: int
    first_px: Array  # (N, 2)
    second_px: Array  # (N, 2)
    log_ratio: Array  # (N,) log of the second frame's brightness there over the first's

    def subset(self, which: Mask | slice) -> Link:
        """Some of the matches."""
        return Link(self.first, self.second, self.first_px[which], self.second_px[which], self.log_ratio[which])


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Result of `adjust`."""

    parameters: CalibrationParameters
    residual_px: float  # RMS of the inliers
    inliers: NDArray[np.int64]  # a link
    report: SolveReport


def adjust(
    start: CalibrationParameters, links: Sequence[Link], sigmas: Sigmas, *, prior: CalibrationParameters | None = None,
    scale_px: float = 8.0, iterations: int = 20,
) -> Adjusted:  # fmt: skip
    """Fit the parameters to ``links``; the pan of the first frame is held. ``sigmas`` are about ``prior``, or else
    about ``start``; the scale of the weights starts at ``scale_px`` and follows the residuals down."""
    mean, believed = to_vector(start if prior is None else prior), information(start, sigmas)
    matches = matches_of(links)
    length = np.empty(len(matches.pixels))
    solution = minimise(
        start, lambda state, scale: normal_equations(state, matches, scale, length), retract,
        lambda step: np.abs(step[: len(start.pan_rad)]).max() < BUNDLE.settled_rad,
        Schedule(iterations, scale_px, least_scale=0.1, steady=0.05),
        prior=Prior(believed, lambda state: to_vector(state) - mean), held=int(start.pan_of[0]),
    )  # fmt: skip
    good = length < 2.0 * solution.scale
    return Adjusted(
        solution.state, float(np.sqrt(np.mean(length[good] ** 2))),
        np.add.reduceat(good.astype(np.int64), matches.bounds[:-1]), solution.report,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------------------
# A match: where the second frame sees what the first frame shows at a pixel


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


@njit(cache=True, nogil=True)
def new_transfer() -> Transfer:
    return Transfer(np.empty(2), np.empty((2, SIDES)), np.empty(2), np.zeros(NODES, np.int64), np.zeros(NODES))


@njit(cache=True, nogil=True)
def transfer(first: Array, second: Array, u: float, v: float, hall: Hall, out: Transfer) -> None:
    """Project what the ``first`` view shows at (u, v) into the ``second``, with derivatives, but for how the parallax
    itself turns with the view: some thousandths."""
    pixel, by_views, by_near, nodes, shares = out
    azimuth, slope = pixel_to_direction_kernel(first, u, v)
    here, there = np.empty((2, SEEN)), np.empty((2, SEEN))
    direction_to_pixel_with_derivatives(first, azimuth, slope, here)
    # parallax of (azimuth, slope) by inverse distance times centre: back from the first, on to the second
    by_centre, parallax = np.zeros((2, 2, 3)), np.zeros(2)
    near = 0.0
    if len(hall[1]):
        near = near_at(hall, azimuth, slope, nodes, shares)
        for side, view, sign in ((0, first, -1.0), (1, second, 1.0)):
            sin_a, cos_a = np.sin(azimuth - view[0]), np.cos(azimuth - view[0])
            by_centre[side, 0, 0], by_centre[side, 0, 1] = sign * sin_a, -sign * cos_a
            by_centre[side, 1, 0], by_centre[side, 1, 1] = sign * slope * cos_a, sign * slope * sin_a
            by_centre[side, 1, 2] = -sign
            for k in range(2):
                for axis in range(3):
                    parallax[k] += by_centre[side, k, axis] * view[CENTRE + axis]
    direction_to_pixel_with_derivatives(second, azimuth + near * parallax[0], slope + near * parallax[1], there)
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
        by_near[row] = there[row, 8] * parallax[0] + there[row, 9] * parallax[1]


class Matches(NamedTuple):
    """All links' matches, for kernels."""

    ends: NDArray[np.int64]  # (L, 2) frames of each link
    bounds: NDArray[np.int64]  # (L + 1,) where each link's matches begin
    pixels: Array  # (N, 4) in the first frame, in the second


def matches_of(links: Sequence[Link]) -> Matches:
    """The matches of ``links`` one after the other."""
    bounds = np.cumsum([0, *(len(link.first_px) for link in links)])
    pixels = np.vstack([np.hstack([link.first_px, link.second_px]) for link in links])
    return Matches(np.array([[link.first, link.second] for link in links]), bounds, pixels)


def normal_equations(state: CalibrationParameters, matches: Matches, scale: float, length: Array) -> NormalEquations:
    """All matches linearised; ``length`` (N,) takes the lengths of their residuals."""
    count = len(to_vector(state))
    normal, gradient = np.zeros((count, count)), np.zeros(count)
    hall = kernel_hall(state.surroundings)
    cost = _accumulate(matches, view_jacobians(state), hall, scale, length, normal, gradient)
    # the median length of a pair of normal coordinates is 1.1774 standard deviations of one
    return NormalEquations(normal, gradient, max(float(np.median(length)) / 1.1774, BUNDLE.least_sigma_px), cost)


@njit(cache=True, nogil=True)
def hall_nodes(
    first: Array, points: Array | NDArray[np.int16], hall: Hall, number: NDArray[np.int64], used: NDArray[np.int64]
) -> int:
    """Number the nodes of the inverse distance that the points (N, 2) of a frame touch, and count them: ``used``
    (A + R A,) takes their indices, ``number`` (A + R A,) the inverse of that, a node's number or -1."""
    count = 0
    number[:] = -1
    nodes, shares = np.empty(NODES, np.int64), np.empty(NODES)
    for n in range(len(points) if len(hall[1]) else 0):
        azimuth, slope = pixel_to_direction_kernel(first, points[n, 0], points[n, 1])
        near_at(hall, azimuth, slope, nodes, shares)
        for node in nodes:
            if number[node] < 0:
                number[node] = count
                used[count] = node
                count += 1
    return count


@njit(cache=True, nogil=True)
def _accumulate(
    matches: Matches, jacobians: ViewJacobians, hall: Hall, scale: float, length: Array, normal: Array, gradient: Array
) -> float:
    """Add up normal matrix (U, U), gradient (U,) and cost of all matches, and note their residuals' ``length`` (N,): a
    link's by the views and nodes that they depend on, which `add_link` carries over to the parameters."""
    seen, cost = new_transfer(), 0.0
    number, used = np.empty((2, hall[1].size + hall[2].size), np.int64)
    touched = np.arange(SIDES + NODES if len(hall[1]) else SIDES)
    for link in range(len(matches.ends)):
        first, second = jacobians.views[matches.ends[link, 0]], jacobians.views[matches.ends[link, 1]]
        pixels = matches.pixels[matches.bounds[link] : matches.bounds[link + 1]]
        count = hall_nodes(first, pixels, hall, number, used)
        summed, along, row = np.zeros((SIDES + count, SIDES + count)), np.zeros(SIDES + count), np.zeros(SIDES + count)
        for n in range(len(pixels)):
            transfer(first, second, pixels[n, 0], pixels[n, 1], hall, seen)
            residual = seen.pixel - pixels[n, 2:]
            squared = residual[0] * residual[0] + residual[1] * residual[1]
            length[matches.bounds[link] + n] = np.sqrt(squared)
            weight = geman_mcclure(np.sqrt(squared), scale)
            cost += weight * squared
            for k in range(len(touched) - SIDES):
                touched[SIDES + k] = SIDES + number[seen.nodes[k]]
            for side in range(2):
                row[:SIDES] = seen.by_views[side]
                for k in range(len(touched) - SIDES):
                    row[touched[SIDES + k]] = seen.shares[k] * seen.by_near[side]
                for k in range(len(touched)):
                    i = touched[k]
                    weighted = weight * row[i]
                    along[i] += weighted * residual[side]
                    for j in touched[: k + 1]:  # each pair once: either way round, since nodes come in any order
                        summed[i, j] += weighted * row[j]
        summed += summed.T - np.diag(np.diag(summed))
        add_link(summed, along, jacobians, matches.ends[link], used[:count], normal, gradient)
    return cost


@njit(cache=True, nogil=True)
def add_link(
    summed: Array, along: Array, jacobians: ViewJacobians, ends: NDArray[np.int64], used: NDArray[np.int64],
    normal: Array, gradient: Array,
) -> None:  # fmt: skip
    """Add a link's normal matrix and gradient, by both views and the nodes ``used``, to those of the parameters by the
    chain rule."""
    columns, width = jacobians.columns, jacobians.columns.shape[1]
    own = 2 * width  # columns of both views' own parameters; those of the lens and the hall follow
    chain = np.zeros((len(along), own + HIGHER + len(used)))
    into = np.empty(own + HIGHER + len(used), np.int64)
    for side in range(2):
        chain[side * VIEW : (side + 1) * VIEW, side * width : (side + 1) * width] = jacobians.by_parameters[ends[side]]
        into[side * width : (side + 1) * width] = columns[ends[side]]
    chain[2 * VIEW :, own:] = np.eye(HIGHER + len(used))
    into[own : own + HIGHER] = jacobians.higher + np.arange(HIGHER)
    into[own + HIGHER :] = columns.max() + 1 + used  # the hall comes after all that a view depends on
    whole, part = chain.T @ (summed @ chain), chain.T @ along
    for i in range(len(into)):
        gradient[into[i]] += part[i]
        for j in range(len(into)):
            normal[into[i], into[j]] += whole[i, j]
