"""One whole run on a small shoot, as a user starts it, and what it leaves behind."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from experiments import review
from experiments.metrics import read_metrics
from experiments.report import bookmarks
from pzcap.io import results
from pzcap.types import Image
from tests.scenes.viewer import likeness, needs_vulkan, screenshot

pytestmark = pytest.mark.xdist_group("experiments")
DEMO = Path(__file__).parents[2] / "outputs" / "demo"


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "experiments.run", *arguments], capture_output=True, text=True)


def test_it_ends_with_a_table(finished: tuple[Path, str]) -> None:
    assert "panzoom.pan.rms" in finished[1]
    assert "report.html" in finished[1]


def test_it_leaves_everything_that_it_promises(finished: tuple[Path, str], small_capture: Path) -> None:
    folder = finished[0]
    names = {path.name for path in folder.iterdir()} - {".hydra"}
    assert names == {"metrics.json", "recording.rrd", "report.html", "reconstruction", "capture"}
    assert (folder / "capture").resolve() == (small_capture / "capture").resolve()


def test_the_metrics_have_a_value_or_none(finished: tuple[Path, str]) -> None:
    found, run = read_metrics(finished[0] / "metrics.json")
    values = {metric.key: metric.value for metric in found}
    assert {"speed.fps", "speed.compiling", "speed.log_share", "panzoom.pan.rms", "panzoom.nees"} <= set(values)
    assert "memory.peak" in values
    assert all(value is None or np.isfinite(value) for value in values.values())
    assert run["seed"] == 0
    assert run["config"]["shoot"]["sensor"]["read_noise"] == 2.0


def test_the_recording_verifies_and_holds_the_same_numbers(finished: tuple[Path, str]) -> None:
    path = finished[0] / "recording.rrd"
    subprocess.run(
        [Path(sysconfig.get_path("scripts")) / "rerun", "rrd", "verify", path], check=True, capture_output=True
    )
    (chunk,) = RrdReader(path).store().stream().filter(content="/__properties/metrics").to_chunks()
    batch = chunk.to_record_batch()
    for metric in read_metrics(finished[0] / "metrics.json")[0]:
        if metric.value is not None:
            assert batch[metric.key].to_pylist() == [[metric.value]], metric.key


def test_the_recording_holds_truth_and_errors(finished: tuple[Path, str]) -> None:
    paths = {str(chunk.entity_path) for chunk in RrdReader(finished[0] / "recording.rrd").store().stream().to_chunks()}
    assert {
        "/truth/camera/2/view", "/truth/body/skeleton", "/truth/track/pan/2", "/error/pan/2", "/error/focal/2",
        "/error/mpjpe", "/error/joint/neck", "/phase/airborne", "/summary", "/world/body/skin/pelvis",
        "/reference/1/wireframe", "/panorama/1/image",
    } <= paths  # fmt: skip


def test_the_report_needs_nothing_else(finished: tuple[Path, str]) -> None:
    page = (finished[0] / "report.html").read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "<script" not in page
    for heading in ("Cameras", "Pan and zoom", "Views", "Body", "All numbers", "The run"):
        assert heading in page
    assert page.count("<svg") >= 4
    assert page.count("data:image/jpeg") >= 12
    assert "nan" not in re.sub(r'"data:[^"]*"', "", page).lower()


def test_the_reconstruction_loads(finished: tuple[Path, str]) -> None:
    whole = results.load(finished[0] / "reconstruction")
    assert len(whole.timecodes) == 8
    assert whole.method == "exact"


def filmed(recording: Path, camera: str) -> dict[int, Image]:
    """Frame -> image of a camera, as the recording holds them."""
    stream = RrdReader(recording).store().stream().filter(content=f"/world/camera/{camera}/view/image")
    found = {}
    for batch in (chunk.to_record_batch() for chunk in stream.to_chunks()):
        if "EncodedImage:blob" in batch.schema.names:
            for frame, blob in zip(batch["frame"].to_pylist(), batch["EncodedImage:blob"].to_pylist(), strict=True):
                image = cv2.imdecode(np.array(blob[0], np.uint8), cv2.IMREAD_COLOR)
                assert image is not None
                found[frame] = np.asarray(image, np.uint8)
    return found


@pytest.mark.slow
@needs_vulkan
def test_the_viewer_shows_the_demos_recording(request: pytest.FixtureRequest) -> None:
    """At its worst frame: of the demo where there is one, else of a small run."""
    run = DEMO if (DEMO / review.RECORDING).is_file() else request.getfixturevalue("finished")[0]
    path = run / review.RECORDING
    marks = tuple(bookmarks.worst(bookmarks.errors(path)))
    pixels, state = screenshot(review.Review(path, "as it was recorded", marks))
    worst = marks[0].frame
    assert state.recordings[0].current_time == worst
    assert not [view for view in state.views if view.reports]
    images = filmed(path, "1")
    far = max(images, key=lambda frame: abs(frame - worst))
    assert likeness(pixels, images[worst]) > max(0.8, likeness(pixels, images[far]))


def test_footage_inside_the_runs_own_folder_survives(small_capture: Path, tmp_path: Path) -> None:
    shutil.copytree(small_capture / "capture", tmp_path / "capture")
    (tmp_path / "capture" / "object.json").unlink()
    (tmp_path / "metrics.json").write_text("{}")
    done = command(f"capture={tmp_path / 'capture'}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "object.json" in done.stderr
    assert (tmp_path / "capture" / "capture.json").is_file()
    assert not (tmp_path / "metrics.json").exists()


def test_without_truth_subject_and_a_sweep_it_runs_and_says_what_it_left_out(
    small_capture: Path, finished: tuple[Path, str], tmp_path: Path
) -> None:
    """The other cameras are those of a finished run."""
    footage = tmp_path / "footage"
    shutil.copytree(small_capture / "capture", footage)
    manifest = json.loads((footage / "capture.json").read_text())
    manifest["subject"] = None
    manifest["cameras"][0] |= {"name": "new", "sweep": None}
    (footage / "capture.json").write_text(json.dumps(manifest))
    given = f"capture={footage}", f"cameras={finished[0]}", "output.recording=false"
    done = command(*given, f"hydra.run.dir={tmp_path / 'run'}")
    assert done.returncode == 0, done.stderr
    found, _ = read_metrics(tmp_path / "run" / "metrics.json")
    assert {metric.key.partition(".")[0] for metric in found} == {"speed", "memory"}
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Not scored" in page
    assert "Views located" in page
    assert "Standard deviation claimed, median." in page
    assert "missed" not in page.partition('id="numbers"')[0]
    assert "What was found or left out" in page
    assert "camera new" in page
    assert not (tmp_path / "run" / "recording.rrd").exists()
