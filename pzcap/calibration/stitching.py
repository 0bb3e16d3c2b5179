"""The empty hall on a cylinder, from a pan sweep (section 3.5).

`stitch` pastes the frames of an adjusted sweep about the pan axis: distortion, tilt and roll taken out, brightness made
equal, all frames that see a place averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import block_diag

from pzcap.calibration.bundle_adjustment import Link, matches_of
from pzcap.calibration.sweep import Frames
from pzcap.calibration.tuning import STITCHING
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.camera import View
from pzcap.geometry.parallax import parallax
from pzcap.imaging import bspline
from pzcap.solver.robust import geman_mcclure, normal_sigma
from pzcap.types import Array, Float32, Image, InverseDepthMap, Mask, Panorama


@dataclass(frozen=True, slots=True, eq=False)
class Brightness:
    """Photometric model of a sweep: a gain a frame, and one vignetting."""

    log_gain: Array  # (M,) of each frame of the sweep
    vignetting: Array  # (2,) of r^2 and r^4 in the log of the brightness, r = 1 in the image's corner


class ZoomedFrames(NamedTuple):
    """Frames of the zoom run that the calibration used."""

    numbers: NDArray[np.int64]  # (Z,) where they stand in the run
    log_focal: Array  # (Z,)
    pan_rad: float  # of all of them; the reference image's is 0


class SweptFrames(NamedTuple):
    """The sweep's grey frames as the panorama is stitched from them."""

    images: Sequence[Image]  # (H, W) each, M of them
    kept: NDArray[np.int64]  # (M,) where they stand in the sweep
    brightness: Brightness
    view: View  # of the sweep, at pan 0


def fit_brightness(links: Sequence[Link], frames: int, view: View, width: int, height: int) -> Brightness:
    """Fit the gains of the first ``frames`` frames and their vignetting to the brightness of matched features."""
    links = [link for link in links if max(link.first, link.second) < frames]
    ends, bounds, pixels = matches_of(links)
    begin, end = np.repeat(ends, np.diff(bounds), axis=0).T
    first, second = (_radial(points_px, view, width, height) for points_px in (pixels[:, :2], pixels[:, 2:]))
    gains = sparse.eye_array(frames, format="csr")
    design = sparse.hstack([gains[end] - gains[begin], sparse.csr_array(second - first)], format="csr")
    observed = np.concatenate([link.log_ratio for link in links])
    # only differences of gains are seen: their mean stays 0; and a weak belief that there is no vignetting
    prior = block_diag(np.full((frames, frames), 1.0 / frames), 1e-6 * len(observed) * np.eye(2))
    solution: Array = np.zeros(frames + 2)
    for _ in range(6):
        residual = observed - design @ solution
        weight = geman_mcclure(residual, 2.0 * max(normal_sigma(residual), 1e-3))
        weighted = design.T.multiply(weight)
        solution = np.asarray(np.linalg.solve((weighted @ design).toarray() + prior, weighted @ observed), np.float64)
    return Brightness(solution[:frames], solution[frames:])


def flatness(brightness: Brightness, view: View, width: int, height: int) -> Float32:
    """Factors (H, W) by which a frame's brightness is multiplied to take the vignetting out."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    pixels = np.stack([u, v], axis=-1).astype(np.float64)
    return np.exp(-_radial(pixels, view, width, height) @ brightness.vignetting).astype(np.float32)


def _radial(points_px: Array, view: View, width: int, height: int) -> Array:
    """r^2 and r^4 (..., 2) of pixels (..., 2), r = 1 in the image's corner."""
    squared = np.sum((points_px - view.principal_px) ** 2, axis=-1) / (width**2 + height**2) * 4.0
    return np.stack([squared, squared**2], axis=-1)


def stitch(
    frames: Frames, swept: SweptFrames, pan_rad: Array, full_turn: bool,
    surroundings: InverseDepthMap, report: Callable[[int], None],
) -> Panorama:  # fmt: skip
    """Paste those ``frames`` of a sweep that ``swept`` has kept, taken at ``pan_rad`` (M,), on the cylinder about
    the pan axis.

    Twice: what differs from the first result, made of the M grey frames of ``swept``, is somebody who walked through
    the sweep, and counts little in the second. The panorama is as fine as the sweep in the middle of its frames, its
    azimuth 0 is pan 0; ``sweep_inliers``, ``closure_rad`` and ``residual_px`` are left 0.
    """
    canvas = _Canvas(swept, pan_rad, full_turn, 1, surroundings)
    places = list(zip(pan_rad.tolist(), swept.brightness.log_gain.tolist(), strict=True))
    for number, image in enumerate(swept.images):
        canvas.paste(image, *places[number], None)
        report(number + 1)
    before = canvas.finish()[0][..., 0]
    canvas = _Canvas(swept, pan_rad, full_turn, 3, surroundings)
    numbers = {int(index): number for number, index in enumerate(swept.kept)}
    for number, image in ((numbers[index], image) for index, image in frames if index in numbers):
        canvas.paste(image, *places[number], before)
        report(len(swept.images) + number + 1)
    image, valid = canvas.finish()
    return Panorama(
        image, valid, canvas.px_per_rad, canvas.origin, full_turn, pan_rad, np.zeros(len(pan_rad), np.int64), 0.0, 0.0,
        surroundings,
    )  # fmt: skip


class _Canvas:
    """A panorama in the making: sums of weighted colours, and of weights."""

    def __init__(
        self, swept: SweptFrames, pan_rad: Array, full_turn: bool, channels: int, surroundings: InverseDepthMap
    ) -> None:
        height, width = swept.images[0].shape
        self.view, self.full_turn, self.surroundings = swept.view, full_turn, surroundings
        view = swept.view
        points = np.stack(np.meshgrid(np.linspace(0, width - 1, 64), np.linspace(0, height - 1, 64)), axis=-1)
        azimuth, slope = geometry.pixel_to_direction(replace(view, pan_rad=0.0), points)
        self.left, self.right = float(azimuth.max()), float(azimuth.min())
        columns = round(2 * np.pi * view.focal_px)
        self.px_per_rad = columns / (2 * np.pi)
        if full_turn:
            origin_column = columns / 2
        else:
            origin_column = np.ceil((pan_rad.max() + self.left) * self.px_per_rad)
            columns = int(np.ceil(origin_column - (pan_rad.min() + self.right) * self.px_per_rad)) + 1
        rows = int(np.ceil((slope.max() - slope.min()) * self.px_per_rad)) + 1
        self.origin = np.array([float(origin_column), float(slope.max() * self.px_per_rad)])
        self.colour = np.zeros((rows, columns, channels), np.float32)
        self.weight = np.zeros((rows, columns), np.float32)
        u, v = np.meshgrid(np.arange(width), np.arange(height))
        self.flat = cv2.merge([flatness(swept.brightness, view, width, height)] * channels)
        across = 1.0 - np.abs(2.0 * u / (width - 1) - 1.0)
        edge = np.minimum(v, height - 1 - v) / STITCHING.feather_px
        # the outermost rings weigh nothing: what interpolation takes from beyond the edge does not count
        inside = (np.minimum(u, width - 1 - u) > 1) & (np.minimum(v, height - 1 - v) > 1)
        self.trust = (inside * (across + 0.02) * np.minimum(edge + 0.02, 1.0)).astype(np.float32)

    def paste(self, image: Image, pan_rad: float, log_gain: float, before: Image | None) -> None:
        """Add a frame; what differs from the grey panorama ``before`` counts little."""
        start = int(np.floor(self.origin[0] - (pan_rad + self.left) * self.px_per_rad))
        stop = int(np.ceil(self.origin[0] - (pan_rad + self.right) * self.px_per_rad)) + 1
        if not self.full_turn:
            start, stop = max(start, 0), min(stop, self.weight.shape[1])
        turned = replace(self.view, pan_rad=pan_rad)

        def to_frame(points_px: Array) -> Array:
            offset = (self.origin - points_px - np.array([start, 0.0])) / self.px_per_rad
            azimuth, slope = offset[..., 0], offset[..., 1]
            near = cylinder.inverse_distance(self.surroundings, azimuth, slope)
            moved = parallax(turned, azimuth, slope, near)
            return geometry.direction_to_pixel(turned, azimuth + moved[0], slope + moved[1])[0]

        column, row = cylinder.smooth_map(to_frame, stop - start, self.weight.shape[0])
        gain = float(np.exp(-log_gain))
        level = np.asarray(cv2.multiply(image, self.flat, scale=gain, dtype=cv2.CV_32F), np.float32)
        weight = cv2.remap(self.trust, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        if before is None:  # to tell who walks there is enough
            warped = cv2.remap(level, column, row, cv2.INTER_LINEAR)[..., None]
        else:
            warped = bspline.warped(level, column, row)
        for here, there in self._parts(start, stop):
            own, part = np.asarray(weight[:, there], np.float32), np.asarray(warped[:, there], np.float32)
            if before is not None:
                seen = np.asarray(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), np.float32)
                own = own * agreement(seen - before[:, here].astype(np.float32))
            _add(part, own, self.colour[:, here], self.weight[:, here])

    def _parts(self, start: int, stop: int) -> list[tuple[slice, slice]]:
        """The canvas's columns of a strip that begins and ends there, and the strip's: in two where it lies across the
        seam of a full turn."""
        width = self.weight.shape[1]
        turned = start // width * width
        first, end = start - turned, stop - turned
        parts = [(slice(first, min(end, width)), slice(0, width - first))]
        return parts if end <= width else [*parts, (slice(0, end - width), slice(width - first, None))]

    def finish(self) -> tuple[Image, Mask]:
        valid = self.weight > 1e-3
        colour = self.colour / np.maximum(self.weight, 1e-6)[..., None]
        colour[~valid] = 0.0
        return np.clip(np.rint(colour), 0, 255).astype(np.uint8), valid


@njit(cache=True, nogil=True)
def _add(image: Float32, weight: Float32, colour: Float32, total: Float32) -> None:
    """Add an ``image`` (H, W, C) times its ``weight`` (H, W) to the sums of both."""
    for i in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            total[i, j] += weight[i, j]
            for c in range(image.shape[2]):
                colour[i, j, c] += weight[i, j] * image[i, j, c]


def agreement(difference: Float32) -> Float32:
    """Weights (H, W) of pixels, `geman_mcclure` of the mean ``difference`` (H, W) around them in grey levels."""
    around = cv2.boxFilter(np.abs(difference), -1, (9, 9))
    return np.asarray(geman_mcclure(around, STITCHING.different), np.float32)
