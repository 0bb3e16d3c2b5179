"""The command that compares a sweep on one core with the same on several: it counts right, and sees what differs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from experiments import efficiency
from experiments.study import TABLE


def results(error: float, fps: float = 9.0, order: Sequence[int] = (0, 1)) -> pa.Table:
    rows = [
        {"path": f"job{k}", "seconds": fps * k, "metric.speed.fps": fps, "metric.panzoom.pan.rms": error + k}
        for k in order
    ]
    return pa.Table.from_pylist(rows)


def test_tables_differ_by_what_was_found_and_not_by_what_the_machine_took() -> None:
    assert efficiency.differing(results(0.1), results(0.1, fps=4.0, order=(1, 0))) == []
    assert efficiency.differing(results(0.1), results(0.2)) == ["metric.panzoom.pan.rms"]
    assert "path" in efficiency.differing(results(0.1), results(0.1, order=(0,)))
    assert efficiency.differing(results(0.1), results(0.1).append_column("new", [[1, 2]])) == ["new"]


@pytest.mark.parametrize(("found", "status"), [(0.1, 0), (0.3, 1)])
def test_it_runs_the_study_twice_and_compares(
    found: float, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told: list[tuple[list[str], int]] = []

    def run(arguments: Sequence[str], cores: int) -> None:
        told.append((list(arguments), cores))
        if arguments[0] == "-m":
            folder = Path(next(a.partition("=")[2] for a in arguments if a.startswith("hydra.sweep.dir=")))
            folder.mkdir(parents=True)
            pq.write_table(results(0.1 if folder.name == "serial" else found), folder / TABLE)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(efficiency, "_run", run)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1, 2, 3})
    monkeypatch.setattr("sys.argv", ["efficiency", "--jobs", "3", "--cores", "2", "experiment=clean"])
    assert efficiency.main() == status
    assert [cores for _, cores in told] == [2, 1, 2]
    assert all("experiment=clean" in arguments for arguments, _ in told)
    assert told[1][0][-1] == told[2][0][-1] == f"{efficiency.SETTING}=0.8,0.79,0.78"
    assert "hydra/launcher=joblib" in told[2][0]
    assert ("equal: 2 rows" if status == 0 else "differ in metric.panzoom.pan.rms") in capsys.readouterr().out


def test_more_cores_than_there_are_get_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["efficiency", "--cores", "4096"])
    assert efficiency.main() == 1
    assert "--cores is 4096" in capsys.readouterr().err
