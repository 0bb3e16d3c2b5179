"""The command that compares a sweep on one core with the same on several: it counts right, and sees what differs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from experiments import efficiency
from experiments.efficiency import Spent
from experiments.studies.study import TABLE
from pzcap.types import PzcapError


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
def test_it_runs_the_study_in_three_ways_and_compares(
    found: float, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told: list[list[tuple[list[str], list[int]]]] = []

    def run(processes: Sequence[tuple[Sequence[str], Sequence[int]]]) -> Spent:
        told.append([(list(arguments), list(cores)) for arguments, cores in processes])
        for arguments, _ in processes:
            if arguments[0] == "-m":
                folder = Path(next(a.partition("=")[2] for a in arguments if a.startswith("hydra.sweep.dir=")))
                folder.mkdir(parents=True)
                pq.write_table(results(found if folder.name == "parallel" else 0.1), folder / TABLE)
        return Spent((0.0, 60.0, 40.0, 37.5)[len(told) - 1], 66.0)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(efficiency, "run", run)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1, 2, 3})
    monkeypatch.setattr("sys.argv", ["efficiency", "--jobs", "3", "--cores", "2", "experiment=clean"])
    assert efficiency.main() == status
    assert [[cores for _, cores in processes] for processes in told] == [[[0, 1]], [[0]], [[0], [1]], [[0, 1]]]
    assert all("experiment=clean" in arguments for processes in told for arguments, _ in processes)
    axes = [[arguments[-1].partition("=") for arguments, _ in processes] for processes in told[1:]]
    assert all(key == efficiency.SETTING for processes in axes for key, _, _ in processes)
    assert [[values for _, _, values in processes] for processes in axes] == [
        ["0.8,0.79,0.78"], ["0.8,0.78", "0.79"], ["0.8,0.79,0.78"],
    ]  # fmt: skip
    assert ["hydra/launcher=joblib" in processes[0][0] for processes in told] == [False, False, False, True]
    out = capsys.readouterr().out
    rows = [line.strip("│ ").split() for line in out.splitlines() if line.startswith("│")]
    assert [row[-1] for row in rows] == ["1.00", "0.75", "0.80"]
    assert ("equal: 2 rows" if status == 0 else "differ in metric.panzoom.pan.rms") in out


def test_what_a_run_takes_is_the_time_of_all_its_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    busy = "import time\nwhile time.process_time() < 0.2: pass"
    monkeypatch.setattr(efficiency, "COMMAND", ("-c", busy))
    cores = sorted(os.sched_getaffinity(0))[:1]
    spent = efficiency.run([((), cores), ((), cores)])
    assert spent.cpu_s >= 0.4
    monkeypatch.setattr(efficiency, "COMMAND", ("-c", "raise SystemExit(3)"))
    with pytest.raises(PzcapError, match="exit status 3"):
        efficiency.run([((), cores)])


@pytest.mark.parametrize(
    ("given", "said"), [(["--cores", "4096"], "--cores is 4096"), (["--jobs", "1"], "--jobs is 1")]
)
def test_what_cannot_be_shared_out_gets_one_line(
    given: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr("sys.argv", ["efficiency", *given])
    assert efficiency.main() == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
