"""The sweep over noise and zoom: runs what is not done, goes on after a kill, and shows error and bound."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import pytest
from rich.console import Console

from experiments import surface
from experiments.config import AppConfig
from experiments.metrics import Metric, write_metrics
from pzcap.types import PzcapError

NOISE, ZOOM = (0.0, 4.0), (1.0, 3.0)


class Bench:
    """Stands in for `experiments.run.run`: errors that are three times the bound, or a failure."""

    def __init__(self, bounded: bool = True, fails: float | None = None, lost: float = 0.0) -> None:
        self.ran: list[Path] = []
        self._bounded, self._fails, self._lost = bounded, fails, lost

    def __call__(self, config: AppConfig, tree: dict[str, Any], folder: Path, _: Console) -> None:
        self.ran.append(folder)
        noise, zoom = config.shoot.sensor.read_noise, config.shoot.optics.zoom_max
        if noise == self._fails:
            raise PzcapError("camera 2: the sweep shows nothing")
        error = (1.0 + noise) / zoom / 1000
        ratio = 3.0 if self._bounded else None
        found = [
            Metric("panzoom.pan.rms", error, "deg"),
            Metric("panzoom.focal.rms", 10 * error, "%"),
            Metric("panzoom.bound_ratio.pan", ratio, "1"),
            Metric("panzoom.bound_ratio.focal", ratio, "1"),
            Metric("panzoom.lost", self._lost, "frames"),
        ]
        folder.mkdir(parents=True, exist_ok=True)
        write_metrics(folder / "metrics.json", found, {"config": tree, "seed": config.seed})


def sweep(folder: Path, bench: Bench, overrides: Sequence[str] = (), noise: Sequence[float] = NOISE) -> bool:
    return surface.surface(noise, ZOOM, folder, overrides, Console(quiet=True), bench)


def test_every_job_is_run_and_shown(tmp_path: Path) -> None:
    bench = Bench()
    assert sweep(tmp_path, bench)
    assert [path.name for path in bench.ran] == ["noise0_zoom1", "noise4_zoom1", "noise0_zoom3", "noise4_zoom3"]
    rows = json.loads((tmp_path / "surface.json").read_text())
    assert rows[3] == {
        "noise": 4.0, "zoom": 3.0, "pan_deg": pytest.approx(5e-3 / 3), "pan_bound_deg": pytest.approx(5e-3 / 9),
        "focal_percent": pytest.approx(5e-2 / 3), "focal_bound_percent": pytest.approx(5e-2 / 9), "lost": 0.0,
    }  # fmt: skip
    table = list(csv.DictReader((tmp_path / "surface.csv").open()))
    assert [float(row["pan_deg"]) for row in table] == [row["pan_deg"] for row in rows]
    picture = cv2.imread(str(tmp_path / "surface.png"))
    assert picture is not None
    assert min(picture.shape[:2]) > 800
    assert picture.std() > 5
    page = (tmp_path / "surface.html").read_text()
    assert "<svg" in page
    assert "with frames lost" not in page
    assert "Cramér-Rao bound" in page
    assert page.count("<tr>") == 1 + 4


def test_what_is_done_is_not_run_again_and_what_was_killed_is(tmp_path: Path) -> None:
    sweep(tmp_path, Bench())
    (tmp_path / "noise4_zoom1" / "metrics.json").unlink()
    again = Bench()
    assert sweep(tmp_path, again)
    assert [path.name for path in again.ran] == ["noise4_zoom1"]
    wider = Bench()
    sweep(tmp_path, wider, noise=(*NOISE, 8.0))
    assert [path.name for path in wider.ran] == ["noise8_zoom1", "noise8_zoom3"]
    other = Bench()
    sweep(tmp_path, other, ["seed=3"])  # of another configuration: not done
    assert len(other.ran) == 4


def test_a_job_that_fails_leaves_a_hole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(fails=4.0)
    assert not sweep(tmp_path, bench)
    assert len(bench.ran) == 4
    assert capsys.readouterr().err.count("error: camera 2: the sweep shows nothing\n") == 2
    rows = json.loads((tmp_path / "surface.json").read_text())
    assert [row["pan_deg"] is None for row in rows] == [False, True, False, True]
    assert "2 jobs left no figure" in (tmp_path / "surface.html").read_text()


def test_errors_of_the_frames_that_were_not_lost_are_marked(tmp_path: Path) -> None:
    sweep(tmp_path, Bench(lost=5.0))
    assert "with frames lost" in (tmp_path / "surface.html").read_text()


def test_without_a_bound_none_is_drawn(tmp_path: Path) -> None:
    assert sweep(tmp_path, Bench(bounded=False))
    assert "none is drawn" in (tmp_path / "surface.html").read_text()
    assert all(row["pan_bound_deg"] is None for row in json.loads((tmp_path / "surface.json").read_text()))


def test_the_jobs_differ_in_noise_and_zoom_alone(tmp_path: Path) -> None:
    jobs = surface.jobs(NOISE, ZOOM, tmp_path, ["seed=7", "method=paper"])
    for job in jobs:
        shoot = job.config.shoot
        assert (shoot.sensor.read_noise, shoot.optics.zoom_max) == (job.noise, job.zoom)
        assert job.config.seed == shoot.seed == 7
        assert job.config.reconstruct.panzoom.method == "paper"
        assert shoot.motion_frames == 20
    assert len({json.dumps(job.tree["reconstruct"]) for job in jobs}) == 1


@pytest.mark.parametrize(
    ("arguments", "says"),
    [(["shoot.sensr.read_noise=3"], "did you mean shoot.sensor.read_noise"), (["--noise", "loud"], "invalid float")],
)
def test_a_wrong_command_gets_one_line(
    arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = surface.main(["--folder", str(tmp_path), *arguments])
    except SystemExit as end:
        status = int(str(end.code))
    assert status != 0
    assert says in capsys.readouterr().err
