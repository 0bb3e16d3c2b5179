"""Robust least squares over matches between frames of one camera on its head: pans, zooms, tilt, roll and lens at once.

Every frame has a pan and a focal length, which it may share with others: the frames of the sweep share the focal
length, those of the zoom run the pan. All share tilt, roll and the lens, polynomials in log focal. A match says that
two pixels of two frames show the same direction; its residual is where the first frame's point would be seen in the
second, minus where it was seen, in pixels of the second. No world points are estimated: between two views from one
point, a rotation carries pixels to pixels (Shum and Szeliski, 2000).

The views are not quite from one point: the slide head leaves the projection centre some millimetres beside the pan
axis, and as the lens zooms it travels along its own, which moves near things by a pixel. How near things are is known
only roughly before, and estimated, too: a floor, walls, and what departs from these. Lengths are in heights of the
camera over the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.parameters import (
    CENTRE,
    Model,
    Sigmas,
    chains_of,
    information,
    nearness_size,
    stepped,
    vector,
    vectors,
)
from pzcap.geometry.camera import SEEN, VIEW, direction_to_pixel_with_derivatives, pixel_to_direction_kernel
from pzcap.geometry.cylinder import NODES, Hall, kernel_hall, near_at
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array

SETTLED_RAD = 1e-5  # a step this small ends the adjustment: a hundredth of a pixel
LEAST_SPREAD_PX = 0.01  # no match is better than this, however well all agree


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Matches between two frames."""

    first: int
    second: int
    first_px: Array  # (N, 2)
    second_px: Array  # (N, 2)
    log_ratio: Array  # (N,) log of the second frame's brightness there over the first's


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    model: Model
    residual_px: float  # RMS of the inliers
    inliers: NDArray[np.int64]  # a link


def adjust(
    start: Model,
    links: Sequence[Link],
    sigmas: Sigmas,
    *,
    prior: Model | None = None,
    scale_px: float = 8.0,
    iterations: int = 20,
) -> Adjusted:
    """Fit the model to ``links``; the pan of the first frame stays what it is.

    ``sigmas`` are about ``prior``, or else about ``start``. Weights fall with a residual's length (Geman and McClure,
    1987), by a scale that starts at ``scale_px`` and follows the residuals down.
    """
    mean = vector(start if prior is None else prior)
    model, scale = start, scale_px
    believed = information(start, sigmas)
    ends = np.array([[link.first, link.second] for link in links])
    bounds = np.cumsum([0, *(len(link.first_px) for link in links)])
    pixels = np.vstack([np.hstack([link.first_px, link.second_px]) for link in links])
    length = np.empty(len(pixels))
    for _ in range(iterations):
        normal, gradient = _normal_equations(model, ends, bounds, pixels, scale, length)
        spread = max(float(np.median(length)) / 1.1774, LEAST_SPREAD_PX)  # of one coordinate
        normal += believed * spread**2
        gradient += spread**2 * believed @ (vector(model) - mean)
        normal[model.pan_of[0]] = 0.0
        normal[model.pan_of[0], model.pan_of[0]] = 1.0
        gradient[model.pan_of[0]] = 0.0
        step = np.asarray(-np.linalg.solve(normal, gradient), np.float64)
        model = stepped(model, step)
        next_scale = max(3.0 * spread, 0.1)
        if np.abs(step[: len(model.pan_rad)]).max() < SETTLED_RAD and abs(next_scale - scale) < 0.05 * scale:
            break
        scale = max(next_scale, scale / 3.0)
    good = length < 2.0 * scale
    return Adjusted(
        model, float(np.sqrt(np.mean(length[good] ** 2))), np.add.reduceat(good.astype(np.int64), bounds[:-1])
    )


def thinned(links: Sequence[Link], every: int) -> list[Link]:
    """One match in ``every``, for a quick first adjustment."""
    keep = slice(None, None, every)
    return [
        Link(link.first, link.second, link.first_px[keep], link.second_px[keep], link.log_ratio[keep]) for link in links
    ]


# --------------------------------------------------------------------------------------------------------------
# A match: where the second frame sees what the first frame shows at a pixel


def residuals(model: Model, link: Link) -> tuple[Array, Array]:
    """Residuals (N, 2) of a link's matches, and their derivatives (N, 2, U) with respect to the vector of unknowns."""
    views = vectors(model)
    chains, columns = chains_of(model)
    unknowns = len(vector(model))
    nearness = unknowns - nearness_size(model)
    around = kernel_hall(model.surroundings)
    residual, jacobian = np.empty((len(link.first_px), 2)), np.zeros((len(link.first_px), 2, unknowns))
    local, by_near, nodes, shares = np.empty((2, SIDES)), np.empty(2), np.zeros(NODES, np.int64), np.zeros(NODES)
    for n, (first_px, second_px) in enumerate(zip(link.first_px, link.second_px, strict=True)):
        seen = residual[n]
        transfer(
            views[link.first], views[link.second], first_px[0], first_px[1], around, seen, local, by_near, nodes, shares
        )  # fmt: skip
        seen -= second_px
        for side, frame in enumerate((link.first, link.second)):
            part = local[:, side * VIEW : (side + 1) * VIEW] @ chains[frame]
            np.add.at(jacobian[n].T, columns[frame], part.T)
        if nearness < unknowns:
            np.add.at(jacobian[n].T, nearness + nodes, np.outer(shares, by_near))
    return residual, jacobian


SIDES = 2 * VIEW
"""What a match depends on, beside the nearness: both views' PARAMETERS and projection centres."""


@njit(cache=True, nogil=True)
def transfer(
    first: Array, second: Array, u: float, v: float, hall: Hall, seen: Array, jacobian: Array, by_near: Array,
    nodes: NDArray[np.int64], shares: Array,
) -> None:  # fmt: skip
    """Where the second frame sees (2,) what the first shows at (u, v); its derivatives with respect to both views
    (2, SIDES) and to the nearness there (2,); and ``nodes`` and ``shares`` of that (`cylinder.near_at`).

    How the parallax itself turns with the view is left out of the derivatives: some thousandths.
    """
    azimuth, slope = pixel_to_direction_kernel(first, u, v)
    here, there = np.empty((2, SEEN)), np.empty((2, SEEN))
    direction_to_pixel_with_derivatives(first, azimuth, slope, here)
    by_centre = np.zeros((2, 2, 3))  # of (azimuth, slope) on the way, by nearness times centre: of first and second
    towards = np.zeros(2)
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
                    towards[k] += by_centre[side, k, axis] * view[CENTRE + axis]
    direction_to_pixel_with_derivatives(second, azimuth + near * towards[0], slope + near * towards[1], there)
    # the pixel in the first frame stays: its direction moves against what the parameters do to it
    determinant = here[0, 8] * here[1, 9] - here[0, 9] * here[1, 8]
    for row in range(2):
        seen[row] = there[row, 0]
        back_u = (there[row, 8] * here[1, 9] - there[row, 9] * here[1, 8]) / determinant
        back_v = (there[row, 9] * here[0, 8] - there[row, 8] * here[0, 9]) / determinant
        for k in range(CENTRE):
            jacobian[row, k] = -(back_u * here[0, 1 + k] + back_v * here[1, 1 + k])
            jacobian[row, VIEW + k] = there[row, 1 + k]
        for side in range(2):
            for axis in range(3):
                along = there[row, 8] * by_centre[side, 0, axis] + there[row, 9] * by_centre[side, 1, axis]
                jacobian[row, side * VIEW + CENTRE + axis] = near * along
        by_near[row] = there[row, 8] * towards[0] + there[row, 9] * towards[1]


@njit(cache=True, nogil=True)
def numbered(
    first: Array, points: Array | NDArray[np.int16], hall: Hall, number: NDArray[np.int64], used: NDArray[np.int64]
) -> int:
    """Number the nodes of the nearness that the points (N, 2) of a frame touch: how many they are, ``used`` (A + R A,)
    their indices, and ``number`` (A + R A,) the inverse of that."""
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


def _normal_equations(
    model: Model, ends: NDArray[np.int64], bounds: NDArray[np.int64], pixels: Array, scale: float, length: Array
) -> tuple[Array, Array]:
    """Normal matrix (U, U) and gradient (U,) of all matches; ``length`` (N,) takes the lengths of their residuals."""
    unknowns = len(vector(model))
    normal, gradient = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    _accumulate(
        ends,
        bounds,
        pixels,
        vectors(model),
        *chains_of(model),
        kernel_hall(model.surroundings),
        scale,
        length,
        normal,
        gradient,
    )
    return normal, gradient


@njit(cache=True, nogil=True)
def _accumulate(
    ends: NDArray[np.int64], bounds: NDArray[np.int64], pixels: Array, views: Array, chains: Array,
    columns: NDArray[np.int64], hall: Hall, scale: float, length: Array, normal: Array, gradient: Array,
) -> None:  # fmt: skip
    """Sum up a link's matches by what they depend on, then carry the sums over to the unknowns by the chain rule."""
    seen, jacobian, by_near = np.empty(2), np.empty((2, SIDES)), np.empty(2)
    nodes, shares = np.zeros(NODES, np.int64), np.zeros(NODES)
    number, used = np.empty((2, hall[1].size + hall[2].size), np.int64)
    touched = np.arange(SIDES + NODES if len(hall[1]) else SIDES)
    for link in range(len(ends)):
        first, second = views[ends[link, 0]], views[ends[link, 1]]
        matches = pixels[bounds[link] : bounds[link + 1]]
        count = numbered(first, matches, hall, number, used)
        summed, along, row = np.zeros((SIDES + count, SIDES + count)), np.zeros(SIDES + count), np.zeros(SIDES + count)
        for n in range(len(matches)):
            transfer(first, second, matches[n, 0], matches[n, 1], hall, seen, jacobian, by_near, nodes, shares)
            residual = seen - matches[n, 2:]
            squared = residual[0] * residual[0] + residual[1] * residual[1]
            length[bounds[link] + n] = np.sqrt(squared)
            weight = geman_mcclure(squared / (scale * scale))
            for k in range(len(touched) - SIDES):
                touched[SIDES + k] = SIDES + number[nodes[k]]
            for side in range(2):
                row[:SIDES] = jacobian[side]
                for k in range(len(touched) - SIDES):
                    row[touched[SIDES + k]] = shares[k] * by_near[side]
                for i in touched:
                    weighted = weight * row[i]
                    along[i] += weighted * residual[side]
                    for j in touched:
                        summed[i, j] += weighted * row[j]
        carry(summed, along, chains, columns, ends[link], used[:count], normal, gradient)


@njit(cache=True, nogil=True)
def carry(
    summed: Array, along: Array, chains: Array, columns: NDArray[np.int64], ends: NDArray[np.int64],
    used: NDArray[np.int64], normal: Array, gradient: Array,
) -> None:  # fmt: skip
    """Add a link's normal matrix and gradient, with respect to both views and the nodes ``used``, to those of the
    unknowns, by the chain rule."""
    width = columns.shape[1]
    chain, into = np.zeros((len(along), 2 * width + len(used))), np.empty(2 * width + len(used), np.int64)
    for side in range(2):
        chain[side * VIEW : (side + 1) * VIEW, side * width : (side + 1) * width] = chains[ends[side]]
        into[side * width : (side + 1) * width] = columns[ends[side]]
    chain[SIDES:, 2 * width :] = np.eye(len(used))
    # the nearness comes after all that a view depends on
    into[2 * width :] = columns.max() + 1 + used
    whole, part = chain.T @ (summed @ chain), chain.T @ along
    for i in range(len(into)):
        gradient[into[i]] += part[i]
        for j in range(len(into)):
            normal[into[i], into[j]] += whole[i, j]
