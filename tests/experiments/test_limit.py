"""How near the method comes to what is possible at all, where nothing else is wrong.

A camera without any trouble looks at a cylinder of texture, and what renders it works in double precision, sixty-four
rays a pixel. The sweep's pans are known. So what is more than noise here is wrong with how frames are stitched and
aligned, by a thousandth of a pixel as well.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import cv2
import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from experiments.bound import Sensor, blur_level, build_scene, information, least_covariance
from pzcap.calibration import stitching
from pzcap.geometry.camera import View, wrapped
from pzcap.geometry.lens import NONE
from pzcap.imaging.colour import grey
from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.localisation.photometric_alignment import Aligner
from pzcap.types import FAR_AWAY, Array, Image, Lens, Panorama, PanZoomCamera
from tests.scenes import synthetic

WIDTH, HEIGHT, FOCAL = 640, 480, 880.0
MIDDLE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
LENS = Lens(WIDTH, HEIGHT, FOCAL, MIDDLE[None], np.zeros(1))
CAMERA = PanZoomCamera(LENS, np.eye(4), 0.0, 0.0)
NOISE = 2.0  # grey levels
RAYS = 8  # across a pixel
SWEPT = np.deg2rad(np.arange(-64.0, 64.1, 2.0))


@cache
def hall() -> NDArray[np.float32]:
    return cv2.cvtColor(synthetic.hall(0), cv2.COLOR_BGR2GRAY).astype(np.float32)


def photograph(pan_rad: float, focal_px: float, seed: int) -> Image:
    """(H, W, 3) a frame of the hall."""
    level = np.zeros((HEIGHT, WIDTH))
    _look(hall(), pan_rad, focal_px, level)
    noise = np.random.default_rng(seed).normal(0.0, NOISE, (HEIGHT, WIDTH, 3))
    return np.clip(np.rint(level[..., None] + noise), 0, 255).astype(np.uint8)


@njit(cache=True, nogil=True)
def _look(texture: Array, pan_rad: float, focal_px: float, level: Array) -> None:
    height, width = level.shape
    per_rad = texture.shape[1] / (2 * np.pi)
    for j in range(width):
        for a in range(RAYS):
            x = (j + (a + 0.5) / RAYS - 0.5 - (width - 1) / 2) / focal_px
            column = (np.pi - pan_rad + np.arctan(x)) * per_rad - 0.5
            m = int(column)
            c = column - m
            slope_px = per_rad / (focal_px * np.sqrt(1.0 + x * x))
            for i in range(height):
                for b in range(RAYS):
                    y_px = i + (b + 0.5) / RAYS - 0.5 - (height - 1) / 2
                    row = synthetic.SLOPES * per_rad + y_px * slope_px - 0.5
                    n = int(row)
                    upper = (1 - c) * texture[n, m] + c * texture[n, m + 1]
                    lower = (1 - c) * texture[n + 1, m] + c * texture[n + 1, m + 1]
                    level[i, j] += ((1 - row + n) * upper + (row - n) * lower) / RAYS**2


@pytest.fixture(scope="module")
def background() -> Panorama:
    """Stitched from a sweep whose pans are known."""
    with ThreadPoolExecutor(2) as pool:
        sweep = list(pool.map(lambda k: photograph(SWEPT[k], FOCAL, k), range(len(SWEPT))))
    even = stitching.Brightness(np.zeros(len(SWEPT)), np.zeros(2))
    return stitching.stitch(
        list(enumerate(sweep)),
        stitching.SweptFrames(
            [grey(i) for i in sweep], np.arange(len(SWEPT)), even, View(0.0, 0.0, 0.0, FOCAL, MIDDLE, NONE)
        ), SWEPT, False, FAR_AWAY, lambda _: None,
    )  # fmt: skip


@pytest.mark.slow
def test_pan_and_focal_length_come_within_twice_their_bounds(background: Panorama) -> None:
    rng = np.random.default_rng(5)
    aligner, sensor = Aligner(background, CAMERA, pixels=WIDTH * HEIGHT), Sensor(NOISE, 0.0, 1.0)

    def one(frame: tuple[int, float, float]) -> tuple[Array, Array]:
        seed, pan, focal = frame
        found = aligner.align(photograph(pan, focal, seed), ViewPlace(pan + 5e-5, 0.0, focal * 1.0002), 1.5)
        scene = build_scene(background, sensor, blur_level(background, focal), WIDTH)
        view = View(pan, 0.0, 0.0, focal, MIDDLE, NONE)
        bound = least_covariance(information(scene, LENS, view, np.zeros((HEIGHT, WIDTH), bool)))
        assert bound is not None
        return np.array([wrapped(found.at.pan_rad - pan), np.log(found.at.focal_px / focal)]), np.sqrt(np.diag(bound))

    frames = [(1000 + k, rng.uniform(-0.5, 0.5), FOCAL * np.exp(rng.uniform(0.0, 1.0))) for k in range(24)]
    with ThreadPoolExecutor(2) as pool:
        errors, bounds = (np.array(each) for each in zip(*pool.map(one, frames), strict=True))
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.mean(bounds**2, axis=0))
    assert (ratio < 2.0).all(), ratio
    assert np.abs(errors.mean(axis=0) / bounds.mean(axis=0)).max() < 1.0  # and err to either side
