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
from pzcap.geometry.cylinder import NODES, Hall, axis_direction, kernel_hall
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


def enough(links: Sequence[Link]) -> list[Link]:
    """A fifth of the matches: enough for first values, and to hold what grey values leave open."""
    return [link.subset(slice(None, None, 5)) for link in links]


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
        # on to the second centre, as `geometry.camera.parallax` has it
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


class LinkSums(NamedTuple):
    """Normal equations of one link, by both views with their lens (S = SIDES) and by the nodes of the hall that it
    touches, numbered as they come."""

    views: Array  # (S, S)
    by_views: Array  # (S,) gradient
    cross: Array  # (K, S) nodes by views
    nodes: Array  # (K, K)
    by_nodes: Array  # (K,) gradient
    number: NDArray[np.int64]  # (K,) of each node of the hall; -1 where it is not touched
    used: NDArray[np.int64]  # (K,) the node that has a number


@njit(cache=True, nogil=True)
def new_link_sums(hall: Hall) -> LinkSums:
    """Sums for any link: `add_link` leaves them ready for the next."""
    most = hall[1].size + hall[2].size
    number, used = np.full(most, -1), np.empty(most, np.int64)
    sums = np.empty((SIDES, SIDES)), np.empty(SIDES), np.empty((most, SIDES)), np.empty((most, most)), np.empty(most)
    return LinkSums(*sums, number, used)


@njit(cache=True, nogil=True)
def add_nodes(
    sums: LinkSums, count: int, seen: Transfer, along: Array, weight: float, pull: float, touched: NDArray[np.int64]
) -> int:
    """Add the part of a pixel's residuals that depends on the nodes of the hall; how many are touched by then, of
    which ``count`` were before. By inverse distance, ``along`` (S,) is the normal matrix's row of both views,
    ``weight`` its diagonal and ``pull`` the gradient; ``touched`` (NODES,) takes the numbers of the pixel's nodes."""
    _, _, cross, nodes, by_nodes, number, used = sums
    for k in range(NODES):
        node = seen.nodes[k]
        if number[node] < 0:
            number[node], used[count] = count, node
            cross[count, :], nodes[count, : count + 1], nodes[:count, count], by_nodes[count] = 0.0, 0.0, 0.0, 0.0
            count += 1
        touched[k] = number[node]
    for k in range(NODES):
        i, share = touched[k], seen.shares[k]
        by_nodes[i] += share * pull
        for j in range(SIDES):
            cross[i, j] += share * along[j]
        for other in range(NODES):
            nodes[i, touched[other]] += share * weight * seen.shares[other]
    return count


@njit(cache=True, nogil=True)
def _accumulate(
    matches: Matches, jacobians: ViewJacobians, hall: Hall, scale: float, length: Array, normal: Array, gradient: Array
) -> float:
    """Add up normal matrix (U, U), gradient (U,) and cost of all matches, and note their residuals' ``length`` (N,): a
    link's by the views and nodes that they depend on, which `add_link` carries over to the parameters."""
    seen, cost, sums = new_transfer(), 0.0, new_link_sums(hall)
    along, touched = np.empty(SIDES), np.empty(NODES, np.int64)
    for link in range(len(matches.ends)):
        first, second = jacobians.views[matches.ends[link, 0]], jacobians.views[matches.ends[link, 1]]
        pixels, count = matches.pixels[matches.bounds[link] : matches.bounds[link + 1]], 0
        rows, residuals, weights = np.empty((2 * len(pixels), SIDES)), np.empty(2 * len(pixels)), np.empty(len(pixels))
        for n in range(len(pixels)):
            transfer(first, second, pixels[n, 0], pixels[n, 1], hall, seen)
            across, down = seen.pixel[0] - pixels[n, 2], seen.pixel[1] - pixels[n, 3]
            squared = across * across + down * down
            length[matches.bounds[link] + n] = np.sqrt(squared)
            weight = geman_mcclure(np.sqrt(squared), scale)
            cost += weight * squared
            rows[2 * n : 2 * n + 2] = seen.by_views
            residuals[2 * n], residuals[2 * n + 1], weights[n] = across, down, weight
            if len(hall[1]):
                by_u, by_v = weight * seen.by_near[0], weight * seen.by_near[1]
                for k in range(SIDES):
                    along[k] = by_u * seen.by_views[0, k] + by_v * seen.by_views[1, k]
                amount, pull = by_u * seen.by_near[0] + by_v * seen.by_near[1], by_u * across + by_v * down
                count = add_nodes(sums, count, seen, along, amount, pull, touched)
        weighted = rows * np.repeat(weights, 2).reshape(-1, 1)
        sums.views[:], sums.by_views[:] = weighted.T @ rows, weighted.T @ residuals
        add_link(sums, count, jacobians, matches.ends[link], normal, gradient)
    return cost


@njit(cache=True, nogil=True)
def add_link(
    sums: LinkSums, count: int, jacobians: ViewJacobians, ends: NDArray[np.int64], normal: Array, gradient: Array
) -> None:
    """Add a link's sums, ``count`` nodes among them, to those of the parameters by the chain rule, and forget which
    nodes they were."""
    columns, width = jacobians.columns, jacobians.columns.shape[1]
    own = 2 * width + HIGHER  # columns of both views' own parameters, and of the lens
    chain, into = np.zeros((SIDES, own)), np.empty(own, np.int64)
    for side in range(2):
        chain[side * VIEW : (side + 1) * VIEW, side * width : (side + 1) * width] = jacobians.by_parameters[ends[side]]
        into[side * width : (side + 1) * width] = columns[ends[side]]
    chain[2 * VIEW :, 2 * width :] = np.eye(HIGHER)
    into[2 * width :] = jacobians.higher + np.arange(HIGHER)
    whole, part, cross = chain.T @ (sums.views @ chain), chain.T @ sums.by_views, sums.cross[:count] @ chain
    for i in range(own):
        gradient[into[i]] += part[i]
        for j in range(own):
            normal[into[i], into[j]] += whole[i, j]
    hall = columns.max() + 1  # it comes after all that a view depends on
    for k in range(count):
        row = hall + sums.used[k]
        gradient[row] += sums.by_nodes[k]
        for i in range(own):
            normal[row, into[i]] += cross[k, i]
            normal[into[i], row] += cross[k, i]
        for other in range(count):
            normal[row, hall + sums.used[other]] += sums.nodes[k, other]
        sums.number[sums.used[k]] = -1
