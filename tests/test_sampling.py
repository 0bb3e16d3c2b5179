"""Images between their pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pzcap.sampling import STEPS, cubic, smoothed_further, softened, stored


def test_the_cubic_goes_through_the_pixels_and_its_slope_is_its_derivative() -> None:
    rng = np.random.default_rng(0)
    image = np.asarray(rng.integers(0, 16000, (12, 14)), np.uint16)
    assert cubic(image, 5.0, 6.0)[:2] == (True, pytest.approx(image[6, 5] / STEPS))
    for x, y in rng.uniform(2, 9, (20, 2)):
        inside, _, by_x, by_y = cubic(image, x, y)
        assert inside
        for slope, dx, dy in ((by_x, 1e-6, 0.0), (by_y, 0.0, 1e-6)):
            ahead, behind = cubic(image, x + dx, y + dy)[1], cubic(image, x - dx, y - dy)[1]
            assert slope == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=1e-2)
    assert not cubic(image, 0.5, 5.0)[0]


def test_the_cubic_follows_a_parabola() -> None:
    """What linear interpolation, and a cubic of another shape, do not."""
    v, u = np.mgrid[:20, :30].astype(float)
    image = np.asarray(np.rint((100 + 2.0 * u + 0.05 * v**2) * STEPS), np.uint16)
    for x, y in np.random.default_rng(1).uniform(2, 16, (30, 2)):
        _, value, by_x, by_y = cubic(image, x, y)
        assert value == pytest.approx(100 + 2.0 * x + 0.05 * y**2, abs=0.03)
        assert (by_x, by_y) == (pytest.approx(2.0, abs=0.04), pytest.approx(0.1 * y, abs=0.04))


@pytest.mark.parametrize("shrink", [1.3, 2.0, 3.1])
def test_smoothing_is_that_of_a_smaller_image_and_moves_nothing(shrink: float) -> None:
    """An image of waves, smoothed for a size, and smoothed after it was made that small: as strong, and in place."""
    u = np.arange(1200)
    waves = np.tile(128 + 60 * np.sin(2 * np.pi * u / (12 * shrink) + 0.4), (60, 1)).astype(np.float32)
    fine = softened(waves, shrink)
    further = smoothed_further(stored(waves), shrink) / STEPS
    np.testing.assert_allclose(further[:, 60:-60], fine[:, 60:-60], atol=0.2)
    small = softened(cv2.resize(waves, (round(1200 / shrink), round(60 / shrink)), interpolation=cv2.INTER_AREA))
    span, phase = _wave(fine[30], 12 * shrink)
    small_span, _ = _wave(small[8], 12 * shrink * small.shape[1] / 1200)
    assert span == pytest.approx(small_span, rel=0.02)
    assert phase == pytest.approx(0.4, abs=1e-3)


def _wave(row: np.ndarray, length: float) -> tuple[float, float]:
    """Amplitude and phase of a wave of known length."""
    inner = np.arange(len(row))[40:-40]
    waves = np.stack([np.sin(2 * np.pi * inner / length), np.cos(2 * np.pi * inner / length), np.ones(len(inner))], 1)
    a, b, _ = np.linalg.lstsq(waves, row[40:-40].astype(float), rcond=None)[0]
    return float(np.hypot(a, b)), float(np.arctan2(b, a))
