"""Pan and zoom to a fraction of a pixel: the frame's grey values against the panorama's (direct alignment).

Features say where a frame is; its pixels, all of them, say it better. The residual of a pixel is its grey value minus
what the panorama shows in its direction, made as bright as the frame by a gain and a vignetting that are found along
with pan and log focal. Pixels that do not fit (the athlete, her shadow) lose their weight. From coarse to fine, so that
the frame before is a good enough start for the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.sweep import grey
from pzcap.geometry.lens import at as lens_at
from pzcap.imaging.bspline import smoothed, softened
from pzcap.imaging.pyramid import Layer, Level, halved, super_resolved
from pzcap.localisation.panorama_sampler import (
    BY_LOG_FOCAL,
    BY_PAN,
    BY_TILT,
    COLUMN,
    KNOWN,
    VALUE,
    boxes,
    looking,
    sample,
)
from pzcap.solver import robust
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array, Image, Mask, Panorama, PanZoomCamera

LEVELS = ((3, 4), (1, 2), (0, 12))  # from coarse to fine: halvings of the size, and Gauss-Newton steps, at most
SETTLED_PX = 0.025  # of the frame: a smaller step ends them, and leaves a tenth of that,
SETTLED_SHARE = 0.2  # if no pixel has become brighter by more than this share of the residuals' scale
SPARSE = 4  # on the finest level one pixel in so many is looked at
NEAR_PX = 0.2  # until a step is smaller than this, and then all
LEAST_FLATNESS = 0.6  # where more pixels do not fit, steps are lengthened by no more
FALLING = (0.3, 0.15, 0.08)  # scales of what a ratio of brightness differs by, from coarse to fine
FEWEST = 50  # pixels that show what the panorama knows
REACH_PX = (15.0, 4.0, 1.5)  # by how much a start may be off on each, pixels of the panorama
COARSE_PIXELS = {3: 1500, 1: 2000}  # looked at on the coarser levels, about
LOOSENESS = 4.0  # standard deviations at which a pixel counts for a quarter; tighter is less exact
LINEAR = 1e-3  # change of log focal, or of tilt, up to which rays are straight lines in it: to 0.001 pixels
BORDER = 3  # pixels at the frame's edge left out
FINE_STEPS = 12  # of Gauss-Newton, at most, on the super-resolved panorama where there is one,
FINE_SETTLED_PX = 0.0005  # until one is smaller than this
FINE_SMOOTHING = 1.0  # variance, square pixels of the frame: what is compared there, frame and prediction
LEAST_NOISE, FINE_NOISE = 1.0, 0.2  # grey levels, at least, that are taken for noise; there it is predicted so exactly
SURE_AGREEMENT = 0.5  # of what should be where it is looked for (see `Alignment`)
SHOWN = 80  # points given back as matches


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    pan_rad: float
    tilt_rad: float
    focal_px: float
    covariance: Array  # (2, 2) of (pan, log focal), from the residuals alone
    agreement: float  # 1 - the median difference's share of the median contrast: near 1 where it fits, else about 0
    settled: bool  # the fit came to rest; one that was stopped on its way agrees too, where a fast pan smears all
    frame_points_px: Array  # (N, 2) some pixels that fit, and show edges
    panorama_points_px: Array  # (N, 2) and where they stand on the panorama


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Where pixels of a frame look, and how that changes near one tilt and focal length."""

    tilt_rad: float
    focal_px: float
    directions: Array  # (N, 6)


Look = Callable[[_Rays, float, float, float], Array]
"""What the panorama shows along rays (N), at a pan, a tilt and a focal length; (N, 7), columns VALUE to ROW."""


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """What of a frame is compared."""

    points: Array  # (N, 2)
    grey: Array  # (N,)
    shading: Array  # (N, K) r^0, r^2, ... of the vignetting

    def thinned(self, every: int) -> _Pixels:
        return _Pixels(self.points[::every], self.grey[::every], self.shading[::every])


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """What is fitted."""

    pan_rad: float
    tilt_rad: float
    focal_px: float
    gains: Array | None  # (K,) of the shading; None: not known yet


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A level's last step."""

    state: _State
    points: Array  # (N, 2)
    sampled: Array  # (N, 7)
    residual: Array  # (N,)
    weight: Array  # (N,)
    normal: Array  # (P + K, P + K)
    settled: bool  # the last step was as small as it should be


class Aligner:
    """Aligns frames of one camera with its panorama by about ``pixels`` of each frame; in tilt as well with
    ``free_tilt``, else the camera's is kept."""

    def __init__(
        self, panorama: Panorama, camera: PanZoomCamera, *, pixels: int = 4000, free_tilt: bool = False
    ) -> None:
        self._free = 3 if free_tilt else 2
        self._panorama = panorama
        self._camera = camera
        # a full turn goes on beyond its ends, so that no frame lies across a seam
        self._margin = panorama.image.shape[1] // 4 // 8 * 8 if panorama.full_turn else 0
        border = (0, 0, self._margin, self._margin, cv2.BORDER_WRAP)
        image = cv2.copyMakeBorder(grey(panorama.image), *border).astype(np.float32)
        known = cv2.copyMakeBorder(panorama.valid.astype(np.uint8), *border).astype(np.float32)
        self._levels = {k: halved(image, known, k, COARSE_PIXELS.get(k, pixels)) for k, _ in LEVELS}
        self._fine = super_resolved(panorama, known, self._margin) if panorama.fine.size else None

    def align(
        self, image: Image, pan_rad: float, tilt_rad: float, focal_px: float, off_px: float, hidden: Mask | None = None
    ) -> Alignment:
        """Refine a pan and a focal length, and a tilt if that is free.

        The start may be off by ``off_px`` pixels of the panorama, up to 15; the less, the faster. Where the hall is
        known to be ``hidden`` (H, W) nothing is compared.
        """
        frame = grey(image)
        fitted = None
        for halvings, steps in LEVELS[sum(reach >= off_px for reach in REACH_PX) - 1 :]:
            fitted = self._fit(frame, hidden, self._levels[halvings], steps, pan_rad, tilt_rad, focal_px)
            if fitted is None:
                nothing = np.empty((0, 2))
                return Alignment(pan_rad, tilt_rad, focal_px, np.eye(2), 0.0, False, nothing, nothing)
            pan_rad, tilt_rad, focal_px = fitted.state.pan_rad, fitted.state.tilt_rad, fitted.state.focal_px
        assert fitted is not None
        if self._fine is not None and fitted.settled:
            whole, look = self._whole(self._fine, frame, hidden, fitted.state)
            finer = self._descend(look, whole, fitted.state, FINE_STEPS, FINE_SETTLED_PX, FINE_NOISE)
            fitted = finer if finer is not None and finer.settled else fitted
        return self._judged(fitted)

    def _fit(
        self, frame: Image, hidden: Mask | None, level: Level, steps: int, pan_rad: float, tilt_rad: float,
        focal_px: float,
    ) -> _Fitted | None:  # fmt: skip
        """A level's alignment; None where the panorama is unknown, or the frame dark."""
        pixels = self._pixels(frame, hidden, level, focal_px)
        start = _State(pan_rad, tilt_rad, focal_px, None)
        look = partial(self._sample, level.layer)
        if level.scale > 1:
            return self._descend(look, pixels, start, steps, 0.0)
        nearly = self._descend(look, pixels.thinned(SPARSE), start, steps, NEAR_PX)
        return None if nearly is None else self._descend(look, pixels, nearly.state, steps, SETTLED_PX)

    def _descend(
        self, look: Look, pixels: _Pixels, start: _State, steps: int, settled_px: float,
        least_noise: float = LEAST_NOISE,
    ) -> _Fitted | None:  # fmt: skip
        """At most so many steps of Gauss and Newton with the weights of Geman and McClure, until one is as small as
        ``settled_px``."""
        pan_rad, tilt_rad, focal_px, gains = start.pan_rad, start.tilt_rad, start.focal_px, start.gains
        rays = self._rays(pixels.points, pan_rad, tilt_rad, focal_px)
        for _ in range(steps):
            if max(abs(np.log(focal_px / rays.focal_px)), abs(tilt_rad - rays.tilt_rad)) > LINEAR:
                rays = self._rays(pixels.points, pan_rad, tilt_rad, focal_px)
            sampled = look(rays, pan_rad, tilt_rad, focal_px)
            usable = sampled[:, KNOWN] > 0
            if usable.sum() < FEWEST:
                return None
            if gains is None:  # the gain first, or everything is an outlier; most pixels show the hall
                ratio = pixels.grey[usable] / np.maximum(sampled[usable, VALUE], 1.0)
                half_sample_mode = robust.half_sample_mode(ratio)
                if half_sample_mode <= 0.0:  # most of the picture is black
                    return None
                fall = robust.line(
                    ratio / half_sample_mode, pixels.shading[usable, 1], np.ones_like(ratio), FALLING, (1.0, 0.0)
                )
                gains = np.zeros(pixels.shading.shape[1])
                gains[:2] = half_sample_mode * np.array(fall)
            brightness = pixels.shading @ gains
            residual = pixels.grey - brightness * sampled[:, VALUE]
            scale = LOOSENESS * max(1.4826 * robust.median_absolute(residual[usable]), least_noise)
            weight, normal, slope, flatness = _weigh(sampled, pixels.shading, brightness, residual, scale, self._free)
            change = np.linalg.solve(_firm(normal), slope)
            moved_px = max(abs(change[0]) * focal_px, abs(change[1]) * self._camera.lens.width / 2)
            if moved_px < NEAR_PX:  # there the steps are too short by so much
                change /= max(flatness, LEAST_FLATNESS)
            pan_rad += float(change[0])
            focal_px *= float(np.exp(np.clip(change[1], -0.1, 0.1)))
            tilt_rad += float(change[2]) if self._free == 3 else 0.0
            gains = gains + change[self._free :]
            brightened = np.abs((pixels.shading @ change[self._free :]) * sampled[:, VALUE]).max() / scale
            settled = bool(moved_px < settled_px and brightened < SETTLED_SHARE)
            if settled:
                break
        state = _State(pan_rad, tilt_rad, focal_px, gains)
        return _Fitted(state, pixels.points, sampled, residual, weight, normal, settled)

    def _pixels(self, frame: Image, hidden: Mask | None, level: Level, focal_px: float) -> _Pixels:
        """What is compared on a level."""
        lens = self._camera.lens
        shrink = focal_px / self._panorama.px_per_rad * level.scale  # the frame is so much finer than the level
        # by fractions it is smoothed alone, see `sampling.softened`; so it is where it would have too few pixels else
        whole = max(int(min(shrink, np.sqrt(frame.size / level.pixels))), 1)
        size = (lens.width // whole, lens.height // whole)
        small = cv2.resize(frame[: size[1] * whole, : size[0] * whole], size, interpolation=cv2.INTER_AREA)
        flat = focal_px / whole, (lens_at(lens, focal_px)[0][0] + 0.5) / whole - 0.5
        soft = softened(np.asarray(small, np.uint8), shrink / whole, flat)
        chosen = _edges(soft, max(1, round(np.sqrt(soft.size / level.pixels))))
        if hidden is not None:
            column, row = (chosen * whole + whole // 2).T
            chosen = chosen[~hidden[row, column]]
        observed = soft[chosen[:, 1], chosen[:, 0]].astype(np.float64)
        points = (chosen.astype(np.float64) + 0.5) * whole - 0.5
        return _Pixels(points, observed, self._shading(points, focal_px)[:, : 3 if level.scale == 1 else 2])

    def _whole(self, fine: Layer, frame: Image, hidden: Mask | None, state: _State) -> tuple[_Pixels, Look]:
        """All pixels, and what the super-resolved panorama has for the square of each; both are then smoothed alike.

        What the frame's pixels are too coarse for is in the prediction as well as long as it is not smoothed before.
        """
        inner = slice(BORDER, -BORDER)
        soft = smoothed(frame, FINE_SMOOTHING)[inner, inner]
        seen = np.ones(soft.shape, np.uint8) if hidden is None else (~hidden[inner, inner]).astype(np.uint8)
        around = np.ones((7, 7), np.uint8)  # beyond is too little to count
        rows, columns = np.mgrid[BORDER : frame.shape[0] - BORDER, BORDER : frame.shape[1] - BORDER]
        points = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
        covered = boxes(self._camera, points, state.focal_px) * self._panorama.px_per_rad
        layer = replace(fine, half=covered / np.array(fine.scale))

        def look(rays: _Rays, pan_rad: float, tilt_rad: float, focal_px: float) -> Array:
            out = self._sample(layer, rays, pan_rad, tilt_rad, focal_px)
            for column in (VALUE, BY_PAN, BY_LOG_FOCAL, BY_TILT)[: 1 + self._free]:
                image = out[:, column].reshape(soft.shape).astype(np.float32)
                out[:, column] = smoothed(image, FINE_SMOOTHING).ravel()
            whole = (out[:, KNOWN].reshape(soft.shape) > 0).astype(np.uint8) & seen
            out[:, KNOWN] = cv2.erode(whole, around, borderType=cv2.BORDER_CONSTANT, borderValue=0).ravel()
            return out

        return _Pixels(points, soft.ravel().astype(np.float64), self._shading(points, state.focal_px)), look

    def _shading(self, points: Array, focal_px: float) -> Array:
        """(N, 3) r^0, r^2 and r^4 of points (N, 2): it is the lens that darkens corners."""
        lens = self._camera.lens
        across, down = (points - lens_at(lens, focal_px)[0]).T
        squared = (across * across + down * down) * 4.0 / (lens.width**2 + lens.height**2)
        return np.stack([np.ones_like(squared), squared, squared * squared], axis=1)

    def _rays(self, points: Array, pan_rad: float, tilt_rad: float, focal_px: float) -> _Rays:
        """Where ``points`` (N, 2) look."""
        looks = looking(self._panorama, self._camera, points, pan_rad, tilt_rad, focal_px)
        return _Rays(tilt_rad, focal_px, looks)

    def _sample(self, layer: Layer, rays: _Rays, pan_rad: float, tilt_rad: float, focal_px: float) -> Array:
        """What the panorama shows along ``rays`` (N), as those change; (N, 7), columns VALUE to ROW."""
        panorama = self._panorama
        column = panorama.origin_px[0] - pan_rad * panorama.px_per_rad
        if panorama.full_turn:
            column = np.mod(column, panorama.image.shape[1])
        place = np.array([column + self._margin, panorama.origin_px[1], panorama.px_per_rad, *layer.scale])
        change = np.array([np.log(focal_px / rays.focal_px), tilt_rad - rays.tilt_rad])
        return sample(layer.image, layer.known, rays.directions, change, place, layer.half)

    def _judged(self, fitted: _Fitted) -> Alignment:
        sampled, weight = fitted.sampled, fitted.weight
        variance = float(weight @ fitted.residual**2) / float(weight.sum())
        usable = sampled[:, KNOWN] > 0
        value = sampled[usable, VALUE]
        contrast = robust.median(np.abs(value - robust.median(value)))
        difference = robust.median_absolute(fitted.residual[usable])
        strength = np.abs(sampled[:, BY_PAN]) * weight
        strongest = min(5 * SHOWN, len(strength))
        least = np.partition(strength, -strongest)[-strongest]
        shown = np.flatnonzero(strength >= least)[::5]
        places = sampled[shown, COLUMN:] - np.array([self._margin, 0.0])
        if self._panorama.full_turn:
            places[:, 0] = np.mod(places[:, 0], self._panorama.image.shape[1])
        return Alignment(
            fitted.state.pan_rad, fitted.state.tilt_rad, fitted.state.focal_px,
            np.asarray(variance * np.linalg.inv(_firm(fitted.normal))[:2, :2], np.float64),
            1.0 - difference / max(contrast, 1.0), fitted.settled, fitted.points[shown], places,
        )  # fmt: skip


def _firm(normal: Array) -> Array:
    """Normal equations that can be solved, whatever they leave open."""
    return np.asarray(normal + 1e-9 * np.diag(np.diag(normal)))


@njit(cache=True, nogil=True)
def _weigh(
    sampled: Array, shading: Array, brightness: Array, residual: Array, scale: float, free: int
) -> tuple[Array, Array, Array, float]:
    """Weights (N,) after Geman and McClure of residuals (N,), and the normal equations of what is fitted.

    These are the matrix (P + K, P + K) and the negative slope (P + K,) of the cost, for ``free`` of pan, log focal and
    tilt and the K gains of the ``shading`` (N, K), which make the grey of the panorama so bright (N,). At last how flat
    the cost is: its mean second derivative over the mean weight that stands for it in the matrix; weights fall as
    residuals grow.
    """
    count = free + shading.shape[1]
    weights, row = np.zeros(len(residual)), np.empty(count)
    normal, slope = np.zeros((count, count)), np.zeros(count)
    curved, total = 0.0, 0.0
    for n in range(len(residual)):
        if sampled[n, KNOWN] == 0.0:
            continue
        weight = geman_mcclure((residual[n] / scale) ** 2)
        weights[n] = weight
        total += weight
        curved += weight * (4.0 * np.sqrt(weight) - 3.0)
        for i in range(free):
            row[i] = brightness[n] * sampled[n, BY_PAN + i]
        for i in range(free, count):
            row[i] = shading[n, i - free] * sampled[n, VALUE]
        for i in range(count):
            weighted = weight * row[i]
            slope[i] += weighted * residual[n]
            for j in range(i + 1):
                normal[i, j] += weighted * row[j]
    for i in range(count):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return weights, normal, slope, curved / total


@njit(cache=True, nogil=True)
def _edges(image: NDArray[np.float32], cell: int) -> NDArray[np.int64]:
    """(N, 2) the pixel of the steepest edge in each cell of so many pixels across; every second row is looked at."""
    rows, columns = (image.shape[0] - 2 * BORDER) // cell, (image.shape[1] - 2 * BORDER) // cell
    chosen = np.empty((rows * columns, 2), np.int64)
    steepness = np.empty(columns * cell, np.float32)
    steepest = np.empty(columns, np.float32)
    for row in range(rows):
        steepest[:] = -1.0
        for i in range(BORDER + row * cell, BORDER + (row + 1) * cell, 2):
            above, here, below = image[i - 1], image[i], image[i + 1]
            for n in range(columns * cell):
                j = BORDER + n
                across, down = here[j + 1] - here[j - 1], below[j] - above[j]
                steepness[n] = across * across + down * down
            for column in range(columns):
                for n in range(column * cell, (column + 1) * cell):
                    if steepness[n] > steepest[column]:
                        steepest[column] = steepness[n]
                        chosen[row * columns + column, 0], chosen[row * columns + column, 1] = BORDER + n, i
    return chosen
