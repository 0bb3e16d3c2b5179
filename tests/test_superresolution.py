"""A hall of upright bars with sharp edges, and pictures of it that are exact: what pixels are too coarse for is all
that is wrong. Bars stand upright in the picture as well, so that it is wrong in all rows alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pzcap.cameras import panorama, sampling
from pzcap.cameras.align import Aligner
from pzcap.cameras.camera import View
from pzcap.cameras.superresolution import ACROSS, DOWN, super_resolve
from pzcap.types import FAR_AWAY, Array, Image, Lens, Panorama, PanZoomCamera

WIDTH, HEIGHT, FOCAL = 320, 64, 440.0
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
    even = panorama.Brightness(np.zeros(len(pans_rad)), np.zeros(2))
    return panorama.stitch(
        [(k, np.dstack([image] * 3)) for k, image in enumerate(frames)], np.arange(len(pans_rad)), frames, pans_rad,
        View(0.0, 0.0, 0.0, FOCAL, MIDDLE, 0.0), full_turn, even, FAR_AWAY, lambda _: None,
    )  # fmt: skip


def level(image: Image) -> NDArray[np.float32]:
    return image.astype(np.float32)


def finer(background: Panorama, frames: list[Image]) -> Panorama:
    told: list[tuple[int, int]] = []
    fine = super_resolve(background, CAMERA, lambda k: level(frames[k]), lambda done, total: told.append((done, total)))
    assert told[-1][0] == told[-1][1] == len(told)
    assert fine.shape == (background.image.shape[0] * DOWN, background.image.shape[1] * ACROSS)
    return replace(background, fine=fine)


def swept(first_deg: float, last_deg: float) -> Array:
    """Pans of a sweep by hand: its steps are not all the same number of pixels."""
    steps = STEP * (1.0 + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, round((last_deg - first_deg) / 2.0)))
    return np.deg2rad(first_deg) + np.concatenate([[0.0], np.cumsum(steps)])


@pytest.fixture(scope="module")
def some() -> Panorama:
    """Part of the hall."""
    pans = swept(-44.0, 44.0)
    return finer(stitched(pans, False), [photograph(pan) for pan in pans])


def errors(background: Panorama, pans_rad: Array, zoom: float) -> Array:
    """(N, 2) of pan, in pixels of the frame, and of log focal, in pixels at its edges."""
    aligner, focal = Aligner(background, CAMERA, pixels=WIDTH * HEIGHT), FOCAL * zoom
    found = [aligner.align(photograph(pan, focal), pan + 1e-4, 0.0, focal * 1.0003, 1.5) for pan in pans_rad.tolist()]
    assert all(one.settled for one in found)
    return np.array([
        [(one.pan_rad - pan) * focal, np.log(one.focal_px / focal) * WIDTH / 2]
        for one, pan in zip(found, pans_rad, strict=True)
    ])  # fmt: skip


def test_what_is_finer_than_pixels_no_longer_moves_a_frame(some: Panorama) -> None:
    pans = np.random.default_rng(8).uniform(-0.35, 0.35, 30)
    without = np.sqrt(np.mean(errors(replace(some, fine=some.fine[:0, :0]), pans, 1.0) ** 2, axis=0))
    exact = np.sqrt(np.mean(errors(some, pans, 1.0) ** 2, axis=0))
    assert (exact < 0.5 * without).all(), (exact, without)
    assert exact[0] < 0.005


def test_frames_that_are_finer_are_predicted_too(some: Panorama) -> None:
    """What the sweep's pixels let through between them tells what smaller squares show."""
    pans = np.random.default_rng(9).uniform(-0.35, 0.35, 30)
    without = np.sqrt(np.mean(errors(replace(some, fine=some.fine[:0, :0]), pans, 2.0) ** 2, axis=0))
    exact = np.sqrt(np.mean(errors(some, pans, 2.0) ** 2, axis=0))
    assert (exact < 0.75 * without).all(), (exact, without)


def test_a_frame_is_predicted_pixel_by_pixel(some: Panorama) -> None:
    pan = np.deg2rad(3.3)
    columns = some.origin_px[0] - (pan - np.arctan((np.arange(WIDTH) - MIDDLE[0]) / FOCAL)) * some.px_per_rad
    row = some.fine.shape[0] / 2
    halves = 0.5 * ACROSS / (1.0 + ((np.arange(WIDTH) - MIDDLE[0]) / FOCAL) ** 2)
    places = zip(((columns + 0.5) * ACROSS).tolist(), halves.tolist(), strict=True)
    fine = [sampling.box(some.fine, column, row, half, 0.5 * DOWN)[1] for column, half in places]
    coarse = np.interp(columns, np.arange(some.image.shape[1]), some.image[some.image.shape[0] // 2, :, 0])
    frame = level(photograph(pan))[HEIGHT // 2]
    off, before = (float(np.sqrt(np.mean((one - frame)[20:-20] ** 2))) for one in (np.array(fine), coarse))
    assert off < 2.0  # grey levels
    assert before > 3.0 * off


def test_a_full_turn_has_no_seam() -> None:
    pans = swept(-184.0, 184.0)
    pans = pans * (np.deg2rad(368.0) / (pans[-1] - pans[0]))
    whole = finer(stitched(pans, True), [photograph(pan) for pan in pans])
    there = errors(whole, np.pi + np.linspace(-0.2, 0.2, 9), 1.0)
    assert np.sqrt(np.mean(((there[:, 0] + np.pi * FOCAL) % (2 * np.pi * FOCAL) - np.pi * FOCAL) ** 2)) < 0.005


def test_somebody_in_a_few_frames_leaves_no_trace(some: Panorama) -> None:
    pans = swept(-44.0, 44.0)
    frames = [photograph(pan) for pan in pans]
    for image in frames[20:23]:
        image[:, 100:180] = 250
    spoilt = finer(replace(some, fine=some.fine[:0, :0]), frames)
    inner = slice(12, -12)
    difference = np.abs(spoilt.fine.astype(np.float64) - some.fine)[inner] / sampling.STEPS
    assert np.percentile(difference, 99.9) < 10.0
    assert difference.mean() < 0.5  # a twentieth of 100 grey levels would be 5
