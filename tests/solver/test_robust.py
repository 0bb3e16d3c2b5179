"""What most values are like, among others that are far off."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pzcap.solver.robust import (
    geman_mcclure,
    half_sample_mode,
    line,
    median,
    median_absolute,
    normal_sigma,
    planar_sigma,
)


@settings(max_examples=30)
@given(st.floats(0.3, 3.0), st.floats(0.0, 0.5), st.floats(0.05, 20.0), st.integers(0, 9))
def test_the_commonest_ratio_is_what_most_pixels_have(gain: float, share: float, other: float, seed: int) -> None:
    assume(abs(np.log(other / gain)) > 0.4)
    rng = np.random.default_rng(seed)
    values = gain * (1.0 + 0.03 * rng.normal(size=1200))
    spread = rng.random(1200) < share
    values[spread] = other * rng.uniform(0.8, 1.2, spread.sum())
    assert half_sample_mode(values) == pytest.approx(gain, rel=0.06)


@settings(max_examples=30, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-0.5, 0.5), st.floats(0.0, 0.35), st.integers(0, 9))
def test_the_line_is_that_of_most_values(a: float, b: float, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = rng.uniform(0.0, 1.0, 800)
    values = a + b * at + 0.01 * rng.normal(size=800)
    off = rng.random(800) < share
    values[off] += rng.uniform(1.0, 2.0, off.sum())
    found = line(values, at, np.ones(800), (0.5, 0.2, 0.1, 0.05), (a + 0.2, 0.0))
    np.testing.assert_allclose(found, (a, b), atol=0.02)


def test_medians_are_of_what_is_there() -> None:
    values = np.random.default_rng(0).normal(0.0, 2.0, 4001)
    assert median(values) == np.median(values)
    assert median_absolute(values) == pytest.approx(0.6745 * 2.0, rel=0.1)


@settings(deadline=None)
@given(st.floats(-50.0, 50.0), st.floats(0.1, 20.0))
def test_the_weight_is_the_slope_of_its_loss_over_the_residual(residual: float, scale: float) -> None:
    assume(abs(residual) > 1e-2)

    def loss(r: float) -> float:
        return 0.5 * scale**2 * r**2 / (scale**2 + r**2)

    slope = (loss(residual + 1e-5) - loss(residual - 1e-5)) / 2e-5
    assert geman_mcclure(residual, scale) == pytest.approx(slope / residual, rel=1e-3, abs=1e-6)
    np.testing.assert_array_equal(geman_mcclure(np.full(3, residual), scale), geman_mcclure(residual, scale))


def test_the_sigma_of_normal_residuals_ignores_a_few_outliers() -> None:
    values = np.random.default_rng(0).normal(0.0, 2.0, 4001)
    values[:40] = 1e6
    assert normal_sigma(values) == pytest.approx(2.0, rel=0.06)
    assert planar_sigma(np.hypot(values[:-1:2], values[1::2])) == pytest.approx(2.0, rel=0.06)
