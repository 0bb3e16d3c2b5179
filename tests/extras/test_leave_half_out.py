"""A sweep whose pans are a little off, as pairs of frames tell them: each by itself, and all together slowly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pzcap.extras import leave_half_out
from pzcap.types import Array
from tests.scenes.upright_bars import CAMERA, FOCAL, level, photograph, stitched, swept


def beside_px(pans_rad: Array, true_rad: Array) -> Array:
    """(K,) pixels of the sweep, their mean left out: what is counted from is found later."""
    apart = (pans_rad - true_rad) * FOCAL
    return np.asarray(apart - apart.mean())


def found_again(true_rad: Array, told_rad: Array, full_turn: bool, somebody_at: int | None = None) -> Array:
    images = [photograph(pan) for pan in true_rad.tolist()]
    told: list[tuple[str, int, int]] = []
    background = replace(stitched(true_rad, full_turn), sweep_pan_rad=told_rad)
    if somebody_at is not None:
        images[somebody_at] = np.full_like(images[somebody_at], 90)
    pans = leave_half_out.pans(background, CAMERA, images, lambda k: level(images[k]), lambda *one: told.append(one))
    assert {stage for stage, _, _ in told} == {"super-resolve half", "align sweep"}
    assert all(0 < done <= total for _, done, total in told)
    return pans


def test_slow_errors_of_a_full_turn_are_found_as_well_as_each_frame_s_own() -> None:
    circle = swept(-184.0, 176.0)
    circle *= np.deg2rad(358.0) / (circle[-1] - circle[0])
    rng = np.random.default_rng(4)
    own = rng.normal(0.0, 0.01, len(circle)) / FOCAL
    slow = (0.04 * np.cos(circle + 1.0) + 0.02 * np.sin(2.0 * circle)) / FOCAL
    pans = found_again(circle, circle + own + slow, True)
    before, after = beside_px(circle + own + slow, circle), beside_px(pans, circle)
    assert np.sqrt(np.mean(after**2)) < 0.2 * np.sqrt(np.mean(before**2))
    for times in (1, 2):
        wave = np.exp(1j * times * circle)
        assert abs(np.mean(after * wave)) < 0.15 * abs(np.mean(before * wave)), times


def test_an_arc_that_was_stretched_is_found_as_long_as_its_focal_length_says() -> None:
    true = swept(-44.0, 44.0)
    pans = found_again(true, true * (1.0 + 2e-4), False)
    stretch = np.polyfit(true, pans, 1)[0] - 1.0
    assert abs(stretch) < 4e-5


def test_a_frame_that_shows_nothing_of_the_hall_goes_where_its_neighbours_go() -> None:
    true = swept(-44.0, 44.0)
    pans = found_again(true, true, False, somebody_at=20)
    assert np.abs(beside_px(pans, true)).max() < 0.02
