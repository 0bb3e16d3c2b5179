"""A sweep goes on where it was, whatever ended it, and never takes half a result or another's for its own."""

from __future__ import annotations

import importlib.util
import json
import os
import random
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from omegaconf import OmegaConf

from experiments import run
from experiments.errors import AlreadyReported
from experiments.studies import jobs
from pzcap.types import PzcapError
from tests.scenes import listening
from tests.scenes.sweeps import ENVIRONMENT, ROOT, began, command, composed, results, sweep, sweep_here, write

GRID = ("value=1,2,3,4,5,6,7,8", "noise=0,1,2")  # 24 jobs


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep over the grid that nothing disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    done = sweep(folder, *GRID)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def undisturbed(shared: Path) -> dict[str, dict[str, str]]:
    found = results(shared)
    assert len(found) == 24
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("launcher", "kills"), [("basic", 3), pytest.param("forking", 10, marks=pytest.mark.heavy)])
def test_killed_at_any_moment_it_ends_as_an_undisturbed_one(
    launcher: str, kills: int, undisturbed: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    rng = random.Random(launcher)
    (tmp_path / "began.txt").touch()
    for _ in range(kills):
        line = command(tmp_path, *GRID, launcher=launcher)
        process = subprocess.Popen(line, stderr=subprocess.DEVNULL, cwd=ROOT, env=ENVIRONMENT, start_new_session=True)
        begun = began(tmp_path)
        while process.poll() is None and began(tmp_path) < begun + rng.randrange(1, 3):
            time.sleep(0.001)
        time.sleep(rng.uniform(0.0, 0.04))  # a job takes 0.03 s
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        results(tmp_path)
    done = sweep(tmp_path, *GRID)
    assert done.returncode == 0, done.stderr
    assert results(tmp_path) == undisturbed
    assert not list(tmp_path.glob(".*.partial"))
    assert began(tmp_path) <= 24 + 2 * kills  # nothing was done again but what was at work when it was killed


def test_what_is_done_is_not_done_again_by_any_launcher(undisturbed: dict[str, dict[str, str]], shared: Path) -> None:
    assert began(shared) == 24
    again = sweep(shared, *reversed(GRID), launcher="forking")
    assert again.returncode == 0
    assert again.stderr == "24 jobs: 24 done before, 0 to do\n"
    assert began(shared) == 24
    assert results(shared) == undisturbed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("launcher", "package", "listens"),
    [
        ("basic", "hydra", False),
        ("joblib", "hydra_plugins.hydra_joblib_launcher", False),
        ("submitit_local", "hydra_plugins.hydra_submitit_launcher", False),
        ("ray", "ray", True),
    ],
)
def test_every_launcher_leaves_the_same_and_is_reached_by_nobody_else(
    launcher: str, package: str, listens: bool, undisturbed: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install pzcap[launchers]")
    without = {name: value for name, value in ENVIRONMENT.items() if name != "RAY_ADDRESS"}
    line = command(tmp_path, "value=1,3", "noise=2", launcher=launcher)
    process, found = subprocess.Popen(line, cwd=ROOT, env=without, stderr=subprocess.DEVNULL), set()
    while process.poll() is None:
        found |= listening.addresses(psutil.Process(process.pid))
        time.sleep(0.05)
    assert process.returncode == 0
    assert results(tmp_path) == {name: undisturbed[name] for name in results(tmp_path)}
    assert len(results(tmp_path)) == 2
    assert bool(found) == listens
    assert not listening.exposed(found)
    again = sweep_here(tmp_path, "value=1,3", "noise=2", launcher=launcher)
    assert again.stderr == "2 jobs: 2 done before, 0 to do\n"


def test_progress_says_how_much_is_left(tmp_path: Path) -> None:
    lines = sweep_here(tmp_path, "value=1,2,3", "pause_s=0.03").stderr.splitlines()
    assert lines[0] == "3 jobs: 0 done before, 3 to do"
    assert [re.sub(r"-\w{10} ", "-HASH ", re.sub(r"about \d+ s", "about N s", line)) for line in lines[1:]] == [
        "1 of 3: pause_s=0.03,value=1-HASH is done, about N s left",
        "2 of 3: pause_s=0.03,value=2-HASH is done, about N s left",
        "3 of 3: pause_s=0.03,value=3-HASH is done",
    ]


@pytest.mark.parametrize(("launcher", "swept"), [("basic", sweep_here), ("forking", sweep)])
def test_a_job_that_fails_is_told_and_does_not_stop_the_others(
    launcher: str, swept: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    line = ("value=1,2,3,4,5", "fails=2", "bug=4")
    done = swept(tmp_path, *line, launcher=launcher)
    assert done.returncode == 1
    assert len(results_but_failed(tmp_path)) == 3
    errors = [text for text in done.stderr.splitlines() if text.startswith("error: ")]
    assert len(errors) == 2
    assert any("value=2" in text and text.endswith(": this value cannot be") for text in errors)
    assert any(
        "value=4" in text and "ZeroDivisionError: one over zero (a bug: traceback in " in text for text in errors
    )
    assert done.stderr.splitlines()[-1] == "2 of 5 jobs failed; the same command runs them again"
    (bug,) = tmp_path.glob("*value=4*/failed.txt")
    assert "Traceback (most recent call last)" in bug.read_text()

    count = began(tmp_path)
    again = swept(tmp_path, *line, launcher=launcher)
    assert again.returncode == 1
    assert "5 jobs: 3 done before, 2 to do" in again.stderr
    assert began(tmp_path) == count + 2


def results_but_failed(folder: Path) -> list[Path]:
    return [path.parent for path in folder.glob(f"*/{jobs.MARK}")]


def test_folders_of_the_users_own_naming_are_told_apart_by_what_they_hold(tmp_path: Path) -> None:
    numbered = "hydra.sweep.subdir=job${hydra.job.num}"
    assert sweep_here(tmp_path, numbered, "value=1,2,3").returncode == 0
    changed = sweep_here(tmp_path, numbered, "value=1,7,3")
    assert "3 jobs: 2 done before, 1 to do" in changed.stderr
    assert {name: files["a.txt"][:3] for name, files in results(tmp_path).items()} == {
        "job0": "a 1", "job1": "a 7", "job2": "a 3"
    }  # fmt: skip


def test_code_that_changed_while_a_job_ran_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Plugins.instance()  # loads Hydra's own sweepers anew: not after ours was derived from one of them
    from experiments.studies import sweeper

    (tmp_path / jobs.MARK).write_text('{"key": "of the code as it is now"}')
    job = sweeper.Job((), tmp_path, "of the code as it was")
    with pytest.raises(AlreadyReported):
        sweeper._account([job], [job])
    assert capsys.readouterr().err.endswith(": the code changed while it ran\n")


def test_axes_of_a_study_give_way_to_those_of_the_command(tmp_path: Path) -> None:
    axes = "hydra.sweeper.params={value:'1,2,3',noise:'0,1'}"
    assert sweep_here(tmp_path / "all", axes).returncode == 0
    assert len(results(tmp_path / "all")) == 6
    assert sweep_here(tmp_path / "fewer", axes, "value=7,8").returncode == 0
    assert sorted({files["a.txt"][2] for files in results(tmp_path / "fewer").values()}) == ["7", "8"]
    assert len(results(tmp_path / "fewer")) == 4


# --------------------------------------------------------------------------------------------------------------
# One job


def test_a_job_is_done_once(tmp_path: Path) -> None:
    folder = tmp_path / "job"
    assert jobs.carry_out(folder, composed(), ["value=1"], write) == "new"
    assert jobs.carry_out(folder, composed(), ["value=1"], write) is None
    assert jobs.failure(folder) is None
    assert json.loads((folder / jobs.MARK).read_text())["overrides"] == ["value=1"]


def test_the_configuration_goes_with_the_result(tmp_path: Path) -> None:
    folder = tmp_path / "job"
    (folder / ".hydra").mkdir(parents=True)  # as Hydra leaves it where a job was killed that it had announced
    for value in (1, 2):
        jobs.carry_out(folder, composed(value=value), [f"value={value}"], write)
        assert {path.name for path in folder.iterdir()} == {".hydra", jobs.MARK, "result.txt"}
        assert OmegaConf.load(folder / ".hydra" / "config.yaml") == composed(value=value)
        assert OmegaConf.load(folder / ".hydra" / "overrides.yaml") == [f"value={value}"]
    assert list(tmp_path.iterdir()) == [folder]


def test_hydra_itself_writes_nothing_into_a_jobs_folder(tmp_path: Path) -> None:
    assert sweep_here(tmp_path, "value=1,2", "pause_s=0").returncode == 0
    jobs_hydra = {path.name for job in tmp_path.iterdir() if job.is_dir() for path in (job / ".hydra").iterdir()}
    assert jobs_hydra == {"config.yaml", "overrides.yaml"}  # without the hydra.yaml of Hydra's own


def test_a_changed_config_or_code_replaces_the_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "job"
    jobs.carry_out(folder, composed(), [], write)
    assert jobs.carry_out(folder, composed(value=2), [], write) == "new"
    assert (folder / "result.txt").read_text() == "2"
    monkeypatch.setattr(jobs, "_code", lambda: "tomorrow's")
    assert jobs.carry_out(folder, composed(value=2), [], write) == "new"


def test_a_users_estimator_that_was_edited_is_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    module, folder = tmp_path / "edited_lab.py", tmp_path / "job"
    module.write_text("def estimate(capture): ...\n")
    mine = composed(estimator="edited_lab:estimate")
    assert jobs.carry_out(folder, mine, [], write) == "new"
    assert jobs.carry_out(folder, mine, [], write) is None
    module.write_text("def estimate(capture): return []\n")
    assert jobs.carry_out(folder, mine, [], write) == "new"


@pytest.mark.parametrize(("name", "inside"), [("capture", "capture"), ("cameras", "reconstruction")])
def test_what_a_user_gave_and_made_anew_is_run_again(name: str, inside: str, tmp_path: Path) -> None:
    given, folder = tmp_path / "run", tmp_path / "job"
    mine = composed(**{name: str(given)})
    assert jobs.carry_out(folder, mine, [], write) == "new"  # nothing is there: the job itself says so
    for part in ("capture", "reconstruction"):
        (given / part).mkdir(parents=True)
    for text in ("first", "the other"):
        (given / inside / "motion.mp4").write_text(text)
        assert jobs.carry_out(folder, mine, [], write) == "new"
        assert jobs.carry_out(folder, mine, [], write) is None


def test_a_job_that_fails_leaves_its_reason_and_no_old_result(tmp_path: Path) -> None:
    folder = tmp_path / "job"
    jobs.carry_out(folder, composed(), [], write)

    def refuse(_: dict[str, Any], folder: Path) -> None:
        (folder / "result.txt").write_text("half")
        raise PzcapError("no such capture")

    assert jobs.carry_out(folder, composed(value=2), [], refuse) is None
    assert {path.name for path in folder.iterdir()} == {jobs.FAILED}
    assert jobs.failure(folder) == "no such capture"
    assert jobs.carry_out(folder, composed(value=2), [], write) == "new"
    assert jobs.failure(folder) is None


def test_what_no_sweep_left_there_is_not_touched(tmp_path: Path) -> None:
    footage = tmp_path / "job" / "capture" / "capture.json"
    footage.parent.mkdir(parents=True)
    footage.write_text("{}")
    jobs.carry_out(tmp_path / "job", composed(), [], write)
    assert footage.read_text() == "{}"
    assert "choose another folder" in str(jobs.failure(tmp_path / "job"))


def test_one_process_at_a_time(tmp_path: Path) -> None:
    folder = tmp_path / "job"

    def meanwhile(tree: dict[str, Any], here: Path) -> None:
        write(tree, here)
        assert jobs.carry_out(folder, composed(), [], write) is None
        assert "another process works on this job" in str(jobs.failure(folder))

    jobs.carry_out(folder, composed(), [], meanwhile)
    assert (folder / "result.txt").read_text() == "1"
    assert jobs.failure(folder) is None


# --------------------------------------------------------------------------------------------------------------
# Its name


def named(*overrides: str) -> str:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(run.CONF), version_base="1.3"):
        return jobs.name(compose("config", overrides=list(overrides), return_hydra_config=True))


def test_a_name_is_readable_and_does_not_depend_on_the_order() -> None:
    name = named("seed=3", "shoot.sensor.read_noise=4", "experiment=clean")
    assert re.fullmatch(r"read_noise=4,seed=3-[0-9a-f]{10}", name)
    assert name == named("experiment=clean", "shoot.sensor.read_noise=4", "seed=3")
    assert name != named("experiment=pedestrian", "shoot.sensor.read_noise=4", "seed=3")
    assert re.fullmatch(r"[0-9a-f]{10}", named())


def test_a_name_fits_any_disk() -> None:
    name = named("capture=/some/where/else", "estimator='my lab:follow'")
    assert re.fullmatch(r"capture=else,estimator=my_lab_follow-\w{10}", name)
    assert len(named("capture=" + "long" * 60)) <= 91
