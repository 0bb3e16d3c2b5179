"""The recordings of a sweep are a table, as docs/recording.md shows."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import catalog
from tests.scenes.studies import record

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("datafusion") is None, reason="needs rerun-sdk[catalog]: pip install pzcap[catalog]"
)
DOCUMENT = Path(__file__).parents[2] / "docs" / "recording.md"
EXAMPLE = next(block for block in re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.S) if "Server" in block)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which a study of 24 runs left its recordings."""
    folder = tmp_path_factory.mktemp("catalog")
    for noise in (0, 1.5, 2, 2.5, 3, 4, 5, 8):  # whole numbers and others, as they come from a command line
        for seed in range(3):
            record(folder / "outputs" / "study" / "noise" / f"{noise}-{seed}" / "recording.rrd", noise, seed)
    return folder


def test_the_example_runs(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sum(bool(line) for line in EXAMPLE.splitlines()) <= 10
    monkeypatch.chdir(recordings)
    names: dict[str, Any] = {}
    exec(compile(EXAMPLE, str(DOCUMENT), "exec"), names)
    assert len(names["runs"]) == 24
    table = names["pan_deg"].groupby(names["noise"]).mean()
    np.testing.assert_allclose(table.index, [0, 1.5, 2, 2.5, 3, 4, 5, 8])
    np.testing.assert_allclose(table, 0.001 * (table.index + 1))
    assert "mean" in capsys.readouterr().out


def test_the_command_prints_the_same_table_and_how_long_it_took(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["catalog", str(recordings), "shoot.sensor.read_noise", "panzoom.pan.rms"])
    assert catalog.main() == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line.strip("│ ").split("│") for line in lines if line.startswith("│")]
    assert [[cell.strip() for cell in row] for row in rows] == [
        [f"{noise:g}", "3", f"{0.001 * (noise + 1):.4g}", "0.001"] for noise in (0, 1.5, 2, 2.5, 3, 4, 5, 8)
    ]
    time = r"[\d.]+ s \([\d.]+ s of CPU\)"
    assert re.fullmatch(f"24 recordings, opened in {time}, asked in {time}", lines[-1])


def test_a_setting_that_no_recording_holds_gets_one_line(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["catalog", str(recordings), "shoot.sensor.read_nose", "panzoom.pan.rms"])
    assert catalog.main() == 1
    error = capsys.readouterr().err
    assert "did you mean shoot_sensor_read_noise" in error
    assert error.count("\n") == 1
