"""Forecasts of a check beside what is reached: which footage, with which settings, and the figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra.core.global_hydra import GlobalHydra

from experiments import compare
from experiments.comparisons import forecast
from experiments.comparisons.harness import Row
from experiments.config import AppConfig
from experiments.metrics import read_metrics
from experiments.run import CONF
from pzcap.command.check.forecast import CameraForecast, Forecast

pytestmark = pytest.mark.xdist_group("experiments")


def test_each_experiment_is_composed_with_what_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    GlobalHydra.instance().clear()
    asked: dict[str, AppConfig] = {}

    def judge(name: str, config: AppConfig, folder: Path, _: Any) -> Row[Any]:
        asked[name] = config
        assert folder == tmp_path / name
        return Row(name, name, {"pan.ratio": 1.25, "again": 0.0})

    monkeypatch.setattr(forecast, "judge", judge)
    given = ["experiments=[own_clocks,partial_sweep]", "seed=3", "shoot.width=320", f"hydra.run.dir={tmp_path}"]
    monkeypatch.setattr("sys.argv", ["compare", "forecast", *given])
    assert compare.main() == 0
    assert [config.shoot.seed for config in asked.values()] == [3, 3]
    assert [config.shoot.width for config in asked.values()] == [320, 320]
    assert asked["own_clocks"].shoot.sensor.clock_offset == 0.5
    assert asked["own_clocks"].shoot.sweep_deg == 360.0
    assert asked["partial_sweep"].shoot.sweep_deg == 120.0
    assert asked["partial_sweep"].shoot.sensor.clock_offset == 0.0
    found = {metric.key: metric.value for metric in read_metrics(tmp_path / "metrics.json")[0]}
    assert found["forecast.own_clocks.pan.ratio"] == 1.25
    assert "partial_sweep" in capsys.readouterr().out


def test_a_capture_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    GlobalHydra.instance().clear()
    monkeypatch.setattr("sys.argv", ["compare", "forecast", "capture=somewhere", f"hydra.run.dir={tmp_path}"])
    assert compare.main() == 1
    assert "shoots its own footage" in capsys.readouterr().err


def test_all_experiments_are_there() -> None:
    assert len(set(forecast.EXPERIMENTS)) == len(forecast.EXPERIMENTS) >= 20
    assert all((CONF / "experiment" / f"{name}.yaml").is_file() for name in forecast.EXPERIMENTS)


def test_figures_are_those_of_all_cameras_together() -> None:
    cameras = {str(k): CameraForecast(np.deg2rad(pan), 0.0004, 0.01, ()) for k, pan in enumerate((0.003, 0.004))}
    figures = forecast.compared(
        Forecast(cameras, 1.0), {"panzoom.pan.rms": 0.005, "panzoom.focal.rms": 0.02, "body.mpjpe.mean": None}
    )
    assert figures["pan.forecast"] == pytest.approx(np.sqrt(12.5) / 1000.0)
    assert figures["pan.ratio"] == pytest.approx(np.sqrt(12.5) / 5.0)
    assert figures["focal.ratio"] == pytest.approx(2.0)
    assert figures["joints.reached"] is figures["joints.ratio"] is None
    assert (figures["joints.forecast"] or 0.0) > 2.5
    assert forecast.compared(Forecast({}, None), {})["joints.forecast"] is None
