"""Photometric bundle adjustment: the parameters of `pzcap.calibration.bundle_adjustment` fitted to grey values.

Features are found to a quarter of a pixel; the grey values of some hundred pixels on edges register two frames better.
The residual of a pixel is the second frame's grey value where it should see the pixel, minus the first frame's, made as
bright by a gain and a shading of the pair's own: the transfer from frame to frame, weighted by the gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.bundle_adjustment import (
    SIDES,
    Link,
    Matches,
    add_link,
    add_nodes,
    enough,
    matches_of,
    new_link_sums,
    new_transfer,
    normal_equations,
    transfer,
)
from pzcap.calibration.parameters import (
    CalibrationParameters,
    Sigmas,
    ViewJacobians,
    information,
    retract,
    standing_apart,
    to_vector,
    view_jacobians,
)
from pzcap.calibration.sweep import SweepConfig
from pzcap.calibration.tuning import PHOTOMETRIC
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import VIEW
from pzcap.geometry.cylinder import NODES, Hall, kernel_hall
from pzcap.imaging.bspline import Stored, at_pixels, cubic, softened_further
from pzcap.imaging.row_bands import Overlaps, fit_frames, row_time
from pzcap.solver.gauss_newton import NormalEquations, Prior, Schedule, Solution, SolveReport, minimise
from pzcap.solver.robust import geman_mcclure, normal_sigma
from pzcap.types import Array, Float32


class _Overlap(NamedTuple):
    """Pixels of one frame that another sees."""

    ends: tuple[int, int]  # the first and the second frame
    points_px: NDArray[np.int16]  # (N, 2) in the first frame
    grey: Float32  # (N,) there


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Result of `adjust`."""

    parameters: CalibrationParameters
    covariance: Array  # (U, U) of their vector, from the residuals alone
    sigma: float  # robust standard deviation of the residuals, grey levels
    disagreement: float  # of overlaps with the parameters: sum of squared distances (`_beside`), grey levels^2
    surprise: float  # squared distance of the parameters from what was believed before, in standard deviations
    bands: Array  # (F, K) of mains light in the frames, as in `pzcap.imaging.row_bands`
    report: SolveReport

    def less_sure(self, place: int, sigma: float) -> Fitted:
        """The adjustment, whose parameter at a ``place`` may be off by ``sigma`` beside what is claimed; the others
        follow it as they are correlated."""
        along = self.covariance[:, place] / self.covariance[place, place]
        return replace(self, covariance=self.covariance + sigma**2 * np.outer(along, along))


def _overlap(
    frames: Stored, edges: Sequence[NDArray[np.int16]], state: CalibrationParameters, pair: tuple[int, int], most: int,
    smoothing: float,
) -> _Overlap | None:  # fmt: skip
    """Choose ``most`` pixels of a pair of frames to compare, the finer frame smoothed to the other's resolution; None
    if they overlap too little. ``edges`` are those of the unsmoothed frames."""
    first, second = pair
    views = state.view(first), state.view(second)
    shrink = views[0].focal_px / views[1].focal_px
    if shrink < 0.999:
        first, second, views, shrink = second, first, (views[1], views[0]), 1.0 / shrink
    border, edge = _border_px(smoothing), np.array(frames.shape[:0:-1]) - 1
    fine, chosen = None, edges[first]
    if shrink > 1.001:
        fine = softened_further(frames[first], shrink, (views[0].focal_px, views[0].principal_px[0]), smoothing)
        chosen = _edges(fine, most, border)
    directions = geometry.pixel_to_direction(views[0], chosen.astype(np.float64))
    seen, front = geometry.direction_to_pixel(views[1], *directions)
    inside = front & np.all((seen >= border) & (seen <= edge - border), axis=1)
    which = np.flatnonzero(inside)
    which = which[:: max(1, len(which) // most)]
    if len(which) < most // 10:
        return None
    points = chosen[which]
    grey = at_pixels(frames[first], points) if fine is None else fine[points[:, 1], points[:, 0]]
    return _Overlap((first, second), points, np.asarray(grey, np.float32))


def _border_px(smoothing: float) -> int:
    return round(PHOTOMETRIC.border * smoothing)


def _edges(image: Stored | Float32, most: int, border: int) -> NDArray[np.int16]:
    """Pixels (N, 2) of the strongest edges, the same number in every tile, and some times ``most`` in all."""
    inner = image[border : image.shape[0] - border, border : image.shape[1] - border].astype(np.float32)
    strength = np.hypot(cv2.Sobel(inner, cv2.CV_32F, 1, 0), cv2.Sobel(inner, cv2.CV_32F, 0, 1))
    tile = PHOTOMETRIC.tile_px
    rows, columns = (side // tile for side in strength.shape)
    tiles = strength[: rows * tile, : columns * tile].reshape(rows, tile, columns, tile).swapaxes(1, 2)
    strongest = min(max(round(PHOTOMETRIC.choice * most / (rows * columns)), 1), tile**2 - 1)
    best = np.sort(np.argpartition(-tiles.reshape(rows, columns, tile**2), strongest, axis=2)[:, :, :strongest], axis=2)
    row = np.arange(rows)[:, None, None] * tile + best // tile
    column = np.arange(columns)[None, :, None] * tile + best % tile
    return (np.stack([column.ravel(), row.ravel()], axis=1) + border).astype(np.int16)


def adjust(
    start: CalibrationParameters, frames: Stored, links: Sequence[Link], sigmas: Sigmas, *,
    prior: CalibrationParameters, config: SweepConfig, report: Callable[[int], None],
) -> Fitted:  # fmt: skip
    """Fit the parameters, from a ``start`` right to about a pixel, to the grey values of ``frames`` (F, H, W) that
    ``links`` are between, and to some of their matches, in at most ``config.pixels`` of each pair, first in some.

    Matches are worse than grey values, but not misled by what these are: light that is modelled a little wrong drives
    focal length, projection centre and walls, which make up for each other, slowly away together. The floor, whose
    distances are known, holds them; a box on it, taken for the floor behind, would push them (`_with_standing_apart`).
    """
    # the images know inverse distance times offset: walls held to their prior would push the projection centre away
    loose = replace(sigmas, walls=3.0, unevenness=1.0, departures=0.1, roughness=0.05)
    pixels, smoothing = config.pixels, config.smoothing
    edges = [_edges(frame, pixels, _border_px(smoothing)) for frame in frames]
    pairs = dict.fromkeys((link.first, link.second) for link in links)
    overlaps = [one for pair in pairs if (one := _overlap(frames, edges, start, pair, pixels, smoothing)) is not None]
    fit = _GreyValues(frames, matches_of(enough(links)), to_vector(prior), int(start.pan_of[0]), report)

    few = _Part(_compared(overlaps, PHOTOMETRIC.some), PHOTOMETRIC.some, PHOTOMETRIC.settled_on_some_rad)
    believed, near = _with_standing_apart(fit, start, loose, few)
    compared = _compared(overlaps)
    compared.gains[:] = few.pixels.gains
    schedule = Schedule(PHOTOMETRIC.steps, near.scale, least_steps=2)
    state, normal, sigma, _, ended = fit.solved(
        near.state, believed, _Part(compared, 1, PHOTOMETRIC.settled_rad), schedule
    )
    # of pixels that err independently, the squared distances have the mean 4 sigma^2
    covariance = np.linalg.inv(normal) * (PHOTOMETRIC.doubt * float(compared.beside.mean()) / 4.0)
    covariance[fit.held, fit.held] = 0.0
    off, bands = to_vector(state) - fit.mean, _bands(few.pixels, frames)
    return Fitted(
        state, np.asarray(covariance, np.float64), sigma, float(compared.beside.sum()), float(off @ believed @ off),
        bands, ended,
    )  # fmt: skip


def _with_standing_apart(
    fit: _GreyValues, start: CalibrationParameters, loose: Sigmas, few: _Part
) -> tuple[Array, Solution[CalibrationParameters]]:
    """The parameters fitted to a ``few`` pixels, and what is believed of them (U, U) now that these have told what
    stands apart from floor and walls.

    All distances are opened for a while. Where light is modelled a little wrong, that drives the projection centre
    away: then nothing is taken to stand apart.
    """
    believed = information(start, loose)
    near = fit.solved(start, believed, few, Schedule(PHOTOMETRIC.steps_on_some, 30.0, least_steps=3))
    if not start.surroundings.departures.size:
        return believed, near
    everywhere = information(near.state, loose, np.ones_like(start.surroundings.departures, np.bool_))
    opened = fit.solved(near.state, everywhere, few, Schedule(PHOTOMETRIC.open_steps, near.scale, least_steps=2))
    offset = near.state.offset
    if np.linalg.norm(opened.state.offset - offset) > PHOTOMETRIC.driven * np.linalg.norm(offset):
        return believed, near
    near = opened
    for _ in range(PHOTOMETRIC.rounds):
        believed = information(near.state, loose, standing_apart(near.state))
        near = fit.solved(near.state, believed, few, Schedule(PHOTOMETRIC.steps_of_round, near.scale, least_steps=2))
    return believed, near


class _Part(NamedTuple):
    """A part of the pixels, to be fitted to."""

    pixels: _Pixels
    every: int  # one of so many
    settled_rad: float  # largest change of a pan that ends the fit


@dataclass(slots=True)
class _GreyValues:
    """Material that the fits to more and more pixels have in common."""

    frames: Stored
    matches: Matches
    mean: Array  # (U,) believed of the parameters
    held: int  # the parameter that keeps its value
    report: Callable[[int], None]
    done: int = 0  # steps

    def solved(
        self, start: CalibrationParameters, believed: Array, part: _Part, schedule: Schedule
    ) -> Solution[CalibrationParameters]:
        """The parameters fitted to a part of the pixels, from a ``start``, with ``believed`` (U, U) their inverse
        covariance before."""
        length = np.empty(len(self.matches.pixels))

        def linearise(state: CalibrationParameters, scale: float) -> NormalEquations:
            normal, gradient = np.zeros_like(believed), np.zeros_like(self.mean)
            hall = kernel_hall(state.surroundings)
            cost = _accumulate(part.pixels, self.frames, view_jacobians(state), hall, scale, normal, gradient)
            self.done += 1
            self.report(self.done)
            sigma = normal_sigma(part.pixels.residual[np.isfinite(part.pixels.residual)])
            matched = normal_equations(state, self.matches, PHOTOMETRIC.match_scale_px, length)
            # some stand for themselves alone, since a feature's matches err alike; and for fewer where pixels are fewer
            share = (sigma / matched.sigma) ** 2 / part.every
            return NormalEquations(normal + share * matched.normal, gradient + share * matched.gradient, sigma, cost)

        return minimise(
            start, linearise, retract,
            lambda step: np.abs(step[: len(start.pan_rad)]).max() < part.settled_rad, schedule,
            prior=Prior(believed, lambda state: to_vector(state) - self.mean, PHOTOMETRIC.alike / part.every),
            held=self.held,
        )  # fmt: skip


WIDTH: Final = SIDES + 3
"""Of a pixel's row: derivatives by both views, residual, derivatives by gain and shading."""


def _compared(overlaps: Sequence[_Overlap], every: int = 1) -> _Pixels:
    """One of so many pixels of all overlaps, with first values of what is found of each."""
    ends, points, greys = zip(*((one.ends, one.points_px[::every], one.grey[::every]) for one in overlaps), strict=True)
    bounds, grey = np.cumsum([0, *map(len, greys)]), np.concatenate(greys)
    gains, beside = np.tile([1.0, 0.0], (len(overlaps), 1)), np.zeros(len(overlaps))
    residual, row = np.zeros_like(grey), np.zeros_like(grey)
    return _Pixels(np.array(ends), bounds, np.vstack(points), grey, gains, residual, row, beside)


def _bands(pixels: _Pixels, frames: Stored) -> Array:
    """Bands of mains light (F, K) of the frames, from the residuals (`pzcap.imaging.row_bands.fit_frames`)."""
    height, sizes = frames.shape[1], np.diff(pixels.bounds)
    lit = np.repeat(pixels.gains[:, 0], sizes) * pixels.grey
    time = row_time(np.column_stack([pixels.points[:, 1], pixels.row]), height)
    overlaps = Overlaps(pixels.ends, pixels.bounds, lit.astype(np.float32), pixels.residual, time.astype(np.float32))
    return fit_frames(overlaps, len(frames))


class _Pixels(NamedTuple):
    """The pixels of all overlaps, for kernels."""

    ends: NDArray[np.int64]  # (L, 2) frames of each overlap
    bounds: NDArray[np.int64]  # (L + 1,) where each overlap's pixels begin
    points: NDArray[np.int16]  # (N, 2) in the first frame
    grey: Float32  # (N,) there
    gains: Array  # (L, 2) of each overlap: gain and shading, brought up to date
    residual: Float32  # (N,) written; inf where the second frame does not show the pixel
    row: Float32  # (N,) written; in the second frame
    beside: Array  # (L,) written; squared distance of the second frame's place by this overlap alone, see `_beside`


@njit(cache=True, nogil=True)
def _accumulate(
    pixels: _Pixels, images: Stored, jacobians: ViewJacobians, hall: Hall, scale: float, normal: Array, gradient: Array
) -> float:
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
        pixels.beside[link] = _beside(sums.views, sums.by_views)
        add_link(sums, count, jacobians, pixels.ends[link], normal, gradient)
    return cost


@njit(cache=True, nogil=True)
def _beside(summed: Array, along: Array) -> float:
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
