"""Keyframes: what contradicts itself is said, and what cannot be used is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.tracking import keyframes
from pzcap.types import SEGMENTS, Keyframe, Pose, PzcapError
from tests.scenes.bodies import BODY


def standing(x: float = 0.0) -> Pose:
    return Pose(np.array([x, 0.0, 0.95]), np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1)))


def turned(name: str, vector: tuple[float, float, float]) -> Pose:
    rotations = standing().rotations.copy()
    rotations[SEGMENTS.index(name)] = Rotation.from_rotvec(vector).as_quat(scalar_first=True)
    return Pose(standing().root_position_m, rotations)


def test_sound_keyframes_raise_no_note() -> None:
    assert keyframes.check([Keyframe(0, standing()), Keyframe(30, standing(1.0))], BODY, 31) == ()


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (turned("left_shank", (0.0, -1.0, 0.0)), "left_shank is"),
        (turned("right_forearm", (0.9, 0.0, 0.0)), "right_forearm turns by"),
        (Pose(np.array([0.0, 0.0, 0.3]), standing().rotations), "below the floor"),
    ],
)
def test_a_contradiction_is_noted(pose: Pose, words: str) -> None:
    notes = keyframes.check([Keyframe(4, pose)], BODY, 10)
    assert any(words in note and "keyframe 4" in note for note in notes), notes


def test_a_pelvis_that_jumps_is_noted() -> None:
    notes = keyframes.check([Keyframe(0, standing()), Keyframe(3, standing(4.0))], BODY)
    assert len(notes) == 1
    assert "0 and 3" in notes[0]


@pytest.mark.parametrize(("frame_rate", "noted"), [(10.0, False), (30.0, True), (120.0, True)])
def test_how_far_a_runner_comes_in_a_frame_depends_on_the_frame_rate(frame_rate: float, noted: bool) -> None:
    keys = [Keyframe(0, standing()), Keyframe(2, standing(1.6))]
    assert bool(keyframes.check(keys, BODY, frame_rate=frame_rate)) == noted


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ([], "there are none"),
        ([Keyframe(2, standing()), Keyframe(2, standing())], "posed twice"),
        ([Keyframe(99, standing())], "none lies within"),
        ([Keyframe(0, Pose(np.array([np.nan, 0, 0]), standing().rotations))], "not finite"),
        ([Keyframe(0, Pose(np.zeros(3), 2 * standing().rotations))], "unit length"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(keys: list[Keyframe], words: str) -> None:
    with pytest.raises(PzcapError, match=words) as caught:
        keyframes.check(keys, BODY, 10)
    assert "\n" not in str(caught.value)
