"""Images between their pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pzcap.imaging.bspline import (
    SMOOTHING,
    STEPS,
    at_pixels,
    cubic,
    resampled,
    softened,
    softened_further,
    stored,
    warped,
)
from pzcap.types import Array


def test_the_slope_of_the_spline_is_its_derivative() -> None:
    rng = np.random.default_rng(0)
    image = np.asarray(rng.integers(0, 16000, (12, 14)), np.uint16)
    for x, y in rng.uniform(2, 9, (20, 2)):
        inside, _, by_x, by_y = cubic(image, x, y)
        assert inside
        for slope, dx, dy in ((by_x, 1e-6, 0.0), (by_y, 0.0, 1e-6)):
            ahead, behind = cubic(image, x + dx, y + dy)[1], cubic(image, x - dx, y - dy)[1]
            assert slope == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=1e-2)
    assert not cubic(image, 0.5, 5.0)[0]


def test_what_is_stored_and_what_is_softened_is_smoothed_alike() -> None:
    """A parabola is lifted by half its curvature times the variance of what smooths it, everywhere."""
    v, u = np.mgrid[:30, :40].astype(float)
    image = np.asarray(100 + 2.0 * u + 0.05 * v**2, np.float32)
    smoothed = 0.05 * SMOOTHING
    kept = stored(image)
    for x, y in np.random.default_rng(1).uniform(8, 20, (30, 2)):
        _, value, by_x, by_y = cubic(kept, x, y)
        assert value == pytest.approx(100 + 2.0 * x + 0.05 * y**2 + smoothed, abs=0.03)
        assert (by_x, by_y) == (pytest.approx(2.0, abs=0.04), pytest.approx(0.1 * y, abs=0.04))
    np.testing.assert_allclose(softened(image)[8:-8, 8:-8], (image + smoothed)[8:-8, 8:-8], atol=1e-3)


def test_waves_stand_where_they_stood_between_pixels_too() -> None:
    """To a hundredth of their height, even if they are only five pixels long; Keys' cubic leaves five times that."""
    wave = 2 * np.pi / 5
    image = stored(np.tile(128 + 100 * np.sin(wave * np.arange(60)), (12, 1)).astype(np.float32))
    places = np.linspace(20, 40, 401)
    values = np.array([cubic(image, x, 6.0)[1] for x in places])
    system = np.stack([np.sin(wave * places), np.cos(wave * places), np.ones_like(places)], axis=1)
    (height, aside, _), *_ = np.linalg.lstsq(system, values, rcond=None)
    assert aside == pytest.approx(0.0, abs=1e-3 * height)
    assert np.abs(values - system @ (height, aside, 128.0)).max() < 0.01 * height


def test_an_image_is_warped_by_the_spline_that_runs_through_it() -> None:
    """At its pixels it stays as it was, and between them a cubic surface is one: nothing is moved by a hundredth."""
    v, u = np.mgrid[:40, :50].astype(np.float32)
    noise = np.random.default_rng(0).uniform(0, 255, (40, 50, 3)).astype(np.float32)
    inner = np.s_[12:-12, 12:-12]
    np.testing.assert_allclose(warped(noise, u, v)[inner], noise[inner], atol=0.01)
    surface = np.stack([u, v, 0.01 * (u - 25) ** 2 - 0.001 * (v - 20) ** 3], axis=-1)
    x, y = np.random.default_rng(1).uniform((14, 14), (35, 25), (60, 2)).astype(np.float32).T[:, None]
    expected = np.stack([x, y, 0.01 * (x - 25) ** 2 - 0.001 * (y - 20) ** 3], axis=-1)
    np.testing.assert_allclose(warped(surface, x, y), expected, atol=1e-3)


@pytest.mark.parametrize("stretch", [0.003, -0.003])
def test_a_resampled_image_is_stretched_by_so_much_and_no_more(stretch: float) -> None:
    """To a hundred-thousandth; OpenCV's bicubic interpolation stretches it by a tenth more."""
    middle = 160.0

    def waves(x: Array, y: Array) -> Array:
        return np.asarray(128.0 + 60.0 * np.sin(x / 3.1) + 50.0 * np.sin(y / 2.7 + x / 9.0))

    v, u = np.mgrid[:320, :320].astype(float)
    x, y = middle + (1.0 + stretch) * (u - middle), middle + (1.0 + stretch) * (v - middle)
    image = np.repeat(np.rint(waves(u, v)).astype(np.uint8)[..., None], 3, axis=2)
    inner = np.s_[8:-8, 8:-8]
    across, down = (waves(x + dx, y + dy) - waves(x - dx, y - dy) for dx, dy in ((0.01, 0.0), (0.0, 0.01)))
    along = ((u - middle) * across + (v - middle) * down)[inner] / 0.02
    off = (resampled(image, x.astype(np.float32), y.astype(np.float32))[..., 1] - waves(x, y))[inner]
    assert np.vdot(along, off) / np.vdot(along, along) == pytest.approx(0.0, abs=1e-5)


def test_at_pixels_is_the_spline_there() -> None:
    image = np.asarray(np.random.default_rng(2).integers(0, 16000, (12, 14)), np.uint16)
    pixels = np.array([[5, 6], [3, 2]])
    np.testing.assert_allclose(at_pixels(image, pixels), [cubic(image, 5.0, 6.0)[1], cubic(image, 3.0, 2.0)[1]])


@pytest.mark.parametrize("shrink", [0.7, 1.3, 2.0, 3.1])
def test_smoothing_is_that_of_a_smaller_image_and_moves_nothing(shrink: float) -> None:
    """An image of waves, smoothed for a size, and smoothed after it was made that small: as strong, and in place."""
    u = np.arange(1200)
    waves = np.tile(128 + 60 * np.sin(2 * np.pi * u / (12 * shrink) + 0.4), (60, 1)).astype(np.float32)
    fine = softened(waves, shrink)
    if shrink > 1:
        np.testing.assert_allclose(softened_further(stored(waves), shrink)[:, 60:-60], fine[:, 60:-60], atol=2 / STEPS)
    span, phase = _wave(fine[30], 12 * shrink)
    assert phase == pytest.approx(0.4, abs=1e-3)
    if shrink > 1:
        small = softened(cv2.resize(waves, (round(1200 / shrink), round(60 / shrink)), interpolation=cv2.INTER_AREA))
        small_span, _ = _wave(small[8], 12 * shrink * small.shape[1] / 1200)
        assert span == pytest.approx(small_span, rel=0.02)


@pytest.mark.parametrize("shrink", [1.0, 1.4])
def test_a_place_is_as_smooth_at_the_side_of_a_frame_as_in_its_middle(shrink: float) -> None:
    """Waves around the cylinder, photographed by square pixels."""
    focal, middle, width, rays = 600.0 * shrink, 319.5, 640, 16
    places = (np.arange(width * rays) + 0.5) / rays - 0.5
    azimuth = np.arctan((places - middle) / focal)
    waves = (128 + 60 * np.sin(600.0 * 2 * np.pi / 9 * azimuth)).reshape(width, rays).mean(axis=1)
    image = np.tile(waves, (20, 1)).astype(np.float32)

    def strength(flat: tuple[float, float] | None, columns: slice) -> float:
        pixels = np.array([(u, 10) for u in range(width)[columns]], np.int16)
        row = softened(image, shrink, flat)[10, columns] if shrink > 1 else at_pixels(stored(image, flat), pixels)
        here = np.arctan((np.arange(width)[columns] - middle) / focal) * 600.0 * 2 * np.pi / 9
        system = np.stack([np.sin(here), np.cos(here), np.ones_like(here)], axis=1)
        return float(np.hypot(*np.linalg.lstsq(system, row.astype(float), rcond=None)[0][:2]))

    side, inner = np.s_[570:630], np.s_[290:350]
    evenly = strength((focal, middle), side) / strength((focal, middle), inner)
    unevenly = strength(None, side) / strength(None, inner)
    assert abs(evenly - 1.0) < 0.01
    assert unevenly > 1.02


def _wave(row: np.ndarray, length: float) -> tuple[float, float]:
    """Amplitude and phase of a wave of known length."""
    inner = np.arange(len(row))[40:-40]
    waves = np.stack([np.sin(2 * np.pi * inner / length), np.cos(2 * np.pi * inner / length), np.ones(len(inner))], 1)
    a, b, _ = np.linalg.lstsq(waves, row[40:-40].astype(float), rcond=None)[0]
    return float(np.hypot(a, b)), float(np.arctan2(b, a))
