"""A hall of upright bars with sharp edges, and exact pictures of it: aliasing is their only error.

Bars stand upright in the picture as well, so that the error is the same in all rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import stitching
from pzcap.geometry.camera import View
from pzcap.geometry.lens import NONE
from pzcap.types import FAR_AWAY, Array, Image, Lens, Panorama, PanZoomCamera

WIDTH, HEIGHT, FOCAL = 320, 32, 440.0
MIDDLE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
LENS = Lens(WIDTH, HEIGHT, FOCAL, MIDDLE[None], np.zeros(1))
CAMERA = PanZoomCamera(LENS, np.eye(4), 0.0, 0.0)
STEP = np.deg2rad(2.0)
NOISE = 1.3  # grey levels


def photograph(pan_rad: float, focal_px: float = FOCAL) -> Image:
    """(H, W) what a frame shows: the mean of the bars over each pixel, and noise."""
    rng = np.random.default_rng(3)
    edges = np.concatenate([[-np.pi], np.sort(rng.uniform(-np.pi, np.pi, 900)), [np.pi]])
    sums = np.concatenate([[0.0], np.cumsum(rng.uniform(40.0, 220.0, 901) * np.diff(edges))])
    azimuth = pan_rad - np.arctan((np.arange(WIDTH + 1) - 0.5 - MIDDLE[0]) / focal_px)
    turns = np.floor((azimuth + np.pi) / (2 * np.pi))
    below = np.interp(azimuth - 2 * np.pi * turns, edges, sums) + turns * sums[-1]
    shown = np.tile(np.diff(below) / np.diff(azimuth), (HEIGHT, 1))
    noise = np.random.default_rng(round(1e6 * (pan_rad + 4.0))).normal(0.0, NOISE, shown.shape)
    return np.rint(shown + noise).astype(np.uint8)


def stitched(pans_rad: Array, full_turn: bool) -> Panorama:
    frames = [photograph(pan) for pan in pans_rad]
    even = stitching.Brightness(np.zeros(len(pans_rad)), np.zeros(2))
    return stitching.stitch(
        [(k, np.dstack([image] * 3)) for k, image in enumerate(frames)],
        stitching.SweptFrames(frames, np.arange(len(pans_rad)), even, View(0.0, 0.0, 0.0, FOCAL, MIDDLE, NONE)),
        pans_rad, full_turn, FAR_AWAY, lambda _: None,
    )  # fmt: skip


def level(image: Image) -> NDArray[np.float32]:
    return image.astype(np.float32)


def swept(first_deg: float, last_deg: float) -> Array:
    """Pans of a sweep by hand: its steps are not all the same number of pixels."""
    steps = STEP * (1.0 + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, round((last_deg - first_deg) / 2.0)))
    return np.deg2rad(first_deg) + np.concatenate([[0.0], np.cumsum(steps)])
