"""`pzcap check`: right footage passes, and what is wrong with other footage is named, at the camera that has it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from pzcap.command.check.findings import Finding, Level
from pzcap.command.check.run import _empty_hall
from pzcap.command.check.sweep_check import Sweep, _bare, _level, check_sweep
from pzcap.command.main import main
from pzcap.io.capture import read_capture
from pzcap.types import Capture, Image
from tests.scenes import wrong_footage as wrong

LEVELLED = "lock the tilt, level the pan axis"


def check(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    """The exit status, and the lines that are not ok."""
    status = main(["check", str(folder), "--page", str(folder.parent / "check.html")])
    said = capsys.readouterr()
    assert "pzcap: " not in said.err, said.err  # an error ends it before it has found anything
    lines = said.out.splitlines()
    return status, [line for line in lines[:-1] if not line.startswith("ok")]


@pytest.fixture(scope="module")
def usual() -> list[str]:
    """What there is to say about right footage: it is little and short."""
    return [
        r"sync: 8 frame sets in common, 0\.3 s",
        *(r"camera \d reference: its markers are 15 px wide",) * 2,
        *(r"camera \d sweep: covers 8\d degrees \(120 or more is good\)",) * 2,
        *(r"camera \d zoom: has 8 frames; 15 or more",) * 2,
        r"camera 2 forecast: pan to 0\.\d+ degrees, .*; limited by a sweep of 8\d degrees",
    ]


def unusual(lines: list[str], usual: list[str]) -> list[str]:
    return [line for line in lines if not any(re.search(pattern, line) for pattern in usual)]


def test_right_footage_passes(
    small_capture: Path, usual: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, lines = check(wrong.linked(small_capture / "capture", tmp_path / "c"), capsys)
    assert status == 0
    assert len(lines) == len(usual)
    assert unusual(lines, usual) == []
    page = (tmp_path / "check.html").read_text()
    assert page.count("<img") == 6
    assert "It can be worked with" in page
    assert "http" not in page


@pytest.mark.parametrize(
    ("change", "status", "says"),
    [
        (
            wrong.swap("motion.mp4"),
            1,
            ["camera 1 motion: fits the sweep of camera 2", "camera 2 motion: fits the sweep"],
        ),
        (
            wrong.swap("sweep.mp4"),
            1,
            ["camera 1 reference: fits the sweep of camera 2", "camera 2 motion: fits the sweep"],
        ),
        (wrong.swap("reference.png"), 1, ["camera 1 reference: fits the sweep of camera 2"]),
        (
            wrong.swap("zoom.mp4"),
            1,
            ["camera 1 zoom: fits the sweep of camera 2", "camera 2 zoom: fits the sweep of camera 1"],
        ),
        (wrong.drawn("motion.mp4", wrong.mirror), 1, ["camera 1 motion: is mirrored against the sweep"]),
        (wrong.drawn("motion.mp4", wrong.upside_down), 1, [r"camera 1 motion: stands turned by 1\d\d degrees"]),
        (
            wrong.drawn("motion.mp4", wrong.lower(8)),
            0,
            [r"camera 1 motion: looks 0\.\d+ degrees higher than the sweep"],
        ),
        (
            wrong.drawn("motion.mp4", wrong.brighter(0.3)),
            0,
            [r"camera 1 motion: is 0\.\d times as bright as the sweep"],
        ),
        (wrong.drawn("reference.png", wrong.mirror), 1, ["camera 1 reference: it is mirrored: 1. markers"]),
        (
            wrong.drawn("reference.png", wrong.upside_down),
            1,
            [r"camera 1 reference: the picture stands turned by -?1\d\d"],
        ),
        (wrong.drawn("sweep.mp4", wrong.flickering(0.06)), 0, [r"camera 1 sweep: flickers by \d\.\d %.*1/50"]),
        (wrong.drawn("sweep.mp4", wrong.brighter(1.6)), 0, [r"camera 1 sweep: \d+ % of it is burnt out"]),
        (wrong.manifest(full_turn=True), 1, ["camera 1 sweep: covers 8. degrees and does not come round to its start"]),
        (wrong.manifest(object=None), 1, ["object: no calibration object"]),
        (wrong.manifest(subject=None), 0, ["subject: no tape measurements"]),
        (wrong.misread("forearm", 0.1), 0, [r"subject: subject\.json: forearm is 0\.\d+, where .* measure it again"]),
        (wrong.manifest(keyframes=None), 0, ["keyframes: there are none yet"]),
        (wrong.without("sweep"), 1, ["camera 1 sweep: there is none; no frame can be located"]),
        (wrong.without("zoom"), 0, ["camera 1 zoom: there is none; distortion"]),
        (
            wrong.other_object,
            1,
            [r"camera 1 reference: corners agree with the object to \d+\.\d+ px; is object.json of this"],
        ),
        (
            wrong.of_another("sweep.mp4"),
            1,
            ["camera 1 reference: fits the sweep of camera 2|camera 1 motion: its pictures"],
        ),
        (
            wrong.drawn("sweep.mp4", wrong.lower(10)),
            1,
            [r"camera 1 motion: looks 1\.\d+ degrees lower than the sweep", r"camera 1 reference: looks .* settled"],
        ),
        (
            wrong.drawn("reference.png", wrong.longer(1.2)),
            1,
            [r"camera 1 sweep: was filmed at 0\.8\d times the focal length of the reference image"],
        ),
        (wrong.drawn("reference.png", wrong.once_more(6)), 0, ["camera 1 reference: marker 6 is seen more than once"]),
        (wrong.other_size(1.2), 1, [r"subject: the athlete looks|keyframes: the athlete stands \d\.\d body heights"]),
        (
            wrong.other_person(0.88),
            0,
            [r"subject: the athlete looks 1\.1\d times as large as subject\.json makes them"],
        ),
        (
            wrong.other_person(1.15),
            0,
            [r"subject: the athlete looks 0\.8\d times as large as subject\.json makes them"],
        ),
    ],
)
@pytest.mark.heavy
def test_wrong_footage_is_named(
    change: wrong.Change, status: int, says: list[str], small_capture: Path, usual: list[str], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    folder = wrong.linked(small_capture / "capture", tmp_path / "c")
    change(folder)
    found, lines = check(folder, capsys)
    named = unusual(lines, usual)
    for pattern in says:
        assert any(re.search(pattern, line) for line in named), "\n".join(named)
    assert found == status, "\n".join(named)


def test_what_cannot_be_read_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert "no such file" in said.err or "capture.json" in said.err
    assert said.err.count("\n") == 1


def test_a_camera_that_leans_does_not_rise_and_one_that_tilts_does() -> None:
    """A lean of half a degree moves the picture by three degrees in a full turn, and evenly."""
    angles = np.deg2rad(np.linspace(0.0, 368.0, 185))
    sweep = Sweep(1.4, angles, (), np.empty(0), (), 100.0)
    leaning = 1.4 * np.diff(angles) * np.deg2rad(0.5)
    assert list(_level(sweep, leaning, 0.0)) == []
    tilted = leaning + 1.4 * np.deg2rad(4.0) * np.diff(np.sin(angles) ** 2)  # up, down, up and down again
    assert [text for _, text in _level(sweep, tilted, 0.0)] == ["rises or falls by 4.0 degrees; " + LEVELLED]
    assert [text for _, text in _level(sweep, leaning, 1.4 * np.deg2rad(3.5))] == [
        "rises or falls by 3.5 degrees; " + LEVELLED
    ]


def round_hall(focal: float) -> Image:
    """(120, W) noise on the wall of a round hall, as pictures 160 wide show it at ``focal`` widths."""
    width, height = 160, 120
    circle = round(2.0 * np.pi * focal * width)
    rng = np.random.default_rng(4)
    return np.asarray(cv2.resize(rng.integers(0, 255, (height // 4, circle // 4), dtype=np.uint8), (circle, height)))


def turned(path: Path, degrees: float, focal: float) -> Path:
    """A video of a camera that turns to the left by ``degrees`` at ``focal`` widths, a tenth of a picture a frame,
    in a round hall of noise."""
    wall = round_hall(focal)
    width, height, circle = 160, *wall.shape
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "10"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for k in range(round(degrees / 360.0 * circle / (width // 10))):
            picture = np.roll(wall, k * (width // 10), axis=1)[:, :width]
            shown = np.repeat(picture[:, :, None], 3, axis=2)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(shown), format="bgr24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("focal", [0.7, 1.6])
def test_a_circle_tells_the_focal_length_that_no_reference_image_does(focal: float, tmp_path: Path) -> None:
    sweep, found = check_sweep("1", turned(tmp_path / "sweep.mp4", 385.0, focal), None, full_turn=True)
    assert sweep.focal == pytest.approx(focal, rel=0.03)
    assert np.rad2deg(sweep.span_rad) == pytest.approx(385.0, rel=0.03)
    [said] = [each for each in found if "comes round" in each.text]
    assert said.level is Level.OK
    assert "reference" not in said.text


def test_a_sweep_at_another_zoom_than_the_reference_image_is_told(tmp_path: Path) -> None:
    _, found = check_sweep("1", turned(tmp_path / "sweep.mp4", 385.0, 1.0), 0.8, full_turn=True)
    [said] = [each for each in found if "comes round" in each.text]
    assert said.level is Level.FAIL
    assert "was the zoom ring moved" in said.text


@pytest.mark.parametrize(("times", "level"), [(1.25, Level.FAIL), (1.08, Level.WARN), (1.01, None)])
def test_a_zoom_ring_that_was_moved_is_told_by_the_picture(times: float, level: Level | None, tmp_path: Path) -> None:
    """The circle closes by the focal length at which it was filmed, not by that of the reference image."""
    still = round_hall(1.0)[:, 480:640]
    longer = cv2.warpAffine(still, cv2.getRotationMatrix2D((79.5, 59.5), 0.0, times), (160, 120))
    video = turned(tmp_path / "sweep.mp4", 385.0, 1.0)
    sweep, found = check_sweep("1", video, times, full_turn=True, reference=np.repeat(longer[..., None], 3, axis=2))
    assert sweep.focal == pytest.approx(1.0, rel=0.01)
    assert np.rad2deg(sweep.span_rad) == pytest.approx(385.0, rel=0.01)
    assert [each.level for each in found if "comes round" in each.text] == [Level.OK]
    told = [each for each in found if "times the focal length of the reference image" in each.text]
    assert [each.level for each in told] == [level] * (level is not None)


def test_only_an_object_needs_a_reference_image(small_capture: Path) -> None:
    capture = read_capture(small_capture / "capture")
    files = replace(capture.cameras[0], reference=None, sweep=None, zoom=None)

    def said(capture: Capture) -> list[Finding]:
        return [each for each in _empty_hall(capture, files).findings if each.subject == "reference"]

    assert [each.level for each in said(capture)] == [Level.FAIL]
    assert said(replace(capture, calibration_object=None)) == []


def test_frames_that_show_next_to_nothing_are_named() -> None:
    angles = np.deg2rad(np.arange(0.0, 60.0, 3.0))
    sweep = Sweep(0.7, -angles, (), np.zeros(0), (), 100.0)
    sure = np.full(len(angles) - 1, 0.9)
    assert list(_bare(sweep, sure)) == []
    sure[[2, 7, 8, 9]] = 0.2
    [(level, text)] = _bare(sweep, sure)
    assert level is Level.WARN
    assert "frames 7 to 10, 21 to 30 degrees on: a bare wall?" in text
