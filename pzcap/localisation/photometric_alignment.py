"""Pan, tilt and focal length of a frame from its grey values and the panorama's (direct alignment).

Grey values tell a place more exactly than features do, since all edges count. The residual of a pixel is

    r = grey - (g_0 + g_1 rho^2 + g_2 rho^4) P(direction(pixel; pan, tilt, log focal)),

with P the panorama and the polynomial in the distance rho from the principal point for gain and vignetting. Place and
gains minimise the Geman-McClure cost of all residuals by Gauss-Newton steps, so that pixels that do not fit (the
athlete, a shadow) lose their weight. From coarse to fine, so that the frame before is a good enough start for the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numba import njit

from pzcap.calibration.sweep import grey
from pzcap.localisation.frame_pixels import FramePixels, level_pixels
from pzcap.localisation.panorama_sampler import BY_PAN, KNOWN, VALUE, PanoramaSampler, PanTiltZoom
from pzcap.localisation.superresolved_alignment import Look, every_pixel
from pzcap.localisation.tuning import ALIGNMENT, LEVELS, SUPERRESOLVED
from pzcap.solver import robust
from pzcap.solver.gauss_newton import SolveReport
from pzcap.types import Array, Image, Mask, Panorama, PanZoomCamera


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


class _Limits(NamedTuple):
    """What a fit ends by."""

    steps: int
    settled_px: float
    least_noise: float = ALIGNMENT.least_noise


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Result of a fit, with what its last step was made from."""

    at: PanTiltZoom
    gains: Array  # (K,) of the shading
    points: Array  # (N, 2)
    sampled: Array  # (N, 7)
    residual: Array  # (N,)
    weight: Array  # (N,)
    normal: Array  # (P + K, P + K)
    report: SolveReport


class Aligner:
    """Aligns frames of one camera with its panorama by about ``pixels`` of each frame; in tilt as well with
    ``free_tilt``, else the camera's is kept."""

    def __init__(
        self, panorama: Panorama, camera: PanZoomCamera, *, pixels: int = 4000, free_tilt: bool = False
    ) -> None:
        self._free = 3 if free_tilt else 2
        self._camera = camera
        self._sampler = PanoramaSampler(panorama, camera, pixels)

    def align(
        self, image: Image, pan_rad: float, tilt_rad: float, focal_px: float, off_px: float, hidden: Mask | None = None
    ) -> Alignment:
        """Refine a pan and a focal length, and a tilt if that is free.

        The start may be off by ``off_px`` pixels of the panorama, up to 15; the less, the faster. Pixels that are
        ``hidden`` (H, W) are not compared. The agreement is 0 where the panorama is unknown, or the frame dark.
        """
        frame, at = grey(image), PanTiltZoom(pan_rad, tilt_rad, focal_px)
        fit = None
        for index in range(sum(level.reach_px >= off_px for level in LEVELS) - 1, len(LEVELS)):
            fit = self._fit_level(index, frame, hidden, at)
            if fit is None:
                nothing = np.empty((0, 2))
                return Alignment(*at, np.eye(2), 0.0, SolveReport(False, 0, 0.0), nothing, nothing)
            at = fit.at
        assert fit is not None
        if self._sampler.superresolved is not None and fit.report.converged:
            pixels, look = every_pixel(self._sampler, self._camera, frame, hidden, at.focal_px)
            limits = _Limits(SUPERRESOLVED.steps, SUPERRESOLVED.settled_px, SUPERRESOLVED.least_noise)
            finer = self._fit(look, pixels, at, fit.gains, limits)
            fit = finer if finer is not None and finer.report.converged else fit
        return self._alignment(fit)

    def _fit_level(self, index: int, frame: Image, hidden: Mask | None, at: PanTiltZoom) -> _Fit | None:
        """Alignment with one of `LEVELS`."""
        level, steps = self._sampler.levels[index], LEVELS[index].steps
        pixels = level_pixels(frame, hidden, self._camera.lens, at.focal_px, self._sampler.px_per_rad, level)
        look = partial(self._sampler.sample, level.layer)
        if level.scale > 1:
            return self._fit(look, pixels, at, None, _Limits(steps, 0.0))
        near = self._fit(look, pixels.thinned(ALIGNMENT.sparse), at, None, _Limits(steps, ALIGNMENT.near_px))
        if near is None:
            return None
        return self._fit(look, pixels, near.at, near.gains, _Limits(steps, ALIGNMENT.settled_px))

    def _fit(
        self, look: Look, pixels: FramePixels, at: PanTiltZoom, gains: Array | None, limits: _Limits
    ) -> _Fit | None:
        """Gauss-Newton steps with Geman-McClure weights until one is shorter than ``limits.settled_px``; None where the
        panorama is unknown, or the frame dark."""
        rays = self._sampler.rays(pixels.points, at)
        converged, step = False, 0
        while step < limits.steps and not converged:
            step += 1
            if rays.far_from(at):
                rays = self._sampler.rays(pixels.points, at)
            sampled = look(rays, at)
            usable = sampled[:, KNOWN] > 0
            if usable.sum() < ALIGNMENT.least_pixels:
                return None
            if gains is None:
                ratio = pixels.grey[usable] / np.maximum(sampled[usable, VALUE], 1.0)
                gains = _first_gains(ratio, pixels.shading[usable, 1], pixels.shading.shape[1])
                if gains is None:
                    return None
            brightness = pixels.shading @ gains
            residual = pixels.grey - brightness * sampled[:, VALUE]
            noise = max(1.4826 * robust.median_absolute(residual[usable]), limits.least_noise)
            scale = ALIGNMENT.scale_sigmas * noise
            weight, normal, right, curvature = normal_equations(
                sampled, pixels.shading, brightness, residual, scale, self._free
            )
            change = np.linalg.solve(_regularised(normal), right)
            moved_px = max(abs(change[0]) * at.focal_px, abs(change[1]) * self._camera.lens.width / 2)
            if moved_px < ALIGNMENT.near_px:  # so near, Gauss-Newton steps are too short by this factor
                change /= max(curvature, ALIGNMENT.least_curvature)
            zoom = float(np.exp(np.clip(change[1], -ALIGNMENT.largest_zoom, ALIGNMENT.largest_zoom)))
            tilt_rad = at.tilt_rad + (float(change[2]) if self._free == 3 else 0.0)
            at = PanTiltZoom(at.pan_rad + float(change[0]), tilt_rad, at.focal_px * zoom)
            gains = gains + change[self._free :]
            brightened = np.abs((pixels.shading @ change[self._free :]) * sampled[:, VALUE]).max() / scale
            converged = bool(moved_px < limits.settled_px and brightened < ALIGNMENT.settled_share)
        assert gains is not None
        report = SolveReport(converged, step, float(weight @ residual**2))
        return _Fit(at, gains, pixels.points, sampled, residual, weight, normal, report)

    def _alignment(self, fit: _Fit) -> Alignment:
        sampled, weight = fit.sampled, fit.weight
        variance = fit.report.cost / float(weight.sum())
        usable = sampled[:, KNOWN] > 0
        value = sampled[usable, VALUE]
        contrast = robust.median(np.abs(value - robust.median(value)))
        difference = robust.median_absolute(fit.residual[usable])
        strength = np.abs(sampled[:, BY_PAN]) * weight
        strongest = min(5 * ALIGNMENT.shown, len(strength))
        least = np.partition(strength, -strongest)[-strongest]
        shown = np.flatnonzero(strength >= least)[::5]
        covariance = np.asarray(variance * np.linalg.inv(_regularised(fit.normal))[:2, :2], np.float64)
        agreement = 1.0 - difference / max(contrast, 1.0)
        places = self._sampler.panorama_px(sampled[shown])
        return Alignment(*fit.at, covariance, agreement, fit.report, fit.points[shown], places)


def _first_gains(ratio: Array, squared: Array, count: int) -> Array | None:
    """Gains (K,) from the ratios (N,) of frame to panorama at ``squared`` distances (N,), before anything is fitted;
    with others everything would be an outlier. Most pixels show the hall. None where most of the frame is black."""
    usual = robust.half_sample_mode(ratio)
    if usual <= 0.0:
        return None
    fall = robust.line(ratio / usual, squared, np.ones_like(ratio), ALIGNMENT.gain_scales, (1.0, 0.0))
    gains = np.zeros(count)
    gains[:2] = usual * np.array(fall)
    return gains


def _regularised(normal: Array) -> Array:
    """Normal equations that can be solved, whatever they leave open."""
    return np.asarray(normal + 1e-9 * np.diag(np.diag(normal)))


@njit(cache=True, nogil=True)
def normal_equations(
    sampled: Array, shading: Array, brightness: Array, residual: Array, scale: float, free: int
) -> tuple[Array, Array, Array, float]:
    """Geman-McClure weights (N,) of residuals (N,) and the normal equations: their matrix (P + K, P + K) and right side
    (P + K,), for the first ``free`` of pan, log focal and tilt and the K gains of the ``shading`` (N, K).

    A pixel's residual is its grey value less ``brightness`` (N,) times the panorama's. At last the cost's mean second
    derivative as a share of the weight that stands for it in the matrix: weights fall as residuals grow.
    """
    count = free + shading.shape[1]
    weights, row = np.zeros(len(residual)), np.empty(count)
    normal, right = np.zeros((count, count)), np.zeros(count)
    curved, total = 0.0, 0.0
    for n in range(len(residual)):
        if sampled[n, KNOWN] == 0.0:
            continue
        nearness = 1.0 / (1.0 + (residual[n] / scale) ** 2)
        weight = nearness * nearness
        weights[n] = weight
        total += weight
        curved += weight * (4.0 * nearness - 3.0)
        for i in range(free):
            row[i] = brightness[n] * sampled[n, BY_PAN + i]
        for i in range(free, count):
            row[i] = shading[n, i - free] * sampled[n, VALUE]
        for i in range(count):
            weighted = weight * row[i]
            right[i] += weighted * residual[n]
            for j in range(i + 1):
                normal[i, j] += weighted * row[j]
    for i in range(count):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return weights, normal, right, curved / total
