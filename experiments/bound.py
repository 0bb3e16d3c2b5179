"""The Cramer-Rao lower bound: how exactly pan and focal length of a frame can be known at all, from its pixels.

An unbiased estimate of pan and log focal from one frame has no smaller covariance than the inverse of the Fisher
information (Rao, 1945; Cramer, 1946). With Gaussian noise of variance ``var`` in a pixel whose expected grey value
``s`` changes by ``ds`` with the parameters, that is the sum of ``ds ds^T / var`` over the pixels.

Scene
    What was known of the hall before the motion is the panorama; what the sweep did not resolve tells nobody anything.
    It is seen through the true camera, shrunk to its pixels where it zooms out. The panorama's own noise would pass for
    texture: its expected share is taken off. That it also blurs what an estimator can know is left out.
Noise
    The sensor's, as the truth's config has it: read noise, shot noise and rounding to whole grey levels. Compression,
    motion blur and changes of the light are not noise to be averaged out, and are left out: this is a lower bound.
Channels
    The grey value that the estimators use. Red, green and blue used jointly would know more, by a factor of 0.86 in
    sigma where the hall is grey and less where it is colourful; but a video keeps colour at half the resolution
    (4:2:0), so that the grey value is what there is at the resolution of the bound.
Nuisance
    The brightness of the frame, one gain, is not known beforehand and has to be estimated along. Vignetting, lens,
    tilt and roll are known.
Pixels
    Those where the panorama knows the hall, off the athlete (the true mask) by two pixels.
"""

from __future__ import annotations

import json
import queue
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.camera import View
from pzcap.geometry.lens import of as lens_of
from pzcap.scoring.records import Series
from pzcap.types import Array, Lens, Mask, Panorama, PanZoomCamera, Reconstruction
from sim.truth import Truth

GREY: Final = np.array([0.114, 0.587, 0.299])
"""Shares of blue, green and red in the grey value, as OpenCV has them."""
ROUNDING: Final = float(GREY @ GREY) / 12.0
"""Variance of the grey value when its channels are rounded to whole levels."""
AROUND_PX: Final = 2
"""Pixels about the athlete, and at the panorama's ragged edge, that are left out."""
GRID: Final = 8
"""Maps and derivatives are smooth: they are computed at every eighth pixel and interpolated."""
STRIDE: Final = 2
"""Every second pixel of every second row stands for its neighbours: the bound changes by 0.2 %, and takes a quarter."""
THREADS: Final = 2

Layer = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Sensor:
    """Noise by which one image of the same view differs from the next."""

    read_noise: float  # standard deviation, grey levels
    shot_noise: float  # variance a grey level
    vignetting: float  # brightness in the image's corners, of that in the middle

    def variance(self, share: Layer) -> Layer:
        """Variance of the grey value (N,), where the channels' levels, times ``GREY`` squared, sum up to ``share``."""
        return np.asarray(np.float32(self.read_noise**2 * (GREY @ GREY) + ROUNDING) + self.shot_noise * share)


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """The least standard deviation that an honest estimate can have, a frame. None lies below it."""

    pan_rad: Series
    log_focal: Series


def bounds(
    reconstruction: Reconstruction, truth: Truth, frames: NDArray[np.int64], report: Callable[[int, int], None]
) -> tuple[Bound | None, ...]:
    """The bound for every camera and frame set; ``frames`` (F,) are indices into the truth.

    None for a camera without a panorama, and for the paper's method: its panorama does not stand about the pan axis.
    ``report(done, total)`` hears of every view.
    """
    sensor = sensor_of(truth)
    panoramas = [None if reconstruction.method == "paper" else panorama for panorama in reconstruction.panoramas]
    total, done = len(frames) * sum(panorama is not None for panorama in panoramas), 0
    news: queue.SimpleQueue[int] = queue.SimpleQueue()

    def one(name: str, panorama: Panorama | None) -> Bound | None:
        if panorama is None:
            return None
        return _bound(panorama, sensor, truth, truth.camera_names.index(name), frames, lambda: news.put(1))

    with ThreadPoolExecutor(THREADS) as pool:
        jobs = [pool.submit(one, *pair) for pair in zip(reconstruction.camera_names, panoramas, strict=True)]
        for job in jobs:
            job.add_done_callback(lambda _: news.put(0))
        running = len(jobs)
        while running:
            step = news.get()
            running -= step == 0
            done += step
            report(done, total)
        return tuple(job.result() for job in jobs)


def sensor_of(truth: Truth) -> Sensor:
    """The sensor and the vignetting of the shoot."""
    config = json.loads(truth.config)
    return Sensor(
        config["sensor"]["read_noise"], config["sensor"]["shot_noise"], config["optics"]["vignetting"]
    )  # fmt: skip


def _bound(
    panorama: Panorama,
    sensor: Sensor,
    truth: Truth,
    camera: int,
    frames: NDArray[np.int64],
    finished: Callable[[], None],
) -> Bound:
    lens = truth.lens(camera)
    scene: Scene | None = None
    sigma, valid = np.zeros((2, len(frames))), np.zeros(len(frames), bool)
    shrinking = [blur_level(panorama, truth.focal_px[camera, frame]) for frame in frames]
    for at in np.argsort(shrinking, kind="stable"):  # so that there is one scene at a time
        frame = frames[at]
        true = truth.camera(camera, int(frame))
        instant = camera, int(frame)
        view = View(
            float(truth.pan_rad[instant]), float(truth.tilt_rad[instant]), float(truth.roll_rad[instant]),
            true.focal_px, true.principal_px, lens_of(true),
        )  # fmt: skip
        if scene is None or scene.shrinking != shrinking[at]:
            scene = build_scene(panorama, sensor, shrinking[at], lens.width)
        covariance = least_covariance(information(scene, lens, view, truth.mask(camera, int(frame))))
        if covariance is not None:
            sigma[:, at], valid[at] = np.sqrt(np.diag(covariance)), True
        finished()
    return Bound(Series(sigma[0], valid), Series(sigma[1], valid))


# --------------------------------------------------------------------------------------------------------------
# The scene as the panorama knows it


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A panorama, with its derivatives, as sharp as a frame shows it at one zoom."""

    panorama: Panorama
    sensor: Sensor
    shrinking: float  # panorama pixels to one of the frame's
    layers: Layer  # (H, W, 4) grey, its derivatives along columns and rows, the share of shot noise in its variance
    known: NDArray[np.uint8]  # (H, W)
    noise_gain: float  # variance of a derivative, of that of a pixel
    averaged: float  # frames of the sweep that saw a place


def blur_level(panorama: Panorama, focal_px: float) -> float:
    """Panorama pixels to one of a frame's at this focal length, in steps of a tenth; 1 where the frame is finer."""
    return max(1.0, round(10.0 * panorama.px_per_rad / focal_px) / 10.0)


def build_scene(panorama: Panorama, sensor: Sensor, shrinking: float, width: int) -> Scene:
    """``panorama`` prepared for frames ``width`` pixels wide, of which one covers ``shrinking`` of its own."""
    blur = _blur(shrinking)
    slope = np.convolve(blur, _spline_derivative())
    margin = len(slope)
    sides = cv2.BORDER_WRAP if panorama.full_turn else cv2.BORDER_REPLICATE
    image = cv2.copyMakeBorder(panorama.image, 0, 0, margin, margin, sides).astype(np.float32)
    grey, shot = image @ GREY.astype(np.float32), image @ (GREY**2).astype(np.float32)
    layers = [(grey, blur, blur), (grey, slope, blur), (grey, blur, slope), (shot, blur, blur)]
    filtered = [cv2.sepFilter2D(layer, cv2.CV_32F, across, down) for layer, across, down in layers]
    around = np.ones((2 * AROUND_PX + 1, 2 * AROUND_PX + 1), np.uint8)
    known = cv2.copyMakeBorder(panorama.valid.astype(np.uint8), 0, 0, margin, margin, sides)
    known = cv2.erode(known, around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    field = 2.0 * np.arctan(width / 2.0 / panorama.px_per_rad)
    covered = 2.0 * np.pi if panorama.full_turn else float(np.ptp(panorama.sweep_pan_rad)) + field
    return Scene(
        panorama, sensor, shrinking,
        np.ascontiguousarray(np.dstack(filtered)[:, margin:-margin]), np.ascontiguousarray(known[:, margin:-margin]),
        _noise_left(slope) * _noise_left(blur), max(1.0, len(panorama.sweep_pan_rad) * field / covered),
    )  # fmt: skip


def _blur(shrinking: float) -> Array:
    """Blur of a pixel that covers ``shrinking`` of another's beyond the other's: the difference of their variances."""
    variance = (shrinking**2 - 1.0) / 12.0
    passes = max(1, int(np.ceil(variance / 0.25)))
    once = np.array([0.5, 0.0, 0.5]) * variance / passes + np.array([0.0, 1.0, 0.0]) * (1.0 - variance / passes)
    kernel = np.ones(1)
    for _ in range(passes):
        kernel = np.convolve(kernel, once)
    return kernel


def _spline_derivative() -> Array:
    """Filter (13,) for the derivative at its nodes of the cubic spline through samples (Unser, 1999).

    Good to 5 % at a wavelength of 4 pixels, where a central difference sees 36 % too little.
    """
    pole = np.sqrt(3.0) - 2.0
    direct = -6.0 * pole / (1.0 - pole**2) * pole ** np.abs(np.arange(-5, 6))
    return np.convolve(direct, [-0.5, 0.0, 0.5])


def _noise_left(kernel: Array) -> float:
    """Variance of white noise after ``kernel`` and OpenCV's cubic interpolation between pixels, on average."""
    variances = []
    for share in (np.arange(16) + 0.5) / 16:
        far, near = 1.0 + share, np.array([share, 1.0 - share])
        weights = 1.25 * near**3 - 2.25 * near**2 + 1.0
        first = -0.75 * (far**3 - 5.0 * far**2 + 8.0 * far - 4.0)
        variances.append(np.sum(np.convolve(kernel, [first, *weights, 1.0 - first - weights.sum()]) ** 2))
    return float(np.mean(variances))


# --------------------------------------------------------------------------------------------------------------
# Information


def information(scene: Scene, lens: Lens, view: View, hidden: Mask, stride: int = STRIDE) -> Array:
    """Fisher information (3, 3) of pan (rad), log focal and the log of the gain in a frame taken with ``view``.

    ``lens`` says how the lens changes with the zoom, ``hidden`` (H, W) where the athlete stands before the hall. Every
    ``stride``-th pixel and row are looked at, for all.
    """
    panorama, sensor = scene.panorama, scene.sensor
    field = _field(panorama, lens, view, stride)
    columns, rows = np.ascontiguousarray(field[..., 0]), np.ascontiguousarray(field[..., 1])
    border = cv2.BORDER_WRAP if panorama.full_turn else cv2.BORDER_CONSTANT
    known = cv2.remap(scene.known, columns, rows, cv2.INTER_NEAREST, borderMode=border)
    around = np.ones((2 * AROUND_PX + 1, 2 * AROUND_PX + 1), np.uint8)
    body = cv2.dilate(hidden.view(np.uint8), around)[::stride, ::stride]
    # BORDER_WRAP wraps rows as well, and a cylinder does not
    seen = (known > 0) & (body == 0) & (rows >= 0) & (rows <= panorama.image.shape[0] - 1)
    sampled = cv2.remap(scene.layers, columns, rows, cv2.INTER_CUBIC, borderMode=border)[seen]
    light = _vignette(sensor, lens, view, stride)[seen]
    by_zoom = field[..., 2:][seen]

    by_pan = -panorama.px_per_rad  # a pan moves every ray along its row by the same
    signal = np.stack([by_pan * sampled[:, 1], np.sum(sampled[:, 1:3] * by_zoom, axis=1), sampled[:, 0]]) * light
    variance = sensor.variance(sampled[:, 3] * light)
    found = (signal / variance) @ signal.T
    # what the panorama's noise has added to the squared derivatives
    noise = scene.noise_gain * (variance / scene.averaged + ROUNDING) * light**2 / variance
    found[0, 0] -= noise.sum() * by_pan**2
    found[0, 1] -= float(noise @ by_zoom[:, 0]) * by_pan
    found[1, 1] -= float(noise @ np.sum(by_zoom**2, axis=1))
    found[1, 0] = found[0, 1]
    return np.asarray(found * stride**2, np.float64)


def least_covariance(found: Array) -> Array | None:
    """The bound (2, 2) for pan and log focal, the gain being estimated along; None where they cannot be told.

    ``found`` (3, 3) as from `information`: the gain is eliminated by its Schur complement.
    """
    if found[2, 2] <= 0.0:
        return None
    both = found[:2, :2] - np.outer(found[:2, 2], found[2, :2]) / found[2, 2]
    if both[0, 0] <= 0.0 or np.linalg.det(both) <= 1e-9 * both[0, 0] * both[1, 1]:
        return None
    return np.asarray(np.linalg.inv(both), np.float64)


def _field(panorama: Panorama, lens: Lens, view: View, stride: int) -> Layer:
    """(H, W, 4): column and row on the panorama that these pixels see, and their derivatives by log focal.

    The few millimetres of the projection centre beside the pan axis are left out: they move the hall by a pixel or
    less, and what counts here is how much texture there is.
    """
    u, v = np.meshgrid(np.arange(0, lens.width + GRID, GRID), np.arange(0, lens.height + GRID, GRID))
    pixels = np.stack([u, v], axis=-1).astype(np.float64)
    azimuth, slope = geometry.pixel_to_direction(view, pixels)
    flat = azimuth.ravel(), slope.ravel()
    by_parameter = geometry.pan_zoom_derivatives(PanZoomCamera(lens, np.eye(4), 0.0, 0.0), view, *flat)
    by_direction = geometry.derivatives(view, *flat)[1]
    # the pixel stays: what the zoom moves away, another direction brings
    moved = -np.linalg.solve(by_direction, by_parameter[:, :, 1:2])[..., 0].reshape(*azimuth.shape, 2)
    azimuth = azimuth + cylinder.whole_turns(panorama, view.pan_rad)
    coarse = np.concatenate([cylinder.to_unwrapped(panorama, azimuth, slope), -panorama.px_per_rad * moved], axis=-1)
    scale = np.array([[stride / GRID, 0.0, 0.0], [0.0, stride / GRID, 0.0]])
    size = -(-lens.width // stride), -(-lens.height // stride)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(coarse.astype(np.float32), scale, size, flags=flags))


def _vignette(sensor: Sensor, lens: Lens, view: View, stride: int) -> Layer:
    """(H, W) brightness of these pixels, 1 at the principal point."""
    u = np.arange(0, lens.width, stride) - view.principal_px[0]
    v = np.arange(0, lens.height, stride) - view.principal_px[1]
    corner = (lens.width**2 + lens.height**2) / 4.0
    return (1.0 - (1.0 - sensor.vignetting) * (u**2 + v[:, None] ** 2) / corner).astype(np.float32)
