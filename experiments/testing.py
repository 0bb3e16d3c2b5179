"""Fixtures for tests of one's own estimator: ``pytest_plugins = ["experiments.testing"]``. See docs/estimators.md."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from experiments import footage
from experiments.config import AppConfig
from experiments.estimators import Estimator, evaluate
from pzcap.scoring.metric import Metric
from pzcap.types import PzcapError

ScoreEstimator = Callable[[Estimator], dict[str, Metric]]


@pytest.fixture(scope="session")
def pzcap_capture() -> Path:
    """The capture folder, with its truth beside it, that `score_estimator` uses. Define your own to use another."""
    return footage.shot(footage.SMALL, Path(AppConfig().output.captures)) / "capture"


@pytest.fixture
def score_estimator(pzcap_capture: Path) -> ScoreEstimator:
    """``score_estimator(function)["panzoom.pan.rms"].value``: every metric of docs/estimators.md by its key."""
    truth = footage.truth_beside(pzcap_capture)
    if truth is None:
        raise PzcapError(f"{pzcap_capture}: no truth beside it, nothing can be scored")

    def scored(estimator: Estimator) -> dict[str, Metric]:
        name = getattr(estimator, "__name__", type(estimator).__name__)
        return {metric.key: metric for metric in evaluate(estimator, pzcap_capture, truth, name)[1]}

    return scored
