"""Poses that tracking starts from: what is there, what is found, and what is said where neither is."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from experiments.footage import SMALL
from pzcap import starting_poses
from pzcap.events import FrameLocalised, Progress
from pzcap.io.capture import FrameSets, frame_sets, read_capture
from pzcap.pipeline import Config, reconstruct
from pzcap.starting_poses import body_to_track, body_tracker
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.tuning import PREDICTION_SIGMA
from pzcap.types import Camera, Capture, FrameSet, Keyframe, Localisation
from sim.people.crew import CrewConfig
from sim.people.detector import DetectorConfig
from tests.scenes.captures import shot

CONFIG = TrackingConfig()


class Nowhere:
    """No frame of the calibrated cameras is located."""

    def __init__(self, calibrated: int = 4) -> None:
        self.restarted = False
        self.localisers = [*(object() for _ in range(calibrated)), *(None for _ in range(4 - calibrated))]

    def __call__(self, frames: FrameSet, _: object) -> FrameLocalised:
        return FrameLocalised(frames, (None,) * len(frames.images))

    def restart(self) -> None:
        self.restarted = True

    def as_found(self, frames: FrameSet, found: tuple[Localisation | None, ...]) -> FrameLocalised:
        return FrameLocalised(frames, found)

    def cameras(self, found: Sequence[Localisation | None]) -> tuple[Camera | None, ...]:
        return (None,) * len(found)


def ended(steps: Generator[Progress, None, Any]) -> tuple[list[Progress], Any]:
    told = []
    while True:
        try:
            told.append(next(steps))
        except StopIteration as end:
            return told, end.value


@pytest.fixture
def capture(small_capture: Path) -> Capture:
    return read_capture(small_capture / "capture")


@pytest.fixture
def sets(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> FrameSets:
    """The capture's frames without keyframes, in which a detector has found nobody."""
    found = frame_sets(replace(capture, keyframe_poses={}))
    nobody = tuple(starting_poses.NOBODY for _ in capture.cameras)
    monkeypatch.setattr(found, "people", lambda _: nobody)
    return found


def test_neither_keyframes_nor_keypoints_is_one_line_that_says_what_to_do(capture: Capture) -> None:
    bare = replace(capture, keyframe_poses={})
    notes: list[str] = []
    assert body_to_track(bare, frame_sets(bare), CONFIG, notes) is None
    (note,) = notes
    assert "neither keyframes" in note
    assert "pzcap keypoints" in note
    assert "\n" not in note


def test_keypoints_alone_do_unless_they_are_switched_off(capture: Capture, sets: FrameSets) -> None:
    first, *others = capture.cameras
    detected = replace(capture, cameras=(replace(first, keypoints=Path("somewhere")), *others), keyframe_poses={})
    assert body_to_track(detected, sets, CONFIG, []) is not None
    assert body_to_track(detected, sets, replace(CONFIG, keypoint_keyframes=False), []) is None


@pytest.mark.parametrize(
    ("calibrated", "reason"),
    [
        (4, "in no frame"),
        (1, "two calibrated cameras, and there is 1"),
        (0, "two calibrated cameras, and there is none"),
    ],
)
def test_keypoints_that_do_not_serve_are_said_not_to(
    capture: Capture, sets: FrameSets, calibrated: int, reason: str
) -> None:
    body = body_to_track(capture, frame_sets(capture), CONFIG, [])
    assert body is not None
    localise, notes = Nowhere(calibrated), list[str]()

    def segment(*_: object) -> Any:
        raise AssertionError("no frame is looked at")

    told, tracker = ended(body_tracker(body, capture, sets, localise, segment, CONFIG, notes))
    assert tracker is None
    assert localise.restarted
    assert [each.done for each in told] == list(range(1, len(sets) + 1))
    assert len(notes) == 1
    assert reason in notes[0]


def test_what_is_found_joins_what_a_hand_has_set(
    capture: Capture, sets: FrameSets, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = body_to_track(capture, frame_sets(capture), CONFIG, [])
    assert body is not None
    by_hand = frame_sets(capture).keyframes[0]
    sets.keyframes = (by_hand,)
    other = Keyframe(by_hand.frame + 1, by_hand.pose, PREDICTION_SIGMA[:, None] * PREDICTION_SIGMA)
    monkeypatch.setattr(starting_poses, "worthwhile", lambda *_: True)
    monkeypatch.setattr(starting_poses, "find_keyframes", lambda *_: [other])
    notes: list[str] = []
    _, tracker = ended(body_tracker(body, capture, sets, Nowhere(), SimpleNamespace, CONFIG, notes))  # type: ignore[arg-type]
    assert sorted(tracker._keys) == [by_hand.frame, other.frame]
    assert f"{other.frame} ({sets.timecodes[other.frame]})" in notes[0]


@pytest.mark.heavy
def test_a_capture_that_nobody_posed_is_tracked() -> None:
    nobody = CrewConfig(keyframes="none")
    capture = read_capture(shot(replace(SMALL, crew=nobody, detector=DetectorConfig(enabled=True))) / "capture")
    assert not capture.keyframe_poses
    result = reconstruct(capture, Config())
    assert result.motion is not None
    assert result.motion.valid.all()
    assert not len(result.motion.keyframes)
    assert any("keyframes found in the keypoints" in note for note in result.notes)
