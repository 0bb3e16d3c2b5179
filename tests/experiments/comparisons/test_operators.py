"""Ways of filming, compared on a small shoot."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra.core.global_hydra import GlobalHydra

from experiments import compare, footage
from experiments.comparisons import operators
from experiments.config import AppConfig
from experiments.metrics import read_metrics
from tests.scenes.captures import CAPTURES

pytestmark = pytest.mark.xdist_group("experiments")


def overrides(values: dict[str, Any], prefix: str) -> list[str]:
    """``values`` as a command's arguments."""
    found = []
    for key, value in values.items():
        name = f"{prefix}.{key}"
        found += overrides(value, name) if isinstance(value, dict) else [f"{name}={str(value).replace(' ', '')}"]
    return found


@pytest.mark.slow
@pytest.mark.heavy
def test_the_command_films_each_way_and_compares_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two ways of the three: each needs a calibration of its own."""
    GlobalHydra.instance().clear()
    monkeypatch.setattr(operators, "NAMES", {"pan_zoom": "pan and zoom", "none": "locked"})
    small = [o for o in overrides(asdict(footage.SMALL), "shoot") if not o.startswith("shoot.operator.moves=")]
    outputs = [f"hydra.run.dir={tmp_path}", f"output.captures={CAPTURES}", "output.recording=false"]
    monkeypatch.setattr("sys.argv", ["compare", "operators", *small, *outputs])
    assert compare.main() == 0
    found = {metric.key: metric.value for metric in read_metrics(tmp_path / "metrics.json")[0]}
    assert len(found) == 2 * len(operators.COLUMNS)
    assert all(value is not None for value in found.values())
    heights = [found[f"operators.{moves}.body.height"] or 0.0 for moves in operators.NAMES]
    assert heights[0] >= 0.97 * heights[1] > 0.0
    for moves in operators.NAMES:
        told = read_metrics(tmp_path / moves / "metrics.json")[1]["config"]
        assert told["shoot"]["operator"]["moves"] == moves
    assert (tmp_path / "operators.png").stat().st_size > 10000
    out = capsys.readouterr().out
    assert all(name in out for name in operators.NAMES.values())


def test_cameras_are_calibrated_once_but_an_estimator_finds_its_own(tmp_path: Path) -> None:
    assert operators.with_cameras(AppConfig(), tmp_path).cameras == str(tmp_path)
    assert operators.with_cameras(AppConfig(estimator="my_lab:track"), tmp_path).cameras is None


def test_the_framing_tells_a_whole_body_from_one_that_is_cut_off(small_capture: Path) -> None:
    truth = footage.truth_beside(small_capture / "capture")
    assert truth is not None
    height_px, cut = operators.framing(truth)
    assert height_px.shape == cut.shape == truth.recorded.shape
    for camera, frame in ((0, 0), (2, 5)):
        places = np.argwhere(truth.mask(camera, frame))
        assert height_px[camera, frame] == np.ptp(places[:, 0]) + 1
        inside = np.all(places.min(axis=0) > 0) and np.all(places.max(axis=0) < [truth.height - 1, truth.width - 1])
        assert cut[camera, frame] != inside


def test_other_footage_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    GlobalHydra.instance().clear()
    monkeypatch.setattr("sys.argv", ["compare", "operators", "capture=somewhere", f"hydra.run.dir={tmp_path}"])
    assert compare.main() == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "shoots its own footage" in err
