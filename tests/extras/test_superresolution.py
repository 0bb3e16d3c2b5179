"""The hall within the pixels of a sweep, as far as frames of it and closer ones show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.extras.superresolution import ACROSS, DOWN, super_resolve
from pzcap.extras.superresolved_alignment import SuperresolvedAligner, box
from pzcap.imaging import bspline
from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.types import Array, Image, Panorama
from tests.scenes.upright_bars import CAMERA, FOCAL, HEIGHT, MIDDLE, WIDTH, level, photograph, stitched, swept


def finer(background: Panorama, frames: list[Image]) -> Panorama:
    told: list[tuple[int, int]] = []
    fine = super_resolve(background, CAMERA, lambda k: level(frames[k]), lambda done, total: told.append((done, total)))
    assert told[-1][0] == told[-1][1] == len(told)
    assert fine.shape == (background.image.shape[0] * DOWN, background.image.shape[1] * ACROSS)
    return replace(background, fine=fine)


@pytest.fixture(scope="module")
def some() -> Panorama:
    """Part of the hall."""
    pans = swept(-44.0, 44.0)
    return finer(stitched(pans, False), [photograph(pan) for pan in pans])


def errors(background: Panorama, pans_rad: Array, zoom: float) -> Array:
    """(N, 2) of pan, in pixels of the frame, and of log focal, in pixels at its edges."""
    aligner, focal = SuperresolvedAligner(background, CAMERA, pixels=WIDTH * HEIGHT), FOCAL * zoom
    found = [
        aligner.align(photograph(pan, focal), ViewPlace(pan + 1e-4, 0.0, focal * 1.0003), 1.5)
        for pan in pans_rad.tolist()
    ]
    assert all(one.report.converged for one in found)
    return np.array([
        [(one.at.pan_rad - pan) * focal, np.log(one.at.focal_px / focal) * WIDTH / 2]
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
    fine = [box(some.fine, column, row, half, 0.5 * DOWN)[1] for column, half in places]
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
    difference = np.abs(spoilt.fine.astype(np.float64) - some.fine)[inner] / bspline.STEPS
    assert np.percentile(difference, 99.9) < 10.0
    assert difference.mean() < 0.5  # a twentieth of 100 grey levels would be 5
