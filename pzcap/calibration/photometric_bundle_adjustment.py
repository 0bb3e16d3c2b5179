"""Photometric bundle adjustment: the parameters of `pzcap.calibration.bundle_adjustment` fitted to grey values.

Features are found to a quarter of a pixel; the grey values of some hundred pixels on edges register two frames better.
The residual of a pixel is the second frame's grey value where it should see the pixel, minus the first frame's, made as
bright by a gain and a shading of the pair's own: the transfer from frame to frame, weighted by the gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pzcap.calibration.beliefs import Sigmas, information, standing_apart
from pzcap.calibration.bundle_adjustment import Link, Matches, enough, matches_of, normal_equations
from pzcap.calibration.compared_pixels import ComparedPixels, compared_pixels, edge_pixels, overlap_of
from pzcap.calibration.grey_value_equations import accumulate
from pzcap.calibration.parameters import CalibrationParameters, retract, to_vector, view_jacobians
from pzcap.calibration.sweep import SweepConfig
from pzcap.calibration.tuning import PHOTOMETRIC
from pzcap.geometry.cylinder import kernel_hall
from pzcap.imaging.bspline import Stored
from pzcap.imaging.row_bands import Overlaps, fit_frames, row_time
from pzcap.solver.gauss_newton import NormalEquations, Prior, Schedule, Solution, SolveReport, minimise
from pzcap.solver.robust import normal_sigma
from pzcap.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Result of `adjust`."""

    parameters: CalibrationParameters
    covariance: Array  # (U, U) of their vector, from the residuals alone
    sigma: float  # robust standard deviation of the residuals, grey levels
    overlap_misfit: float  # of overlaps with the parameters: sum of `ComparedPixels.overlap_cost`, grey levels^2
    prior_misfit: float  # squared distance of the parameters from what was believed before, in standard deviations
    bands: Array  # (F, K) of mains light in the frames, as in `pzcap.imaging.row_bands`
    report: SolveReport

    def less_sure(self, place: int, sigma: float) -> Fitted:
        """The adjustment, whose parameter at a ``place`` may be off by ``sigma`` beside what is claimed; the others
        follow it as they are correlated."""
        along = self.covariance[:, place] / self.covariance[place, place]
        return replace(self, covariance=self.covariance + sigma**2 * np.outer(along, along))


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
    edges = [edge_pixels(frame, pixels, smoothing) for frame in frames]
    pairs = dict.fromkeys((link.first, link.second) for link in links)
    overlaps = [one for pair in pairs if (one := overlap_of(frames, edges, start, pair, pixels, smoothing)) is not None]
    fit = _GreyValues(frames, matches_of(enough(links)), to_vector(prior), int(start.pan_of[0]), report)

    few = _Part(compared_pixels(overlaps, PHOTOMETRIC.some), PHOTOMETRIC.some, PHOTOMETRIC.settled_on_some_rad)
    believed, near, told_apart = _with_standing_apart(fit, start, loose, few)
    compared = compared_pixels(overlaps)
    compared.gains[:] = few.pixels.gains
    schedule = Schedule(PHOTOMETRIC.steps, near.scale, least_steps=2)
    state, normal, sigma, _, ended = fit.solved(
        near.state, believed, _Part(compared, 1, PHOTOMETRIC.settled_rad), schedule
    )
    # of pixels that err independently, the squared distances have the mean 4 sigma^2
    doubt = PHOTOMETRIC.doubt_apart if told_apart else PHOTOMETRIC.doubt
    covariance = np.linalg.inv(normal) * (doubt * float(compared.overlap_cost.mean()) / 4.0)
    covariance[fit.held, fit.held] = 0.0
    off, bands = to_vector(state) - fit.mean, _bands(few.pixels, frames)
    return Fitted(
        state, np.asarray(covariance, np.float64), sigma, float(compared.overlap_cost.sum()),
        float(off @ believed @ off),
        bands, ended,
    )  # fmt: skip


def _with_standing_apart(
    fit: _GreyValues, start: CalibrationParameters, loose: Sigmas, few: _Part
) -> tuple[Array, Solution[CalibrationParameters], bool]:
    """Information on the parameters (U, U) once a ``few`` pixels have told what stands apart from floor and walls, the
    parameters fitted to these, and True if that could be told.

    All distances are opened for a while. Where light is modelled a little wrong, that drives the projection centre
    away: then nothing is taken to stand apart.
    """
    believed = information(start, loose)
    near = fit.solved(start, believed, few, Schedule(PHOTOMETRIC.steps_on_some, 30.0, least_steps=3))
    if not start.surroundings.departures.size:
        return believed, near, False
    everywhere = information(near.state, loose, np.ones_like(start.surroundings.departures, np.bool_))
    opened = fit.solved(near.state, everywhere, few, Schedule(PHOTOMETRIC.open_steps, near.scale, least_steps=2))
    offset = near.state.offset
    if np.linalg.norm(opened.state.offset - offset) > PHOTOMETRIC.driven * np.linalg.norm(offset):
        return believed, near, False
    near = opened
    for _ in range(PHOTOMETRIC.rounds):
        believed = information(near.state, loose, standing_apart(near.state))
        near = fit.solved(near.state, believed, few, Schedule(PHOTOMETRIC.steps_of_round, near.scale, least_steps=2))
    return believed, near, True


class _Part(NamedTuple):
    """A part of the pixels, to be fitted to."""

    pixels: ComparedPixels
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
            cost = accumulate(part.pixels, self.frames, view_jacobians(state), hall, scale, normal, gradient)
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


def _bands(pixels: ComparedPixels, frames: Stored) -> Array:
    """Bands of mains light (F, K) of the frames, from the residuals (`pzcap.imaging.row_bands.fit_frames`)."""
    height, sizes = frames.shape[1], np.diff(pixels.bounds)
    lit = np.repeat(pixels.gains[:, 0], sizes) * pixels.grey
    time = row_time(np.column_stack([pixels.points[:, 1], pixels.row]), height)
    overlaps = Overlaps(pixels.ends, pixels.bounds, lit.astype(np.float32), pixels.residual, time.astype(np.float32))
    return fit_frames(overlaps, len(frames))
