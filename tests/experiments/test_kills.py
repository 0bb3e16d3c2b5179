"""Whatever ends a process, and whatever works beside it: no result is lost, and nobody is held up by what is gone."""

from __future__ import annotations

import importlib.util
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

from experiments.footage import SMALL
from experiments.run import main
from experiments.studies import jobs
from sim import capture_cache
from sim.capture_cache import shoot_cached
from sim.lock import locked
from sim.session import ShootConfig
from sim.team import Progress
from tests.scenes.sweeps import ENVIRONMENT, ROOT, began, command, composed, results, sweep_here, write

HOLD = """
import sys, time
from pathlib import Path
from experiments.studies import jobs
with jobs.alone(Path(sys.argv[1])):
    print("at work", flush=True)
    time.sleep(60)
"""


@contextmanager
def at_work(code: str, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """A process that has said that it is at work; killed in the end."""
    line = [sys.executable, "-c", code, *map(str, arguments)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=ENVIRONMENT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "at work\n"
        yield process
        process.kill()


# --------------------------------------------------------------------------------------------------------------
# Two at once


def test_a_job_is_finished_whatever_another_process_does_to_its_folder_meanwhile(tmp_path: Path) -> None:
    folder = tmp_path / "job"

    def meanwhile(tree: dict[str, Any], here: Path) -> str:
        folder.mkdir(parents=True)
        (folder / jobs.FAILED).write_text("another process works on this job\n")
        return write(tree, here)

    assert jobs.carry_out(folder, composed(), [], meanwhile) == "new"
    assert {path.name for path in folder.iterdir()} == {".hydra", jobs.MARK, "result.txt"}
    assert list(tmp_path.iterdir()) == [folder]


def test_two_sweeps_at_once_lose_nothing(tmp_path: Path) -> None:
    line = command(tmp_path, "value=1,2,3,4", "noise=0,1", "pause_s=0.02")
    both = [subprocess.Popen(line, cwd=ROOT, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    for process in both:
        assert process.communicate()[1].count("Traceback") == 0
        assert process.returncode == 0
    assert len(results(tmp_path)) == 8
    assert began(tmp_path) == 8  # the one waits for the other's job, and takes its result
    assert not list(tmp_path.glob(".*"))


def test_a_second_run_in_a_folder_says_who_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    monkeypatch.setattr("sys.argv", ["experiments.run", f"hydra.run.dir={folder}", "capture=nowhere"])
    with at_work(HOLD, folder) as holder:
        assert main() == 1
        err = capfd.readouterr().err
        assert err.startswith(f"error: {folder}: another run works in this folder; wait for it, or choose another")
        assert f"(it is process {holder.pid} on " in err
        assert err.count("\n") == 1
    assert (folder / ".lock").exists()
    (folder / ".report.html.partial").touch()
    assert main() == 1  # for want of a capture
    assert "another run" not in capfd.readouterr().err
    assert not (folder / ".lock").exists()
    assert not (folder / ".report.html.partial").exists()


# --------------------------------------------------------------------------------------------------------------
# Killed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("launcher", "package"),
    [("joblib", "hydra_plugins.hydra_joblib_launcher"), pytest.param("ray", "ray", marks=pytest.mark.heavy)],
)
def test_workers_end_with_their_sweep_and_the_next_goes_on(launcher: str, package: str, tmp_path: Path) -> None:
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install pzcap[launchers]")
    arguments = ("value=1,2,3,4,5,6", "pause_s=0.05")
    (tmp_path / "began.txt").touch()
    line = command(tmp_path, *arguments, launcher=launcher)
    process = subprocess.Popen(line, cwd=ROOT, env=ENVIRONMENT, stderr=subprocess.DEVNULL)
    while process.poll() is None and began(tmp_path) < 2:
        time.sleep(0.05)
    started = psutil.Process(process.pid).children(recursive=True)
    assert started
    process.kill()
    process.wait()
    done = sweep_here(tmp_path, *arguments)  # at once, while they may still be at work
    assert done.returncode == 0, done.stderr
    assert len(results(tmp_path)) == 6
    assert not list(tmp_path.glob(".*"))
    begun = began(tmp_path)
    assert not psutil.wait_procs(started, timeout=5.0)[1]
    assert began(tmp_path) == begun


def test_what_a_killed_sweep_left_is_swept_by_the_next_whatever_that_does(tmp_path: Path) -> None:
    (tmp_path / "began.txt").touch()
    line = command(tmp_path, "value=1", "pause_s=5")
    process = subprocess.Popen(line, cwd=ROOT, env=ENVIRONMENT, stderr=subprocess.DEVNULL)
    while process.poll() is None and began(tmp_path) < 1:
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert list(tmp_path.glob(".*.partial"))
    (tmp_path / ".other.stale" / "half").mkdir(parents=True)
    with locked(tmp_path / ".mine.partial.lock", "busy"):
        (tmp_path / ".mine.partial").mkdir()
        assert sweep_here(tmp_path, "value=2").returncode == 0
        assert {path.name for path in tmp_path.glob(".*")} == {".mine.partial", ".mine.partial.lock"}


def test_a_shoot_that_was_killed_is_swept_and_one_at_work_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pretend(_: ShootConfig, __: Path, folder: Path) -> Iterator[Progress]:
        (folder / "capture").mkdir()
        yield Progress("sweep", 1, 2)

    monkeypatch.setattr(capture_cache, "film", lambda *_: iter(()))
    monkeypatch.setattr(capture_cache, "develop", pretend)
    working = shoot_cached(SMALL, tmp_path)
    next(working)
    (own,) = (path for path in tmp_path.glob(".*") if path.is_dir())
    killed = tmp_path / f"{own.name[:-8]}00000000"
    (killed / "capture").mkdir(parents=True)
    killed.with_name(f"{killed.name}.lock").touch()
    (tmp_path / ".of-the-user").mkdir()
    list(shoot_cached(replace(SMALL, seed=1), tmp_path))
    assert {path.name for path in tmp_path.glob(".*")} == {own.name, f"{own.name}.lock", ".of-the-user"}
    list(working)
    assert [path.name for path in tmp_path.glob(".*")] == [".of-the-user"]
    assert len(list(tmp_path.glob("*/complete"))) == 4  # two captures, and their light


# --------------------------------------------------------------------------------------------------------------
# Asked to end


@pytest.mark.parametrize("asked", [signal.SIGTERM, signal.SIGINT])
def test_a_sweep_that_is_asked_to_end_says_so_and_leaves_nothing(asked: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "began.txt").touch()
    line = command(tmp_path, "value=1,2", "pause_s=5")
    with subprocess.Popen(line, cwd=ROOT, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and began(tmp_path) < 1:
            time.sleep(0.02)
        process.send_signal(asked)
        assert process.communicate(timeout=20.0)[1].endswith("interrupted\n")
    assert process.returncode == 130
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow
@pytest.mark.xdist_group("experiments")
def test_a_run_that_is_asked_to_end_while_it_shoots_leaves_nothing(tmp_path: Path) -> None:
    run = [sys.executable, "-m", "experiments.run", f"hydra.run.dir={tmp_path / 'run'}"]
    small = "shoot.width=160", "shoot.height=120", "shoot.gym.texture_px_per_m=50", "shoot.optics.zoom_max=1.8"
    line = [*run, f"output.captures={tmp_path / 'captures'}", *small]
    with subprocess.Popen(line, cwd=ROOT, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not list(tmp_path.glob("captures/.*/camera*/sweep.avi")):
            time.sleep(0.05)
        filming = psutil.Process(process.pid).children(recursive=True)
        process.terminate()
        assert process.communicate(timeout=20.0)[1].endswith("interrupted\n")
    assert process.returncode == 130
    assert not psutil.wait_procs(filming, timeout=5.0)[1]
    assert not list((tmp_path / "captures").iterdir())
    assert {path.name for path in (tmp_path / "run").iterdir()} == {".hydra"}


def test_the_handler_is_gone_with_the_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.argv", ["experiments.run", f"hydra.run.dir={tmp_path}", "capture=nowhere"])
    main()
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
