"""The command that compares the body with and without keypoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from experiments.comparisons import keypoints
from experiments.footage import SMALL
from sim.people.detector import DetectorConfig
from tests.scenes.captures import shot

pytestmark = pytest.mark.xdist_group("experiments")


def test_a_capture_without_keypoints_gets_one_line(
    small_capture: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["experiments.comparisons.keypoints", str(small_capture)])
    assert keypoints.main() == 1
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert "no camera has keypoints" in err
    assert err.count("\n") == 1


@pytest.mark.slow
def test_the_table_has_a_row_for_each_way(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    folder = shot(replace(SMALL, detector=DetectorConfig(enabled=True)))
    monkeypatch.setattr("sys.argv", ["experiments.comparisons.keypoints", str(folder)])
    monkeypatch.setenv("COLUMNS", "200")
    assert keypoints.main() == 0
    rows = {line.split("│")[1].strip(): line for line in capfd.readouterr().out.splitlines() if line.startswith("│")}
    means = {name: float(line.split("│")[2].split()[0]) for name, line in rows.items()}
    assert list(means) == ["without keypoints", "with keypoints", "keypoints alone"]
    assert means["with keypoints"] < 1.2 * means["without keypoints"]
    assert means["with keypoints"] < means["keypoints alone"] < 150.0
