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

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.beliefs import Sigmas, information
from pzcap.calibration.link_sums import add_link, add_nodes, new_link_sums
from pzcap.calibration.parameters import (
    CalibrationParameters,
    ViewJacobians,
    place_of_k2,
    retract,
    to_vector,
    view_jacobians,
)
from pzcap.calibration.transfer import SIDES, new_transfer, transfer
from pzcap.calibration.tuning import BUNDLE
from pzcap.geometry.cylinder import NODES, Hall, kernel_hall
from pzcap.solver.gauss_newton import NormalEquations, Prior, Schedule, Solution, SolveReport, minimise
from pzcap.solver.robust import geman_mcclure, planar_sigma
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
    k2_drawn: float  # k2 over the standard deviation by which matches draw that of a usual lens from 0


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
        _k2_drawn(solution, sigmas),
    )  # fmt: skip


def _k2_drawn(solution: Solution[CalibrationParameters], sigmas: Sigmas) -> float:
    """`Adjusted.k2_drawn`: of the variance that is believed a part is left by the matches, which draw by the other."""
    place, believed = place_of_k2(solution.state), float(sigmas.higher[0]) ** 2
    left = solution.sigma**2 * float(np.linalg.inv(solution.normal)[place, place])
    return float(solution.state.higher[0]) / math.sqrt(max(believed - left, 1e-12 * believed))


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
    return NormalEquations(normal, gradient, max(planar_sigma(length), BUNDLE.least_sigma_px), cost)


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
