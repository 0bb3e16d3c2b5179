"""Faults that are put into a capture, and what is counted of what is said about them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from experiments.comparisons import wrong_footage as wrong
from experiments.comparisons.wrong_footage import FAULTS, WrongFootageConfig
from experiments.progress import Bars
from pzcap.io.capture import frame_sets, read_capture
from pzcap.io.video import VideoReader
from pzcap.types import Capture, PzcapError
from tests.scenes.fabricated import reconstruction

pytestmark = pytest.mark.xdist_group("experiments")
BY_KEY = {fault.key: fault for fault in FAULTS}


@pytest.fixture(scope="module")
def capture(small_capture: Path) -> Capture:
    return read_capture(small_capture / "capture")


def test_frames_are_lost_and_the_recording_closed_up(capture: Capture, tmp_path: Path) -> None:
    changed = BY_KEY["lost_frames"].change(capture, tmp_path)
    before, after = capture.cameras[0].motion, changed.cameras[0].motion
    assert before is not None
    assert after is not None
    one, other = VideoReader(before), VideoReader(after)
    assert other.frame_count == one.frame_count - 3
    assert other.timecode == one.timecode
    middle = one.frame_count // 2
    [(_, expected)], [(_, found)] = one.read(middle + 3, middle + 4), other.read(middle, middle + 1)
    assert np.abs(expected.astype(float) - found).mean() < 3.0
    assert changed.cameras[1:] == capture.cameras[1:]


def test_pictures_are_shown_twice(capture: Capture, tmp_path: Path) -> None:
    before, after = capture.cameras[0].motion, wrong.with_pictures_twice(3)(capture, tmp_path).cameras[0].motion
    assert before is not None
    assert after is not None
    usual, twice = ([image.astype(float) for _, image in VideoReader(path)] for path in (before, after))
    assert len(twice) == len(usual)
    for number, image in enumerate(twice):
        assert np.abs(image - usual[number - (number % 3 == 2)]).mean() < 3.0


def test_a_clock_is_off(capture: Capture, tmp_path: Path) -> None:
    changed = BY_KEY["late_clock"].change(capture, tmp_path)
    usual, late = frame_sets(capture), frame_sets(changed)
    for number, timecode in enumerate(late.timecodes):
        picture, before = late.pictures(0)[number], usual.pictures(0)[usual.timecodes.index(timecode)]
        assert picture is not None
        assert before == picture + 1


@pytest.mark.parametrize("key", [fault.key for fault in FAULTS if fault.key != "right"])
def test_a_fault_changes_the_capture(key: str, capture: Capture, tmp_path: Path) -> None:
    assert BY_KEY[key].change(capture, tmp_path) is not capture


def test_what_right_footage_does_not_raise_is_counted(
    capture: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usual = replace(reconstruction(), motion=None, notes=("camera 2: its shutter rolls: 16.1 ms",))
    said = (
        "camera 2: its shutter rolls: 15.9 ms",
        "camera 1: from frame 4 (00:00:01:00) on its pictures show the athlete 1 frame later than before, against the "
        "other cameras: 1 frame lost there, and the recording closed up",
    )
    monkeypatch.setattr(wrong, "reconstruct", lambda *_: replace(usual, notes=said))
    truth: Any = None
    with Bars(Console(quiet=True)) as bars:
        arguments = capture, truth, usual, WrongFootageConfig(), tmp_path, bars
        figures, notes = wrong._tried(BY_KEY["lost_frame"], *arguments)
        assert notes == [said[1]]
        assert figures == {"notes": 1.0, "named": 1.0}
        assert wrong._tried(BY_KEY["lost_frames"], *arguments)[0]["named"] == 0.0
        assert wrong._tried(BY_KEY["right"], *arguments)[0] == {"notes": 1.0}

    def refused(*_: object) -> None:
        raise PzcapError("camera 2: sweep.mp4: shows nothing of it: it is another camera's, or was shot elsewhere")

    monkeypatch.setattr(wrong, "reconstruct", refused)
    with Bars(Console(quiet=True)) as bars:
        figures, _ = wrong._tried(BY_KEY["another_sweep"], capture, truth, usual, WrongFootageConfig(), tmp_path, bars)
    assert figures == {"notes": 1.0, "named": 1.0}


def test_a_fault_that_there_is_not_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=re.escape("no fault 'fire'; one of right, lost_frame")):
        list(wrong.compare(WrongFootageConfig(faults=("fire",)), tmp_path, Console(quiet=True)))
