"""Wherever it runs: locale C, a clock that is set back, folders whose names are not UTF-8 or have signs of a shell."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from experiments import recordings
from experiments.metrics import read_metrics
from experiments.studies import jobs
from pzcap.command.exporting import export_results
from pzcap.export.formats import FORMATS
from pzcap.io import results
from pzcap.io.capture import read_capture
from pzcap.io.video import VideoReader
from pzcap.types import PzcapError
from sim.capture_cache import kept, make_room
from tests.command.test_new import crew
from tests.scenes import exported, fabricated
from tests.scenes.studies import record
from tests.scenes.sweeps import ENVIRONMENT, ROOT, command, composed, write
from tests.scenes.sweeps import results as results_of

FOREIGN = os.fsdecode(b"B\xfchne")
"""Latin-1, as disks of old cameras and Samba shares have it."""
ODD = f"a b=c,d[e]'f {FOREIGN}"
PLAIN = {name: value for name, value in ENVIRONMENT.items() if not name.startswith(("LC_", "LANG", "PYTHONUTF8"))}
LOCALE_C = PLAIN | {"LC_ALL": "C"}
"""As in cron."""
STRICT = PLAIN | {"PYTHONIOENCODING": "ascii:strict"}
"""A terminal that knows no accents, and escapes nothing."""


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    folder = tmp_path / ODD
    try:
        folder.mkdir()
    except OSError:
        pytest.skip("the file system has no such names")
    return folder


def ended(line: Sequence[str], environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        line, cwd=ROOT, env=environment, capture_output=True, text=True, errors="surrogateescape", check=False
    )


# --------------------------------------------------------------------------------------------------------------
# Names of folders and files


def test_results_are_saved_loaded_and_exported_there(odd: Path) -> None:
    whole = fabricated.reconstruction()
    results.save(whole, odd / "reconstruction")
    found = results.load(odd / "reconstruction")
    assert found.timecodes == whole.timecodes
    assert [one is None for one in found.panoramas] == [one is None for one in whole.panoramas]
    results.save(exported.reconstruction(), odd / "reconstruction")
    drawn = [name for name in FORMATS if name not in ("fbx", "stabilised", "pose2sim", "aniposelib")]  # need more
    assert export_results(odd / "reconstruction", drawn, odd / "exported", None, None) == 0
    assert {path.name for path in (odd / "exported").iterdir()} == set(drawn)


def test_a_recording_is_written_there(odd: Path) -> None:
    path = odd / "run" / "recording.rrd"
    record(path, 1.0, 0)
    with pytest.raises(PzcapError, match="Rerun reads no path that is not UTF-8; rename its folder"):
        recordings.recording_id(path)
    moved = odd.rename(odd.with_name(ODD.removesuffix(FOREIGN)))
    assert recordings.recording_id(moved / "run" / "recording.rrd")


def test_a_camera_whose_name_no_text_holds_is_saved_as_it_is(tmp_path: Path) -> None:
    """JSON can say such a name, and a folder's name can be one."""
    whole = fabricated.reconstruction(cameras=1)
    named = {"camera_names": (FOREIGN,), "capture_name": FOREIGN, "notes": (f"camera {FOREIGN}: a note",)}
    for field, value in named.items():
        object.__setattr__(whole, field, value)
    results.save(whole, tmp_path)
    found = results.load(tmp_path)
    assert {field: getattr(found, field) for field in named} == named


@pytest.mark.parametrize("environment", [LOCALE_C, STRICT], ids=["C", "strict"])
def test_a_crews_files_are_named_where_they_lie(environment: dict[str, str], odd: Path) -> None:
    crew(odd.parent / "plain", cameras=("GoPro 1", "Süd"))  # OpenCV does not write there
    for name, named in (("GoPro 1", FOREIGN), ("Süd", "Süd")):
        (odd.parent / "plain" / name).rename(odd / named)
    done = ended([sys.executable, "-m", "pzcap.command", "new", str(odd)], environment)
    assert done.returncode == 0, done.stderr
    assert "capture.json: written" in done.stdout
    capture = read_capture(odd)
    assert {camera.name for camera in capture.cameras} == {FOREIGN, "Süd"}
    for camera in capture.cameras:
        assert camera.motion is not None
        assert VideoReader(camera.motion).frame_count == 4


def test_a_sweep_does_its_jobs_there(odd: Path) -> None:
    quoted = str(odd).replace("'", "\\'")
    line = command(Path(f"'{quoted}'"), "value=1,2")
    assert ended(line, LOCALE_C).returncode == 0
    assert len(results_of(odd)) == 2


def test_why_a_job_failed_is_kept_there(odd: Path) -> None:
    def fails(*_: object) -> str:
        raise PzcapError(f"{odd}: is no capture")

    assert jobs.carry_out(odd / "job", composed(), [], fails) is None
    assert (jobs.failure(odd / "job") or "").endswith(": is no capture")


@pytest.mark.heavy
@pytest.mark.parametrize("environment", [LOCALE_C, STRICT], ids=["C", "strict"])
def test_a_whole_run_there(environment: dict[str, str], odd: Path, small_capture: Path) -> None:
    shutil.copytree(small_capture, odd / "shot")
    quoted = str(odd).replace("'", "\\'")
    done = ended(
        [sys.executable, "-m", "experiments.run", f"capture='{quoted}/shot'", f"hydra.run.dir='{quoted}/run'"],
        environment,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "Warning" not in done.stderr
    found, _ = read_metrics(odd / "run" / "metrics.json")
    assert found
    for name in ("report.html", "recording.rrd", "reconstruction/reconstruction.json"):
        assert (odd / "run" / name).stat().st_size > 0
    part = [sys.executable, "-m", "pzcap.command"]
    for arguments in (
        ["check", str(odd / "shot" / "capture")],
        ["export", str(odd / "run"), "--to", "stabilised", "--out", str(odd / "out"), "--capture",
         str(odd / "shot" / "capture")],
    ):  # fmt: skip
        done = ended([*part, *arguments], environment)
        assert done.returncode == 0, done.stderr


# --------------------------------------------------------------------------------------------------------------
# A clock that is set back


@pytest.fixture
def set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock goes back by an hour whenever somebody looks at it; all that was written is of tomorrow."""
    hours = iter(range(10_000))
    begun = time.time()
    monkeypatch.setattr(time, "time", lambda: begun - 3600.0 * next(hours))
    monkeypatch.setattr(time, "time_ns", lambda: int(1e9 * time.time()))


@pytest.mark.usefixtures("set_back")
def test_a_job_is_done_once(tmp_path: Path) -> None:
    folder = tmp_path / "job"
    assert jobs.carry_out(folder, composed(), [], write) == "new"
    tomorrow = time.time() + 86_400.0
    for path in (*folder.iterdir(), folder):
        os.utime(path, (tomorrow, tomorrow))
    assert jobs.carry_out(folder, composed(), [], write) is None
    assert jobs.marked(folder)[1] >= 0.0
    assert jobs.carry_out(folder, composed(value=2), [], write) == "new"
    assert (folder / "result.txt").read_text() == "2"


def test_light_of_tomorrow_makes_room_as_any_other(tmp_path: Path) -> None:
    for hours, name in ((30.0, "light-a-0-000000000000"), (0.1, "light-b-0-000000000000")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "complete").touch()
        (tmp_path / name / "frames").write_bytes(bytes(1000))
        used_s = time.time() + 3600.0 * hours
        os.utime(tmp_path / name / "complete", (used_s, used_s))
    assert len(kept(tmp_path)) == 2
    assert [one.folder.name[:7] for one in make_room(tmp_path, 0.0)] == ["light-a"]
