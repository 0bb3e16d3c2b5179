"""Normal equations of grey values: those of `pzcap.calibration.bundle_adjustment`, a row a pixel that is compared."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from pzcap.calibration.compared_pixels import ComparedPixels
from pzcap.calibration.link_sums import add_link, add_nodes, new_link_sums
from pzcap.calibration.parameters import ViewJacobians
from pzcap.calibration.transfer import SIDES, new_transfer, transfer
from pzcap.geometry.camera import VIEW
from pzcap.geometry.cylinder import NODES, Hall
from pzcap.imaging.bspline import Stored, cubic
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array

WIDTH: Final = SIDES + 3  # of a pixel's row: derivatives by both views, residual, derivatives by gain and shading


@njit(cache=True, nogil=True)
def accumulate(
    pixels: ComparedPixels, images: Stored, jacobians: ViewJacobians, hall: Hall, scale: float, normal: Array,
    gradient: Array,
) -> float:  # fmt: skip
    """Add up normal matrix (U, U), gradient (U,) and cost of all pixels, each overlap's gain and shading eliminated by
    the Schur complement."""
    seen, cost, sums = new_transfer(), 0.0, new_link_sums(hall)
    along, touched = np.empty(SIDES), np.empty(NODES, np.int64)
    most = hall[1].size + hall[2].size
    lit_by_nodes = np.empty((2, most))
    for link in range(len(pixels.ends)):
        first, second = jacobians.views[pixels.ends[link, 0]], jacobians.views[pixels.ends[link, 1]]
        image, gains = images[pixels.ends[link, 1]], pixels.gains[link]
        begin, end = pixels.bounds[link], pixels.bounds[link + 1]
        used, count = 0, 0
        lit_by_nodes[:] = 0.0
        # a row a pixel: both views, the residual, gain and shading
        rows, weights = np.empty((end - begin, WIDTH)), np.empty(end - begin)
        for n in range(begin, end):
            u, v = float(pixels.points[n, 0]), float(pixels.points[n, 1])
            transfer(first, second, u, v, hall, seen)
            inside, value, by_x, by_y = cubic(image, seen.pixel[0], seen.pixel[1])
            if not inside:
                pixels.residual[n] = np.inf
                continue
            pixels.row[n] = seen.pixel[1]
            lit = pixels.grey[n]
            shaded = lit * (_radial(seen.pixel[0], seen.pixel[1], images) - _radial(u, v, images))
            difference = value - gains[0] * lit - gains[1] * shaded
            pixels.residual[n] = difference
            weight = geman_mcclure(difference, scale)
            cost += weight * difference * difference
            row = rows[used]
            for k in range(SIDES):
                row[k] = by_x * seen.by_views[0, k] + by_y * seen.by_views[1, k]
            row[SIDES], row[SIDES + 1], row[SIDES + 2], weights[used] = difference, -lit, -shaded, weight
            used += 1
            if most:
                near = by_x * seen.by_near[0] + by_y * seen.by_near[1]
                pull = weight * near
                for k in range(SIDES):
                    along[k] = pull * row[k]
                count = add_nodes(sums, count, seen, along, pull * near, pull * difference, touched)
                for k in range(NODES):
                    lit_by_nodes[0, touched[k]] -= seen.shares[k] * pull * lit
                    lit_by_nodes[1, touched[k]] -= seen.shares[k] * pull * shaded
        rows = rows[:used]
        summed = (rows * weights[:used].reshape(-1, 1)).T @ rows
        shade, shade_by = summed[SIDES + 1 :, SIDES + 1 :].copy(), summed[SIDES + 1 :, :SIDES].copy()
        shade_along = summed[SIDES + 1 :, SIDES].copy()
        shade[0, 0] += 1e-9
        shade[1, 1] += 1e-9 + 1e-3 * shade[0, 0]  # frames are flattened before: little shading is left
        shade_along[1] += 1e-3 * shade[0, 0] * gains[1]
        solved = np.linalg.inv(shade)
        gains -= solved @ shade_along
        by_nodes = lit_by_nodes[:, :count].copy()
        to_views, to_nodes = solved @ shade_by, solved @ by_nodes
        sums.views[:] = summed[:SIDES, :SIDES] - shade_by.T @ to_views
        sums.by_views[:] = summed[:SIDES, SIDES] - to_views.T @ shade_along
        sums.cross[:count] -= by_nodes.T @ to_views
        sums.nodes[:count, :count] -= by_nodes.T @ to_nodes
        sums.by_nodes[:count] -= to_nodes.T @ shade_along
        pixels.overlap_cost[link] = _overlap_cost(sums.views, sums.by_views)
        add_link(sums, count, jacobians, pixels.ends[link], normal, gradient)
    return cost


@njit(cache=True, nogil=True)
def _overlap_cost(summed: Array, along: Array) -> float:
    """Squared distance, in units of the normal matrix, from where an overlap's second frame is to where the overlap
    alone would have it, by its pan, tilt, focal length and roll."""
    own, pull = summed[VIEW : VIEW + 4, VIEW : VIEW + 4].copy(), along[VIEW : VIEW + 4].copy()
    for k in range(4):
        own[k, k] *= 1.0 + 1e-9
        own[k, k] += 1e-12
    return float(pull @ np.linalg.solve(own, pull))


@njit(cache=True, nogil=True, inline="always")
def _radial(u: float, v: float, images: Stored) -> float:
    """Squared distance from the middle of a frame, 1 in its corners."""
    x, y = (images.shape[2] - 1) / 2, (images.shape[1] - 1) / 2
    return ((u - x) ** 2 + (v - y) ** 2) / (x * x + y * y)
