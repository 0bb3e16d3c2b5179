"""A reviewer lands on the worst frame, of one run, of many, or of two side by side."""

from __future__ import annotations

import subprocess
import sysconfig
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from experiments import review
from experiments.config import default_tree
from experiments.metrics import run_info
from experiments.report import bookmarks, recording
from pzcap.events import FrameLocalised
from pzcap.io import results
from pzcap.scoring.metric import Metric
from pzcap.types import Array, CameraFiles, Capture, FrameSet, Localisation, PzcapError
from pzcap.viewer import columns, window
from pzcap.viewer.recording import Recorder
from tests.scenes import fabricated
from tests.scenes.viewer import needs_vulkan, screenshot

FRAMES = 40
GREEN, VIOLET = (60, 200, 40), (160, 20, 90)  # blue, green, red; a violet that the viewer and its cameras have not


def fabricate(run: Path, errors: dict[str, Array], worst: int | None = None) -> Path:
    """A run whose views are orange, in the frame ``worst`` green. ``errors``: entity -> (FRAMES,)."""
    whole = fabricated.reconstruction(frames=FRAMES)
    cameras = tuple(CameraFiles(name, None, None, None, None) for name in whole.camera_names)
    run.mkdir(parents=True)
    capture = Capture(run, "fabricated", Fraction(30), cameras, None, None, {}, full_turn=True)
    none = np.zeros((0, 2))
    found = Localisation(0.1, -0.07, 440.0, np.eye(2) * 1e-6, True, none, none)
    with Recorder(run / "recording.rrd", capture, name=run.name) as recorder:
        for frame in range(FRAMES):
            picture = np.full((fabricated.HEIGHT, fabricated.WIDTH, 3), GREEN if frame == worst else VIOLET, np.uint8)
            sets = FrameSet(frame, f"01:00:01:{frame:02d}", (picture,) * 4)
            recorder.event(FrameLocalised(sets, (found,) * 4))
        recording.finish(recorder, whole, None, None)
        for entity, values in errors.items():
            everywhere = np.ones(FRAMES, bool)
            columns.send_series(recorder.rec, entity, values, everywhere, (250, 250, 250), entity)
        recording.summarise(recorder, whole, [Metric("panzoom.lost", 0.0, "frames")], run_info(default_tree(), 0))
    results.save(whole, run / "reconstruction")
    return run


def peaks(level: float, **at: float) -> Array:
    """(FRAMES,) ``level`` everywhere but in the frames named f3=..., f17=..."""
    values = np.full(FRAMES, level)
    for name, value in at.items():
        values[int(name[1:])] = value
    return values


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    errors = {
        "/error/mpjpe": peaks(8.0, f25=90.0, f26=80.0, f3=40.0),
        "/error/pan/1": peaks(0.001, f12=-0.0125),
        "/error/pan/2": peaks(0.001, f30=0.006),
        "/error/iou/1": peaks(0.95, f7=0.5),
    }
    return fabricate(tmp_path_factory.mktemp("runs") / "first", errors, worst=25)


def logged(path: Path) -> list[tuple[int, str]]:
    """(frame, text) of the bookmarks in a file."""
    (chunk,) = RrdReader(path).store().stream().filter(content="/review/worst", components="TextLog:text").to_chunks()
    batch = chunk.to_record_batch()
    return list(zip(batch["frame"].to_pylist(), (text[0] for text in batch["TextLog:text"].to_pylist()), strict=True))


def entities(path: Path) -> set[str]:
    return {str(chunk.entity_path) for chunk in RrdReader(path).store().stream().to_chunks()}


def test_the_worst_frames_are_found_by_each_metric_and_their_neighbours_are_not(run: Path) -> None:
    marks = bookmarks.worst(bookmarks.errors(run / "recording.rrd"))
    assert [(mark.frame, mark.text) for mark in marks[:4]] == [
        (25, "joints: 90 mm (9.0x)"),
        (7, "silhouette IoU, camera 1: 0.5 (7.1x)"),
        (12, "pan, camera 1: -0.0125 deg (4.2x)"),
        (3, "joints: 40 mm (4.0x)"),
    ]
    joints = [mark.frame for mark in marks if mark.kind.what == "joints"]
    assert 26 not in joints
    assert [(mark.frame, mark.camera) for mark in marks if mark.kind.what == "pan"][:2] == [(12, "1"), (30, "2")]
    assert all(len([mark for mark in marks if mark.kind == kind]) in (0, 3) for kind in bookmarks.KINDS)


def test_a_review_is_the_recording_and_its_bookmarks(run: Path) -> None:
    found = review.review(run)
    program = Path(sysconfig.get_path("scripts")) / "rerun"
    subprocess.run([program, "rrd", "verify", found.path], check=True, capture_output=True)
    assert entities(found.path) == entities(run / "recording.rrd") | {"/review/worst", "/review/page"}
    assert (25, "joints: 90 mm (9.0x)") in logged(found.path)
    assert [frame for frame, _ in logged(found.path)] == sorted(mark.frame for mark in found.marks)
    ids = [RrdReader(path).recordings()[0].recording_id for path in (found.path, run / "recording.rrd")]
    assert ids[0] != ids[1]
    assert found.marks[0].frame == 25


def test_of_a_study_the_worst_runs_are_opened_the_worst_one_first(tmp_path: Path) -> None:
    for name, worst in (("a", 20.0), ("b", 90.0), ("c", 50.0), ("d", 5.0), (".e.partial", 500.0)):
        fabricate(tmp_path / name, {"/error/mpjpe": peaks(1.0, f9=worst)})
    assert [one.title for one in review.reviews([tmp_path])] == ["b", "c", "a"]
    with pytest.raises(PzcapError, match="give the folder of one job"):
        review.reviews([tmp_path / "a", tmp_path])


def test_a_damaged_run_of_a_study_costs_that_one(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name, worst in (("a", 20.0), ("b", 90.0), ("c", 50.0)):
        fabricate(tmp_path / name, {"/error/mpjpe": peaks(1.0, f9=worst)})
    recording = tmp_path / "b" / "recording.rrd"
    recording.write_bytes(recording.read_bytes()[:-3000])
    (tmp_path / "c" / "reconstruction" / "reconstruction.json").write_text("{")
    assert [one.title for one in review.reviews([tmp_path])] == ["a"]
    lines = capfd.readouterr().err.splitlines()
    assert [line.split(": ")[1] for line in lines] == [
        str(recording), str(tmp_path / "c" / "reconstruction" / "reconstruction.json")
    ]  # fmt: skip
    with pytest.raises(PzcapError, match="damaged") as caught:
        review.reviews([tmp_path / "a", tmp_path / "b"])
    assert str(recording) in str(caught.value)


def test_two_runs_are_one_recording_that_says_where_they_differ(run: Path, tmp_path: Path) -> None:
    errors = {"/error/mpjpe": peaks(8.0, f25=90.0, f38=30.0), "/error/pan/1": peaks(0.001)}
    other = fabricate(tmp_path / "second", errors)
    (found,) = review.reviews([run, other])
    assert found.path == run / "comparison.rrd"
    assert [(mark.frame, mark.text) for mark in found.marks[:4]] == [
        (26, "joints: -72 mm (7.2x)"),
        (12, "pan, camera 1: -0.0115 deg (3.8x)"),
        (3, "joints: -32 mm (3.2x)"),
        (38, "joints: 22 mm (2.2x)"),
    ]
    there = entities(found.path)
    assert {"/error/mpjpe", "/other/error/mpjpe", "/other/world/camera/2/view/image"} <= there
    assert not any(path.startswith(("/other/__properties", "/other/truth")) for path in there)


def test_jobs_are_told_apart_by_what_differs() -> None:
    names = "noise=0,seed=1,width=320-abc", "noise=4,seed=1,width=320-def"
    assert review.told_apart(*names) == ("noise=0,width=320-abc", "noise=4,width=320-def")
    assert review.told_apart("demo", "other") == ("demo", "other")
    assert review.told_apart("demo", "demo") == ("demo", "demo")


def test_without_truth_there_is_nothing_to_bookmark(tmp_path: Path) -> None:
    found = review.review(fabricate(tmp_path / "run", {}))
    assert found.marks == ()
    assert "/review/page" in entities(found.path)


def test_a_folder_without_a_recording_gets_one_line(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=r"no recording\.rrd in it"):
        review.reviews([tmp_path])


def test_a_viewer_that_ends_at_once_gets_one_line(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As it does where there is no driver to draw with."""

    class Gone:
        def open(self, _: str) -> None:
            raise ConnectionError("transport error")

    monkeypatch.setattr(window, "_connected", lambda *_: Gone())
    with pytest.raises(PzcapError, match="the viewer does not start here"):
        window.show([review.review(run).place], headless=True)


@pytest.mark.slow
@needs_vulkan
def test_the_viewer_stands_at_the_worst_frame(run: Path) -> None:
    pixels, state = screenshot(review.review(run))
    assert state.recordings[0].current_time == 25
    assert not [view for view in state.views if view.reports]
    green, violet = (np.abs(pixels.astype(int) - colour).max(axis=2) < 30 for colour in (GREEN, VIOLET))
    assert green.sum() > 50_000  # the four views of that frame, as the layout for tracking shows them
    assert violet.sum() < 500
