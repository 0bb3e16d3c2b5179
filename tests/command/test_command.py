"""The command as a user types it: what it leaves, what it says, its exit status."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from pzcap.command import doctor, reconstructing, reviewing
from pzcap.command.main import main, parser
from pzcap.command.progress import ProgressLine
from pzcap.events import Event, Progress
from pzcap.export.formats import FORMATS
from pzcap.io import results
from pzcap.types import PzcapError, Reconstruction
from tests.scenes import exported, fabricated


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    results.save(exported.reconstruction(), folder / "reconstruction")
    return folder


@pytest.mark.xdist_group("pipeline")
def test_from_a_capture_to_a_skeleton(
    small_capture: Path, small_run: Reconstruction, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first camera is calibrated, the others are known."""
    results.save(replace(small_run, camera_names=("another", *small_run.camera_names[1:])), tmp_path / "before")
    given = "--cameras", str(tmp_path / "before"), "--out", str(tmp_path / "r")
    assert main(["reconstruct", str(small_capture / "capture"), *given]) == 0
    said = capsys.readouterr()
    assert re.search(r": 8 frame sets from 11:05:53:03 to 11:05:53:10", said.out)
    assert re.search(r"camera 1: located in [78] of 8 frames; pan to 0\.0\d+ degrees", said.out)
    assert re.search(r"body: tracked in 8 of 8 frames; joints to \d+ mm", said.out)
    assert f"to look at it: rerun {tmp_path / 'r' / 'recording.rrd'}\n" in said.out
    assert said.out.endswith(f"to take it elsewhere: pzcap export {tmp_path / 'r'} --to bvh --out FOLDER\n")
    assert (tmp_path / "r" / "recording.rrd").stat().st_size > 10_000
    assert main(["export", str(tmp_path / "r"), "--to", "bvh", "--out", str(tmp_path / "e")]) == 0
    written = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert [path.suffix for path in written] == [".bvh", ".csv"]
    assert written[0].read_text().count("\n") > 8


def test_results_of_before_stay_until_new_ones_are_whole(
    saved: Path, small_capture: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> Iterator[Event]:
        yield Progress("camera 1", 1, 8)
        raise KeyboardInterrupt

    before = {path.name: path.read_bytes() for path in (saved / "reconstruction").iterdir()}
    monkeypatch.setattr(reconstructing, "stages", interrupted)
    assert main(["reconstruct", str(small_capture / "capture"), "--out", str(saved)]) == 130
    assert {path.name: path.read_bytes() for path in (saved / "reconstruction").iterdir()} == before
    assert [path.name for path in saved.iterdir()] == ["reconstruction"]


def test_several_formats_have_a_folder_each(saved: Path, tmp_path: Path) -> None:
    assert main(["export", str(saved), "--to", "TRC", "chan", "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"trc", "chan"}
    assert main(["export", str(saved / "reconstruction"), "--to", "trc", "--out", str(tmp_path / "one")]) == 0
    assert list((tmp_path / "one").glob("*.trc"))


def test_export_says_that_it_has_no_keypoints(saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(saved), "--to", "aniposelib", "--out", str(tmp_path / "e")]) == 0
    assert capsys.readouterr().err.splitlines() == [
        "pzcap: aniposelib: metres, z up",
        "pzcap: aniposelib: the calibration alone; --capture FOLDER takes the keypoints along",
    ]


def test_export_finds_the_capture_that_the_results_were_made_of(
    small_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results.save(exported.reconstruction(), tmp_path / "r" / "reconstruction")
    (tmp_path / "r" / "capture").symlink_to(small_capture / "capture")
    line = ["export", str(tmp_path / "r"), "--to", "aniposelib", "--out", str(tmp_path / "e")]
    assert main(line) == 0
    said = capsys.readouterr().err
    assert said.endswith("pzcap: aniposelib: the calibration alone; the capture has no keypoints\n")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "capture.json").write_text("{")
    (tmp_path / "r" / "capture").unlink()
    (tmp_path / "r" / "capture").symlink_to(tmp_path / "broken")
    assert main(line) == 0
    assert "without the capture, which cannot be read: " in capsys.readouterr().err


@pytest.mark.parametrize("given", [[], ["--free-tilt"]])
def test_heads_that_were_tilted_are_calibrated_as_such(
    given: list[str], small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = []

    def stages(_capture: Any, config: Any, _cameras: Any) -> Any:
        free.append(config.panzoom.free_tilt)
        raise PzcapError("that is enough")

    monkeypatch.setattr(reconstructing, "stages", stages)
    assert main(["reconstruct", str(small_capture / "capture"), "--out", str(tmp_path / "r"), *given]) == 1
    assert free == [bool(given)]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (["export", "nowhere", "--to", "bvh", "--out", "x"], "nowhere: no reconstruction.json"),
        (["export", "SAVED", "--to", "bvhh", "--out", "x"], "no format 'bvhh'; did you mean 'bvh'? There are trc"),
        (["export", "SAVED", "--to", "bvh", "--out", "x", "--udp", "127.0.0.1:1"], "--udp goes with --to freed alone"),
        (["export", "SAVED", "--to", "freed", "--out", "x", "--udp", "here"], "--udp here: give HOST:PORT"),
        (["reconstruct", "nowhere", "--out", "x"], "the folder that holds it; pzcap new FOLDER writes one"),
        (["reconstruct", "nowhere", "--out", "x", "--threads", "0"], "threads is 0"),
        (["reconstruct", "nowhere", "--out", "x", "--cameras", "there"], "there: no reconstruction.json"),
        (["review", "SAVED"], "no recording.rrd in it"),
        (["edit", "nowhere"], "nowhere: neither a capture.json in it nor a reconstruction"),
        (["edit", "SAVED"], "does not tell which capture it was made of; give --capture FOLDER"),
        (["edit", "SAVED", "--capture", "nowhere"], "nowhere/capture.json"),
        (["export", "CAPTURE", "--to", "bvh", "--out", "x"], "run pzcap reconstruct CAPTURE --out RESULTS first"),
        (["lengths", "nowhere"], "nowhere/capture.json"),
        (["export", "SAVED", "--to", "bvh", "--out", "FILE"], "File exists"),
    ],
)
def test_what_is_wrong_is_one_line(
    line: list[str], says: str, saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("FILE").touch()
    Path("CAPTURE").mkdir()
    Path("CAPTURE", "capture.json").touch()
    assert main([str(saved) if word == "SAVED" else word for word in line]) == 1
    said = capsys.readouterr()
    assert said.err.startswith("pzcap: ")
    assert said.err.count("\n") == 1
    assert says in said.err
    assert said.out == ""


@pytest.mark.parametrize("part", ["new", "check", "export", "review"])
def test_the_help_of_a_part_says_what_it_does(part: str, capsys: pytest.CaptureFixture[str]) -> None:
    whole = next(line for line in parser().format_help().splitlines() if line.strip().startswith(part))
    with pytest.raises(SystemExit):
        main([part, "--help"])
    assert whole.split()[1] in capsys.readouterr().out.split("positional arguments")[0].lower()


def test_without_the_viewer_a_review_says_what_to_install(
    saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(reviewing.importlib.util, "find_spec", lambda _: None)
    assert main(["review", str(saved)]) == 1
    assert capsys.readouterr().err == "pzcap: the viewer is not installed; pip install 'pzcap[rerun]'\n"


def test_the_doctor_names_what_is_missing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"numpy +2\.\d", said)
    assert all(re.search(rf"^  {name} ", said, re.M) for name in FORMATS)
    find = doctor.importlib.util.find_spec
    for gone, status, says in (
        ("ezc3d", 0, r"ezc3d +missing +pzcap export --to c3d; pip install 'pzcap\[export\]'"),
        ("av", 1, r"av +MISSING +video; pip install pzcap"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(
                doctor.importlib.util, "find_spec", lambda name, gone=gone: None if name == gone else find(name)
            )
            assert main(["doctor"]) == status
        assert re.search(says, capsys.readouterr().out)


def test_every_library_of_a_format_is_one_the_doctor_knows() -> None:
    known = {part.package for part in doctor.PARTS}
    assert {form.library for form in FORMATS.values()} - {None} <= known


def test_it_runs_without_simulator_and_frameworks(saved: Path, tmp_path: Path) -> None:
    """As after `pip install pzcap` alone."""
    gone = (
        "mujoco",
        "hydra",
        "omegaconf",
        "cattrs",
        "rich",
        "matplotlib",
        "jinja2",
        "rerun",
        "ezc3d",
        "pxr",
        "pygltflib",
        "aiohttp",
    )
    script = (
        f"import sys\nfor name in {gone}: sys.modules[name] = None\n"
        "from pzcap.command.main import main\n"
        f"assert main(['export', {str(saved)!r}, '--to', 'bvh', 'colmap', 'freed', '--out', {str(tmp_path)!r}]) == 0\n"
        f"assert main(['export', {str(saved)!r}, '--to', 'usd', '--out', {str(tmp_path)!r}]) == 1\n"
        f"assert main(['edit', {str(saved)!r}]) == 1\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == (
        "pzcap: bvh: centimetres, y up; Blender: Scale 0.01\n"
        "pzcap: colmap: metres, z up\n"
        "pzcap: freed: z up\n"
        "pzcap: USD is written by the package usd-core, which is not installed; pip install 'pzcap[export]'\n"
        "pzcap: the editor's server is not installed; pip install 'pzcap[editor]'\n"
    )


def test_a_reader_that_has_had_enough_is_no_error() -> None:
    line = f"{sys.executable} -m pzcap.command doctor | head -n 1"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", line], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr == ""


def test_progress_is_one_line_on_a_terminal_and_a_few_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    import io

    from pzcap.command import progress

    clock = iter(range(0, 1000, 4))
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(clock)))
    terminal, file = io.StringIO(), io.StringIO()
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    with ProgressLine(terminal) as line:
        line.update("camera 1: a long stage", 1, 3)
        line.update("motion", 2, 0)
    drawn = terminal.getvalue()
    assert "\n" not in drawn
    assert "[##########....................] 1/3 camera 1: a long stage" in drawn
    assert drawn.endswith("\r")
    with ProgressLine(file) as line:
        for done in range(9):
            line.update("motion", done, 9)
    assert len(file.getvalue().splitlines()) == 3
    assert json.dumps(file.getvalue().splitlines()[0]).endswith('motion 2/9"')


def test_a_summary_without_a_body() -> None:
    from pzcap.command.reconstructing import summary

    lines = list(summary(fabricated.without_a_camera(fabricated.reconstruction())))
    assert lines[2] == "  camera 2: not calibrated"
    assert "  body: not tracked" in lines
    assert lines[-1] == "  note: camera 2: no motion video"


def test_streams_that_are_closed_end_no_command(tmp_path: Path) -> None:
    """And no file that is opened takes their place, where libraries print."""
    look = "import os, sys; from pzcap.command.main import main; main(['check', 'x']); "
    look += "f = open(sys.argv[1], 'w'); assert f.fileno() > 2; print('out'); os.write(1, b'native'); f.write('whole')"
    line = ["sh", "-c", '"$1" -c "$2" "$3" <&- >&- 2>&-', "sh", sys.executable, look, str(tmp_path / "file")]
    assert subprocess.run(line, check=False).returncode == 0
    assert (tmp_path / "file").read_text() == "whole"


def test_it_says_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out == f"pzcap {metadata.version('pzcap')}\n"


def test_asked_to_end_it_says_so_at_once() -> None:
    """While threads of its own are still at work, which it waits for."""
    code = (
        "import sys, time\nfrom concurrent.futures import ThreadPoolExecutor\nfrom pzcap.command import main as m\n"
        "def long(_):\n    with ThreadPoolExecutor(1) as pool:\n        print('began', flush=True)\n"
        "        pool.submit(time.sleep, 3.0).result()\n"
        "m._doctor = long\nsys.exit(m.main(['doctor']))\n"
    )
    line = [sys.executable, "-c", code]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.stderr.readline() == "\n"
        assert process.stderr.readline() == "pzcap: asked to end\n"
        assert process.poll() is None
        assert process.stderr.readline() == "pzcap: interrupted\n"
    assert process.returncode == 130
