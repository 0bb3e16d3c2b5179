"""The command that shows how a study grows, with few runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from experiments import large_study
from experiments.studies import page, study


def test_made_up_results_become_a_table_and_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(study, "PART", 16)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["large_study", "--runs", "40"])
    assert large_study.main() == 0
    out = capsys.readouterr().out
    assert "40 runs" in out
    assert "collected, tabled and plotted" in out
    assert not list(tmp_path.iterdir())


def test_the_stub_leaves_results_as_jobs_do(tmp_path: Path) -> None:
    assert len(list(large_study.stubs(40, tmp_path))) == 40
    assert page.write_study(tmp_path, large_study.places(40, tmp_path))
    rows = pq.read_table(tmp_path / study.TABLE).to_pylist()
    errors = {m: [r["metric.panzoom.pan.rms"] for r in rows if r["config.method"] == m] for m in ("exact", "paper")}
    assert np.mean(errors["paper"]) == pytest.approx(2 * np.mean(errors["exact"]), rel=0.2)


def test_no_run_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["large_study", "--runs", "0"])
    assert large_study.main() == 1
    assert "give 1 or more" in capsys.readouterr().err
