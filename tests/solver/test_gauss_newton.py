"""Robust Gauss-Newton: against closed forms, with outliers, with a prior, and how it says that it ended."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.solver.gauss_newton import NormalEquations, Prior, Schedule, Solution, minimise
from pzcap.solver.robust import geman_mcclure, normal_sigma
from pzcap.types import Array, PzcapError

AT = np.linspace(-1.0, 1.0, 200)
DESIGN = np.stack([np.ones_like(AT), AT], axis=1)


def fit(
    values: Array, schedule: Schedule, prior: Prior[Array] | None = None, held: int | None = None
) -> Solution[Array]:
    def linearise(state: Array, scale: float) -> NormalEquations:
        residual = DESIGN @ state - values
        weighted = DESIGN * geman_mcclure(residual, scale)[:, None]
        cost = float(np.sum(geman_mcclure(residual, scale) * residual**2))
        return NormalEquations(weighted.T @ DESIGN, weighted.T @ residual, normal_sigma(residual), cost)

    def add(state: Array, step: Array) -> Array:
        return np.asarray(state + step)

    settled: Callable[[Array], bool] = lambda step: bool(np.abs(step).max() < 1e-9)  # noqa: E731
    return minimise(np.zeros(2), linearise, add, settled, schedule, prior=prior, held=held)


@settings(max_examples=20, deadline=None)
@given(st.floats(-2, 2), st.floats(-2, 2), st.integers(0, 99))
def test_outliers_do_not_pull(a: float, b: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = DESIGN @ (a, b) + 0.01 * rng.normal(size=len(AT))
    values[::4] += rng.uniform(5.0, 9.0, 50)
    found = fit(values, Schedule(60, 8.0, least_scale=0.05))
    np.testing.assert_allclose(found.state, (a, b), atol=0.03)
    assert found.report.converged
    assert found.report.steps < 60


def test_without_outliers_it_is_least_squares() -> None:
    values = DESIGN @ (0.3, -0.7) + 0.1 * np.random.default_rng(0).normal(size=len(AT))
    found = fit(values, Schedule(30, 1e9, least_scale=1e9))
    np.testing.assert_allclose(found.state, np.linalg.lstsq(DESIGN, values, rcond=None)[0], atol=1e-9)
    assert found.report.cost == pytest.approx(np.sum((DESIGN @ found.state - values) ** 2))


def test_a_prior_is_weighed_by_the_variance_of_the_residuals() -> None:
    values = DESIGN @ (0.3, -0.7) + 0.1 * np.random.default_rng(0).normal(size=len(AT))
    mean, information = np.array([0.0, 0.0]), np.diag([1e4, 1.0])
    found = fit(values, Schedule(30, 1e9, least_scale=1e9), Prior(information, lambda state: state - mean, 2.0))
    variance = 2.0 * found.sigma**2
    expected = np.linalg.solve(DESIGN.T @ DESIGN + variance * information, DESIGN.T @ values)
    np.testing.assert_allclose(found.state, expected, atol=1e-8)
    np.testing.assert_allclose(found.normal, DESIGN.T @ DESIGN + variance * information, rtol=1e-9)


def test_a_held_unknown_stays_and_steps_that_run_out_are_told() -> None:
    values = DESIGN @ (0.3, -0.7)
    found = fit(values, Schedule(30, 1e9, least_scale=1e9), held=1)
    assert found.state[1] == 0.0
    assert found.state[0] == pytest.approx(0.3)
    assert not fit(values, Schedule(1, 1e9)).report.converged
    assert fit(values, Schedule(30, 1e9, least_steps=7)).report.steps == 7


def test_what_nothing_was_measured_of_is_an_error() -> None:
    def linearise(*_: object) -> NormalEquations:
        return NormalEquations(np.diag([1.0, 0.0]), np.ones(2), 1.0, 0.0)

    with pytest.raises(PzcapError, match="leaves an unknown entirely open"):
        minimise(np.zeros(2), linearise, lambda state, step: state + step, lambda _: True, Schedule(3, 1.0))
