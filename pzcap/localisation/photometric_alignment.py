"""Place of a frame from its grey values and the panorama's (direct alignment).

Grey values tell a place more exactly than features do, since all edges count. The residual of a pixel is

    r = grey - b(row) (g_0 + g_1 rho^2 + g_2 rho^4) P(direction(pixel; place)),

with P the panorama, the polynomial in the distance rho from the principal point for gain and vignetting, and b the
bands that mains light leaves in rows that are not exposed at once (`row_bands`). Place and gains minimise the
Geman-McClure cost of all residuals by Gauss-Newton steps, so that pixels that do not fit (the athlete, a shadow) lose
their weight. From coarse to fine, so that the frame before is a good enough start for the next.

The place (`ViewPlace`) is pan and focal length, and beside these what a tripod on a sprung floor and a rolling shutter
add: a little tilt and roll, and a shear of pan and focal length from row to row. What is believed of them before
(`FramePrior`) counts as a prior; what is believed to be 0 exactly costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from pzcap.imaging import bspline, row_bands
from pzcap.imaging.colour import grey
from pzcap.imaging.row_bands import NO_BANDS
from pzcap.localisation.alignment_equations import normal_equations, tile_scores
from pzcap.localisation.frame_pixels import FramePixels, level_pixels
from pzcap.localisation.frame_prior import FramePrior
from pzcap.localisation.panorama_sampler import BY_PAN, KNOWN, VALUE, PanoramaSampler, Rays, ViewPlace
from pzcap.localisation.tuning import ALIGNMENT, LEVELS
from pzcap.solver import robust
from pzcap.solver.gauss_newton import NormalEquations, Schedule, Solution, SolveReport, minimise
from pzcap.types import Array, Image, Mask, Panorama, PanZoomCamera

Look = Callable[[Rays, ViewPlace], Array]  # samples (N, SAMPLE) of the panorama along rays (N), extrapolated to a place


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    at: ViewPlace
    covariance: Array  # (free, free) of what `ViewPlace.stepped` steps, if pixels err independently, and the prior
    clustered: Array  # (2, 2) of pan and log focal, from how pixels that are near each other err alike
    agreement: float  # 1 - median residual / median contrast: near 1 in the right place, else about 0
    report: SolveReport  # a fit that did not converge may agree as well, where a fast pan smears all edges
    frame_points_px: Array  # (N, 2) some pixels that fit, on edges
    panorama_points_px: Array  # (N, 2) where these lie on the panorama
    bands: Array = field(default_factory=lambda: NO_BANDS)  # as in `row_bands`


class Limits(NamedTuple):
    """Stop rule of a fit."""

    steps: int
    settled_px: float
    least_noise: float = ALIGNMENT.least_noise


class State(NamedTuple):
    at: ViewPlace
    gains: Array | None  # (K,) of the shading; None: not known yet
    bands: Array = NO_BANDS  # as in `row_bands`


class NothingToCompare(Exception):
    """The panorama is unknown, or the frame dark."""


class _Cost:
    """Photometric cost of some pixels; ``sampled`` (N, SAMPLE), ``residual`` and ``weight`` (N,) of its last
    linearisation."""

    def __init__(
        self, aligner: Aligner, look: Look, pixels: FramePixels, start: ViewPlace, prior: FramePrior, limits: Limits
    ) -> None:
        self._aligner, self._look, self._limits, self.pixels, self.prior = aligner, look, limits, pixels, prior
        self._rays = aligner.sampler.rays(pixels.points, start)

    def linearise(self, state: State, _: float) -> NormalEquations:
        """Normal equations at ``state``; the scale of the weights follows from the residuals there."""
        pixels, free = self.pixels, self.prior.free
        if self._rays.far_from(state.at):
            self._rays = self._aligner.sampler.rays(pixels.points, state.at)
        self.sampled = self._look(self._rays, state.at)
        usable = self.sampled[:, KNOWN] > 0
        if usable.sum() < ALIGNMENT.least_pixels:
            raise NothingToCompare
        gains, self._bands = state.gains, state.bands
        if gains is None:
            ratio = pixels.grey[usable] / np.maximum(self.sampled[usable, VALUE], 1.0)
            self._bands = row_bands.fit(ratio, self._rays.row_time[usable], pixels.shading[usable, 1])
            ratio /= row_bands.gain(self._bands, self._rays.row_time[usable])
            gains = _first_gains(ratio, pixels.shading[usable, 1], pixels.shading.shape[1])
        self._gains = gains
        shading = pixels.shading * row_bands.gain(self._bands, self._rays.row_time)[:, None]
        brightness = shading @ gains
        self._shading, self._brightness = shading, brightness
        self.residual = pixels.grey - brightness * self.sampled[:, VALUE]
        noise = max(1.4826 * robust.median_absolute(self.residual[usable]), self._limits.least_noise)
        self._noise, self._scale = noise, ALIGNMENT.scale_sigmas * noise
        self.weight, normal, gradient, self._curvature = normal_equations(
            self.sampled, shading, brightness, self.residual, self._scale, free
        )
        normal += 1e-9 * np.diag(np.diag(normal))  # can be solved, whatever is left open
        information = ALIGNMENT.doubt * noise**2 * self.prior.information()
        normal[range(free), range(free)] += information
        gradient[:free] += information * self.prior.departure(state.at)
        return NormalEquations(normal, gradient, noise, float(self.weight @ self.residual**2))

    def retract(self, state: State, step: Array) -> State:
        """``state`` after a step, which is lengthened near the end by what Gauss-Newton steps are too short by."""
        free = self.prior.free
        moved_px = max(abs(step[0]) * state.at.focal_px, abs(step[1]) * self._aligner.camera.lens.width / 2)
        if moved_px < ALIGNMENT.near_px:
            step = step / max(self._curvature, ALIGNMENT.least_curvature)
        brightened = np.abs((self.pixels.shading @ step[free:]) * self.sampled[:, VALUE]).max() / self._scale
        self._settled = bool(moved_px < self._limits.settled_px and brightened < ALIGNMENT.settled_share)
        return State(state.at.stepped(step[:free], 0.1), self._gains + step[free:], self._bands)

    def clustered(self, normal: Array) -> Array:
        """Covariance (2, 2) of pan and log focal that the residuals themselves show, at the minimum, with ``normal``
        (P + K, P + K) its matrix N (cluster-robust, after Liang and Zeger, 1986):

            (N c)^-1 (sum_s g_s g_s^T + B) (N c)^-1,        g_s = sum_n w_n J_n^T r_n over the pixels n of a tile s.

        Pixels of a tile err alike, since they are of one edge, of one frame of the sweep, in one light; c is the
        cost's curvature, and B what the prior adds. One tile is lost for each unknown.
        """
        free, lens = self.prior.free, self._aligner.camera.lens
        across, down = ALIGNMENT.tiles
        column, row = (self.pixels.points * np.array([across / lens.width, down / lens.height])).astype(np.int64).T
        tile = row * across + column
        scores = tile_scores(
            tile, across * down, self.sampled, self._shading, self._brightness, self.weight * self.residual, free
        )
        tiles = int(np.any(scores != 0.0, axis=1).sum())
        middle = scores.T @ scores * (tiles / max(tiles - scores.shape[1], 1))
        middle[range(free), range(free)] += (ALIGNMENT.doubt * self._noise**2) ** 2 * self.prior.information()
        by_scores = np.linalg.inv(normal)[:2] / max(self._curvature, ALIGNMENT.least_curvature)
        return np.asarray(by_scores @ middle @ by_scores.T, np.float64)

    def settled(self, _: Array) -> bool:
        """True if the last step was short enough."""
        return self._settled


class Fit(NamedTuple):
    cost: _Cost
    solution: Solution[State]


class Aligner:
    """Aligns frames of one camera with its panorama by about ``pixels`` of each frame."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, *, pixels: int = 4000) -> None:
        self.camera = camera
        self.sampler = PanoramaSampler(panorama, camera, pixels)

    def align(
        self, image: Image, start: ViewPlace, off_px: float, hidden: Mask | None = None, prior: FramePrior | None = None
    ) -> Alignment:
        """Refine the place of a frame from a ``start`` off by up to ``off_px`` pixels of the panorama, 15 at most; the
        less, the faster. Without a ``prior`` all but pan and focal length are held where the start has them. Pixels
        that are ``hidden`` (H, W) are not compared. The agreement is 0 where the panorama is unknown, or the frame
        dark."""
        frame, state, prior = grey(image), State(start, None), prior or FramePrior(start)
        try:
            for index in range(max(sum(level.reach_px >= off_px for level in LEVELS), 1) - 1, len(LEVELS)):
                fit = self._fit_level(index, frame, hidden, state.at, prior)
                state = fit.solution.state
            return self._alignment(self.refined(fit, frame, hidden))
        except NothingToCompare:
            nothing = np.empty((0, 2))
            return Alignment(state.at, np.eye(2), np.eye(2), 0.0, SolveReport(False, 0, 0.0), nothing, nothing)

    def _fit_level(self, index: int, frame: Image, hidden: Mask | None, at: ViewPlace, prior: FramePrior) -> Fit:
        """Fit to one of `LEVELS`."""
        level, steps = self.sampler.levels[index], LEVELS[index].steps
        if not at.focal_px * level.scale > bspline.LEAST_SHRINK * self.sampler.px_per_rad:  # diverged, on wrong footage
            raise NothingToCompare
        pixels = level_pixels(frame, hidden, self.camera.lens, at.focal_px, self.sampler.px_per_rad, level)
        look, start = partial(self.sampler.sample, level), State(at, None)
        if level.scale > 1:  # too coarse to tell rows apart
            return self.fit(
                look, pixels, start, FramePrior(prior.mean, prior.tilt_rad, prior.roll_rad), Limits(steps, 0.0)
            )
        near = self.fit(look, pixels.thinned(ALIGNMENT.sparse), start, prior, Limits(steps, ALIGNMENT.near_px))
        start = near.solution.state
        if start.bands.size:  # all pixels tell them better
            start = State(start.at, None)
        return self.fit(look, pixels, start, prior, Limits(steps, ALIGNMENT.settled_px))

    def refined(self, fit: Fit, frame: Image, hidden: Mask | None) -> Fit:  # noqa: ARG002
        """Result of the last level as it is; `pzcap.extras.superresolved_alignment` goes on from there."""
        return fit

    def fit(self, look: Look, pixels: FramePixels, start: State, prior: FramePrior, limits: Limits) -> Fit:
        cost = _Cost(self, look, pixels, start.at, prior, limits)
        return Fit(cost, minimise(start, cost.linearise, cost.retract, cost.settled, Schedule(limits.steps, 1.0)))

    def _alignment(self, fit: Fit) -> Alignment:
        cost, solution = fit
        variance = solution.report.cost / float(cost.weight.sum())
        free = cost.prior.free
        covariance = np.asarray(variance * np.linalg.inv(solution.normal)[:free, :free], np.float64)
        usable = cost.sampled[:, KNOWN] > 0
        value = cost.sampled[usable, VALUE]
        contrast = robust.median(np.abs(value - robust.median(value)))
        agreement = 1.0 - robust.median_absolute(cost.residual[usable]) / max(contrast, 1.0)
        strength = np.abs(cost.sampled[:, BY_PAN]) * cost.weight
        strongest = min(400, len(strength))
        shown = np.flatnonzero(strength >= np.partition(strength, -strongest)[-strongest])[::5]
        places = self.sampler.panorama_px(cost.sampled[shown])
        points = cost.pixels.points[shown]
        return Alignment(
            solution.state.at, covariance, cost.clustered(solution.normal), agreement, solution.report, points, places,
            solution.state.bands,
        )  # fmt: skip


def _first_gains(ratio: Array, squared: Array, count: int) -> Array:
    """Gains (K,) from the ratios (N,) of frame to panorama at ``squared`` distances (N,), before anything is fitted;
    with others everything would be an outlier. Most pixels show the hall."""
    usual = robust.half_sample_mode(ratio)
    if usual <= 0.0:
        raise NothingToCompare
    line = robust.line(ratio / usual, squared, np.ones_like(ratio), ALIGNMENT.gain_scales, (1.0, 0.0))
    return np.pad(usual * np.array(line), (0, count - 2))
