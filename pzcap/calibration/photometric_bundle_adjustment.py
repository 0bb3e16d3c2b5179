"""The adjustment of `pzcap.calibration.bundle_adjustment` on grey values: frames of one camera against each other,
pixel by pixel.

Features are found to a quarter of a pixel; the grey values of a few thousand pixels with an edge in them say better
where two frames lie on each other. The residual of a pixel is what the second frame shows where it should see it, minus
the first frame's grey value, made as bright by a gain and a shading that belong to the link. So the same unknowns are
fitted as there, with the same transfer from frame to frame, weighted by the gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.bundle_adjustment import SIDES, carry, numbered, transfer
from pzcap.calibration.parameters import Model, Sigmas, chains_of, information, stepped, vector, vectors
from pzcap.geometry import camera as geometry
from pzcap.geometry.cylinder import NODES, Hall, kernel_hall
from pzcap.imaging.bspline import Stored, at_pixels, cubic, softened_further
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array

TILE = 16  # pixels: edges are taken from everywhere, so many across
BORDER = 6.0  # times the smoothing: pixels at the edge left out, since it reaches beyond
ITERATIONS = 4
DOUBT = 10.0  # what is left over is no noise but the same everywhere: so many pixels are worth one
SETTLED_RAD = 2e-7  # a step this small ends the adjustment: a five thousandth of a pixel


@dataclass(frozen=True, slots=True, eq=False)
class Overlap:
    """Pixels of one frame that another sees."""

    first: int
    second: int
    points_px: NDArray[np.int16]  # (N, 2) in the first frame
    grey: NDArray[np.float32]  # (N,) there


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    model: Model
    covariance: Array  # (U, U) of `unknowns.vector`, from the residuals alone


def _overlap(
    frames: Stored,
    edges: Sequence[NDArray[np.int16]],
    model: Model,
    first: int,
    second: int,
    most: int,
    smoothing: float,
) -> Overlap | None:
    """``most`` pixels of two frames to be compared; the finer of the two is smoothed to the other's resolution.

    ``edges`` are those of the frames as they are. None if the frames share too little.
    """
    views = model.view(first), model.view(second)
    shrink = views[0].focal_px / views[1].focal_px
    if shrink < 0.999:
        first, second, views, shrink = second, first, (views[1], views[0]), 1.0 / shrink
    height, width = frames[first].shape
    border = _border(smoothing)
    fine, chosen = None, edges[first]
    if shrink > 1.001:
        fine = softened_further(frames[first], shrink, (views[0].focal_px, views[0].principal_px[0]), smoothing)
        chosen = _edges(fine, most, border)
    seen, front = geometry.direction_to_pixel(
        views[1], *geometry.pixel_to_direction(views[0], chosen.astype(np.float64))
    )
    inside = front & np.all((seen >= border) & (seen <= np.array([width, height]) - 1 - border), axis=1)
    which = np.flatnonzero(inside)
    which = which[:: max(1, len(which) // most)]
    if len(which) < most // 10:
        return None
    points = chosen[which]
    grey = at_pixels(frames[first], points) if fine is None else fine[points[:, 1], points[:, 0]]
    return Overlap(first, second, points, np.asarray(grey, np.float32))


def _border(smoothing: float) -> int:
    return round(BORDER * smoothing)


def _edges(image: Stored | NDArray[np.float32], most: int, border: int) -> NDArray[np.int16]:
    """(N, 2) the pixels of the strongest edges, the same number in every tile, and some times ``most`` in all."""
    inner = image[border : image.shape[0] - border, border : image.shape[1] - border].astype(np.float32)
    strength = np.hypot(cv2.Sobel(inner, cv2.CV_32F, 1, 0), cv2.Sobel(inner, cv2.CV_32F, 0, 1))
    rows, columns = (side // TILE for side in strength.shape)
    tiles = strength[: rows * TILE, : columns * TILE].reshape(rows, TILE, columns, TILE).swapaxes(1, 2)
    strongest = min(max(round(20 * most / (rows * columns)), 1), TILE**2 - 1)
    best = np.sort(np.argpartition(-tiles.reshape(rows, columns, TILE**2), strongest, axis=2)[:, :, :strongest], axis=2)
    row = np.arange(rows)[:, None, None] * TILE + best // TILE
    column = np.arange(columns)[None, :, None] * TILE + best % TILE
    return (np.stack([column.ravel(), row.ravel()], axis=1) + border).astype(np.int16)


def adjust(
    start: Model,
    frames: Stored,
    pairs: Sequence[tuple[int, int]],
    sigmas: Sigmas,
    *,
    prior: Model,
    pixels: int,
    smoothing: float,
    report: Callable[[int], None],
) -> Fitted:
    """Fit the model to the grey values of ``pairs`` of ``frames`` (F, H, W), of ``pixels`` of each pair at most; as
    `bundle.adjust`. The frames are smoothed by ``smoothing`` square pixels.

    ``start`` must be right to about a pixel.
    """
    # the images know how near things are times how far the centre is beside the axis: walls that were held back to
    # what is believed of them would push the centre out
    loose = replace(sigmas, walls=3.0, unevenness=1.0, departures=0.1, roughness=0.05)
    believed, mean = information(start, loose), vector(prior)
    edges = [_edges(frame, pixels, _border(smoothing)) for frame in frames]
    overlaps = [one for pair in pairs if (one := _overlap(frames, edges, start, *pair, pixels, smoothing)) is not None]
    ends = np.array([[one.first, one.second] for one in overlaps])
    bounds = np.cumsum([0, *(len(one.grey) for one in overlaps)])
    points = np.vstack([one.points_px for one in overlaps])
    grey = np.concatenate([one.grey for one in overlaps])
    gains = np.tile([1.0, 0.0], (len(overlaps), 1))
    residual = np.zeros_like(grey)
    model, scale = start, 30.0
    for iteration in range(ITERATIONS):
        normal, gradient = np.zeros((len(mean), len(mean))), np.zeros(len(mean))
        _accumulate(
            ends, bounds, points, grey, frames, vectors(model), *chains_of(model),
            kernel_hall(model.surroundings), scale, gains, residual, normal, gradient,
        )  # fmt: skip
        seen = np.isfinite(residual)
        spread = 1.4826 * float(np.median(np.abs(residual[seen])))
        normal += believed * (DOUBT * spread**2)
        gradient += (DOUBT * spread**2) * believed @ (vector(model) - mean)
        fixed = model.pan_of[0]
        normal[fixed], normal[:, fixed], normal[fixed, fixed], gradient[fixed] = 0.0, 0.0, 1.0, 0.0
        inverse = np.linalg.inv(normal)
        step = np.asarray(-inverse @ gradient, np.float64)
        model = stepped(model, step)
        report(iteration + 1)
        if iteration > 1 and np.abs(step[: len(model.pan_rad)]).max() < SETTLED_RAD:
            break
        scale = max(3.0 * spread, scale / 3.0)
    inverse[fixed, fixed] = 0.0
    return Fitted(model, np.asarray(inverse * (DOUBT * spread**2), np.float64))


@njit(cache=True, nogil=True)
def _accumulate(
    ends: NDArray[np.int64], bounds: NDArray[np.int64], points: NDArray[np.int16], grey: NDArray[np.float32],
    images: Stored, views: Array, chains: Array, columns: NDArray[np.int64], hall: Hall, scale: float, gains: Array,
    residual: NDArray[np.float32], normal: Array, gradient: Array,
) -> None:  # fmt: skip
    """Normal equations of all pixels, each link's gain and shading eliminated. ``gains`` (L, 2) is brought up to date;
    ``residual`` (N,) is inf where the second frame does not show the pixel."""
    seen, jacobian, by_near = np.empty(2), np.empty((2, SIDES)), np.empty(2)
    nodes, shares = np.zeros(NODES, np.int64), np.zeros(NODES)
    number, used = np.empty((2, hall[1].size + hall[2].size), np.int64)
    touched = np.arange(SIDES + NODES if len(hall[1]) else SIDES)
    for link in range(len(ends)):
        first, second = views[ends[link, 0]], views[ends[link, 1]]
        image = images[ends[link, 1]]
        count = numbered(first, points[bounds[link] : bounds[link + 1]], hall, number, used)
        size = SIDES + count
        summed, along, row = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        shade, shade_by, shade_along = np.zeros((2, 2)), np.zeros((2, size)), np.zeros(2)
        for n in range(bounds[link], bounds[link + 1]):
            u, v = float(points[n, 0]), float(points[n, 1])
            transfer(first, second, u, v, hall, seen, jacobian, by_near, nodes, shares)
            inside, value, by_x, by_y = cubic(image, seen[0], seen[1])
            if not inside:
                residual[n] = np.inf
                continue
            lit = grey[n]
            shaded = lit * (_radial(seen[0], seen[1], images) - _radial(u, v, images))
            difference = value - gains[link, 0] * lit - gains[link, 1] * shaded
            residual[n] = difference
            weight = geman_mcclure((difference / scale) ** 2)
            for k in range(SIDES):
                row[k] = by_x * jacobian[0, k] + by_y * jacobian[1, k]
            for k in range(len(touched) - SIDES):
                touched[SIDES + k] = SIDES + number[nodes[k]]
                row[touched[SIDES + k]] = shares[k] * (by_x * by_near[0] + by_y * by_near[1])
            for k in range(len(touched)):
                i = touched[k]
                weighted = weight * row[i]
                along[i] += weighted * difference
                shade_by[0, i] -= weighted * lit
                shade_by[1, i] -= weighted * shaded
                for j in touched[: k + 1]:  # each pair once: either way round, since nodes come in any order
                    summed[i, j] += weighted * row[j]
            shade[0, 0] += weight * lit * lit
            shade[0, 1] += weight * lit * shaded
            shade[1, 1] += weight * shaded * shaded
            shade_along[0] -= weight * lit * difference
            shade_along[1] -= weight * shaded * difference
        summed += summed.T - np.diag(np.diag(summed))
        shade[1, 0] = shade[0, 1]
        shade[0, 0] += 1e-9
        shade[1, 1] += 1e-9 + 1e-3 * shade[0, 0]  # frames are flattened before: little shading is left
        shade_along[1] += 1e-3 * shade[0, 0] * gains[link, 1]
        solved = np.linalg.inv(shade)
        gains[link] -= solved @ shade_along
        summed -= shade_by.T @ (solved @ shade_by)
        along -= shade_by.T @ (solved @ shade_along)
        carry(summed, along, chains, columns, ends[link], used[:count], normal, gradient)


@njit(cache=True, nogil=True, inline="always")
def _radial(u: float, v: float, images: Stored) -> float:
    """Squared distance from the middle of a frame, 1 in its corners."""
    x, y = (images.shape[2] - 1) / 2, (images.shape[1] - 1) / 2
    return ((u - x) ** 2 + (v - y) ** 2) / (x * x + y * y)
