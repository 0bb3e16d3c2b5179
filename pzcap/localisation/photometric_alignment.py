"""Pan, tilt and focal length of a frame from its grey values and the panorama's (direct alignment).

Grey values tell a place more exactly than features do, since all edges count. The residual of a pixel is

    r = grey - (g_0 + g_1 rho^2 + g_2 rho^4) P(direction(pixel; pan, tilt, log focal)),

with P the panorama and the polynomial in the distance rho from the principal point for gain and vignetting. Place and
gains minimise the Geman-McClure cost of all residuals by Gauss-Newton steps, so that pixels that do not fit (the
athlete, a shadow) lose their weight. From coarse to fine, so that the frame before is a good enough start for the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numba import njit

from pzcap.imaging.colour import grey
from pzcap.localisation.frame_pixels import FramePixels, level_pixels
from pzcap.localisation.panorama_sampler import BY_PAN, KNOWN, VALUE, PanoramaSampler, PanTiltZoom, Rays
from pzcap.localisation.tuning import ALIGNMENT, LEVELS
from pzcap.solver import robust
from pzcap.solver.gauss_newton import NormalEquations, Schedule, Solution, SolveReport, minimise
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array, Image, Mask, Panorama, PanZoomCamera

Look = Callable[[Rays, PanTiltZoom], Array]
"""Samples (N, 7) of the panorama along rays (N), extrapolated to a pan, tilt and focal length."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    pan_rad: float
    tilt_rad: float
    focal_px: float
    covariance: Array  # (2, 2) of (pan, log focal), from the residuals alone
    agreement: float  # 1 - median residual / median contrast: near 1 in the right place, else about 0
    report: SolveReport  # a fit that did not converge may agree as well, where a fast pan smears all edges
    frame_points_px: Array  # (N, 2) some pixels that fit, on edges
    panorama_points_px: Array  # (N, 2) where these lie on the panorama


class Limits(NamedTuple):
    """Stop rule of a fit."""

    steps: int
    settled_px: float
    least_noise: float = ALIGNMENT.least_noise


class State(NamedTuple):
    at: PanTiltZoom
    gains: Array | None  # (K,) of the shading; None: not known yet


class NothingToCompare(Exception):
    """The panorama is unknown, or the frame dark."""


class _Cost:
    """Photometric cost of some pixels; ``sampled`` (N, 7), ``residual`` and ``weight`` (N,) of its last
    linearisation."""

    def __init__(self, aligner: Aligner, look: Look, pixels: FramePixels, start: PanTiltZoom, limits: Limits) -> None:
        self._aligner, self._look, self._limits, self.pixels = aligner, look, limits, pixels
        self._rays = aligner.sampler.rays(pixels.points, start)

    def linearise(self, state: State, _: float) -> NormalEquations:
        """Normal equations at ``state``; the scale of the weights follows from the residuals there."""
        pixels, free = self.pixels, self._aligner.free
        if self._rays.far_from(state.at):
            self._rays = self._aligner.sampler.rays(pixels.points, state.at)
        self.sampled = self._look(self._rays, state.at)
        usable = self.sampled[:, KNOWN] > 0
        if usable.sum() < ALIGNMENT.least_pixels:
            raise NothingToCompare
        gains = state.gains
        if gains is None:
            ratio = pixels.grey[usable] / np.maximum(self.sampled[usable, VALUE], 1.0)
            gains = _first_gains(ratio, pixels.shading[usable, 1], pixels.shading.shape[1])
        self._gains = gains
        brightness = pixels.shading @ gains
        self.residual = pixels.grey - brightness * self.sampled[:, VALUE]
        noise = max(1.4826 * robust.median_absolute(self.residual[usable]), self._limits.least_noise)
        self._scale = ALIGNMENT.scale_sigmas * noise
        self.weight, normal, gradient, self._curvature = normal_equations(
            self.sampled, pixels.shading, brightness, self.residual, self._scale, free
        )
        regularised = normal + 1e-9 * np.diag(np.diag(normal))  # can be solved, whatever is left open
        return NormalEquations(regularised, gradient, noise, float(self.weight @ self.residual**2))

    def retract(self, state: State, step: Array) -> State:
        """``state`` after a step, which is lengthened near the end by what Gauss-Newton steps are too short by."""
        free = self._aligner.free
        moved_px = max(abs(step[0]) * state.at.focal_px, abs(step[1]) * self._aligner.camera.lens.width / 2)
        if moved_px < ALIGNMENT.near_px:
            step = step / max(self._curvature, ALIGNMENT.least_curvature)
        brightened = np.abs((self.pixels.shading @ step[free:]) * self.sampled[:, VALUE]).max() / self._scale
        self._settled = bool(moved_px < self._limits.settled_px and brightened < ALIGNMENT.settled_share)
        return State(state.at.stepped(step[:free], 0.1), self._gains + step[free:])

    def settled(self, _: Array) -> bool:
        """True if the last step was short enough."""
        return self._settled


class Fit(NamedTuple):
    cost: _Cost
    solution: Solution[State]


class Aligner:
    """Aligns frames of one camera with its panorama by about ``pixels`` of each frame; in tilt as well with
    ``free_tilt``, else the camera's is kept."""

    def __init__(
        self, panorama: Panorama, camera: PanZoomCamera, *, pixels: int = 4000, free_tilt: bool = False
    ) -> None:
        self.free = 3 if free_tilt else 2
        self.camera = camera
        self.sampler = PanoramaSampler(panorama, camera, pixels)

    def align(
        self, image: Image, pan_rad: float, tilt_rad: float, focal_px: float, off_px: float, hidden: Mask | None = None
    ) -> Alignment:
        """Refine a pan and a focal length, and a tilt if that is free, from a start off by up to ``off_px`` pixels of
        the panorama, 15 at most; the less, the faster. Pixels that are ``hidden`` (H, W) are not compared. The
        agreement is 0 where the panorama is unknown, or the frame dark."""
        frame, state = grey(image), State(PanTiltZoom(pan_rad, tilt_rad, focal_px), None)
        try:
            for index in range(max(sum(level.reach_px >= off_px for level in LEVELS), 1) - 1, len(LEVELS)):
                fit = self._fit_level(index, frame, hidden, state.at)
                state = fit.solution.state
            return self._alignment(self.refined(fit, frame, hidden))
        except NothingToCompare:
            nothing = np.empty((0, 2))
            return Alignment(*state.at, np.eye(2), 0.0, SolveReport(False, 0, 0.0), nothing, nothing)

    def _fit_level(self, index: int, frame: Image, hidden: Mask | None, at: PanTiltZoom) -> Fit:
        """Fit to one of `LEVELS`."""
        level, steps = self.sampler.levels[index], LEVELS[index].steps
        pixels = level_pixels(frame, hidden, self.camera.lens, at.focal_px, self.sampler.px_per_rad, level)
        look, start = partial(self.sampler.sample, level), State(at, None)
        if level.scale > 1:
            return self.fit(look, pixels, start, Limits(steps, 0.0))
        near = self.fit(look, pixels.thinned(ALIGNMENT.sparse), start, Limits(steps, ALIGNMENT.near_px))
        return self.fit(look, pixels, near.solution.state, Limits(steps, ALIGNMENT.settled_px))

    def refined(self, fit: Fit, frame: Image, hidden: Mask | None) -> Fit:  # noqa: ARG002
        """Result of the last level as it is; `pzcap.extras.superresolved_alignment` goes on from there."""
        return fit

    def fit(self, look: Look, pixels: FramePixels, start: State, limits: Limits) -> Fit:
        cost = _Cost(self, look, pixels, start.at, limits)
        return Fit(cost, minimise(start, cost.linearise, cost.retract, cost.settled, Schedule(limits.steps, 1.0)))

    def _alignment(self, fit: Fit) -> Alignment:
        cost, solution = fit
        variance = solution.report.cost / float(cost.weight.sum())
        covariance = np.asarray(variance * np.linalg.inv(solution.normal)[:2, :2], np.float64)
        usable = cost.sampled[:, KNOWN] > 0
        value = cost.sampled[usable, VALUE]
        contrast = robust.median(np.abs(value - robust.median(value)))
        agreement = 1.0 - robust.median_absolute(cost.residual[usable]) / max(contrast, 1.0)
        strength = np.abs(cost.sampled[:, BY_PAN]) * cost.weight
        strongest = min(400, len(strength))
        shown = np.flatnonzero(strength >= np.partition(strength, -strongest)[-strongest])[::5]
        places = self.sampler.panorama_px(cost.sampled[shown])
        points = cost.pixels.points[shown]
        return Alignment(*solution.state.at, covariance, agreement, solution.report, points, places)


def _first_gains(ratio: Array, squared: Array, count: int) -> Array:
    """Gains (K,) from the ratios (N,) of frame to panorama at ``squared`` distances (N,), before anything is fitted;
    with others everything would be an outlier. Most pixels show the hall."""
    usual = robust.half_sample_mode(ratio)
    if usual <= 0.0:
        raise NothingToCompare
    line = robust.line(ratio / usual, squared, np.ones_like(ratio), ALIGNMENT.gain_scales, (1.0, 0.0))
    return np.pad(usual * np.array(line), (0, count - 2))


@njit(cache=True, nogil=True)
def normal_equations(
    sampled: Array, shading: Array, brightness: Array, residual: Array, scale: float, free: int
) -> tuple[Array, Array, Array, float]:
    """Geman-McClure weights (N,) of residuals (N,) and the normal equations: their matrix (P + K, P + K) and gradient
    (P + K,), for the first ``free`` of pan, log focal and tilt and the K gains of the ``shading`` (N, K).

    A pixel's residual is its grey value less ``brightness`` (N,) times the panorama's. At last the cost's mean second
    derivative as a share of the weight that stands for it in the matrix: weights fall as residuals grow.
    """
    count = free + shading.shape[1]
    weights, row = np.zeros(len(residual)), np.empty(count)
    normal, gradient = np.zeros((count, count)), np.zeros(count)
    curved, total = 0.0, 0.0
    for n in range(len(residual)):
        if sampled[n, KNOWN] == 0.0:
            continue
        weight = geman_mcclure(residual[n], scale)
        weights[n] = weight
        total += weight
        curved += weight * (4.0 * np.sqrt(weight) - 3.0)
        for i in range(free):
            row[i] = brightness[n] * sampled[n, BY_PAN + i]
        for i in range(free, count):
            row[i] = shading[n, i - free] * sampled[n, VALUE]
        for i in range(count):
            weighted = weight * row[i]
            gradient[i] -= weighted * residual[n]
            for j in range(i + 1):
                normal[i, j] += weighted * row[j]
    for i in range(count):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return weights, normal, gradient, curved / total
