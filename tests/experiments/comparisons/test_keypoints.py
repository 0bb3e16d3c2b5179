"""The command that compares the body with and without keypoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra

from experiments import compare
from experiments.footage import SMALL
from experiments.metrics import read_metrics
from sim.people.detector import DetectorConfig
from tests.scenes.captures import shot

pytestmark = pytest.mark.xdist_group("experiments")


def test_a_capture_without_keypoints_gets_one_line(
    small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    GlobalHydra.instance().clear()
    arguments = ["compare", "keypoints", f"capture={small_capture}", f"hydra.run.dir={tmp_path}"]
    monkeypatch.setattr("sys.argv", arguments)
    assert compare.main() == 1
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert "no camera has keypoints" in err
    assert err.count("\n") == 1


@pytest.mark.slow
def test_the_table_has_a_row_for_each_way(
    finished: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """With the cameras of the run without keypoints: a detector changes no footage."""
    GlobalHydra.instance().clear()
    folder = shot(replace(SMALL, detector=DetectorConfig(enabled=True)))
    given = f"capture={folder}", f"cameras={finished[0]}", f"hydra.run.dir={tmp_path}"
    monkeypatch.setattr("sys.argv", ["compare", "keypoints", *given])
    assert compare.main() == 0
    out = capfd.readouterr().out
    assert all(label in out for label in ("without keypoints", "with keypoints", "keypoints alone"))
    found = {metric.key: metric.value or 0.0 for metric in read_metrics(tmp_path / "metrics.json")[0]}
    without, joined, alone = (found[f"keypoints.{way}.body.mpjpe.mean"] for way in ("without", "with", "alone"))
    assert joined < 1.2 * without
    assert joined < alone < 150.0
