"""Advice on keyframes: one that the images contradict is named, a good one is not, and the next one is well placed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.body import kinematics
from pzcap.extras import keyframe_diagnostics
from pzcap.tracking import tracker
from pzcap.tracking.tuning import HAND_SIGMA
from pzcap.types import DOF, SEGMENTS, Array, Keyframe, Motion, Pose
from tests.scenes import tracked as rendered
from tests.scenes.bodies import BODY
from tests.scenes.body_scene import swing

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
FRAMES, RATE = 31, 30.0
KEYS = (0, 10, 20, 30)
TIMECODES = [f"10:00:00:{frame:02d}" for frame in range(FRAMES)]


def motion(sigma_m: Array | float = 0.01, keyframes: Sequence[int] = KEYS) -> Motion:
    """Somebody walks and swings the arms, as the images have it: each joint a few millimetres off."""
    rng = np.random.default_rng(0)
    poses = [kinematics.retract(swing(t / RATE), rng.normal(0.0, 0.005, DOF)) for t in range(FRAMES)]
    return Motion(
        np.stack([pose.root_position_m for pose in poses]),
        np.stack([pose.rotations for pose in poses]),
        np.stack([kinematics.joints(BODY, pose) for pose in poses]),
        np.broadcast_to(sigma_m, (FRAMES, 16)).astype(np.float64),
        np.array(keyframes, np.int64),
        np.ones(FRAMES, bool),
    )


def by_hand(frame: int, seed: int = 0, of: int | None = None) -> Keyframe:
    """The pose of frame ``of``, set by a hand that errs as stated."""
    error = np.random.default_rng(1000 * seed + frame).normal(0.0, HAND_SIGMA)
    return Keyframe(frame, kinematics.retract(swing((frame if of is None else of) / RATE), error))


def turned(key: Keyframe, segment: str, degrees: float) -> Keyframe:
    rotations = key.pose.rotations.copy()
    at = SEGMENTS.index(segment)
    turn = Rotation.from_rotvec([np.deg2rad(degrees), 0.0, 0.0])
    rotations[at] = (Rotation.from_quat(rotations[at], scalar_first=True) * turn).as_quat(scalar_first=True)
    return Keyframe(key.frame, Pose(key.pose.root_position_m, rotations))


def contradicted(keys: Sequence[Keyframe], of: Motion | None = None) -> tuple[keyframe_diagnostics.Contradiction, ...]:
    return keyframe_diagnostics.contradictions(motion() if of is None else of, keys, BODY)


def test_a_hand_that_errs_as_stated_is_hardly_ever_contradicted() -> None:
    found = [each for seed in range(10) for each in contradicted([by_hand(frame, seed) for frame in KEYS])]
    assert len(found) <= 1  # of 200 parts of the body, a thousandth of which may be


@pytest.mark.parametrize("frame", KEYS)
def test_an_arm_that_is_turned_is_named(frame: int) -> None:
    keys = [turned(by_hand(k), "left_upper_arm", -40.0) if k == frame else by_hand(k) for k in KEYS]
    (found,) = contradicted(keys)
    assert (found.frame, found.parts, found.like) == (frame, ("left arm",), None)
    assert found.off_m > 2 * found.sigma_m
    assert found.told(TIMECODES).startswith(f"keyframe {frame}: the images have its left arm ")


def test_a_leg_that_is_thrown_in_the_last_frame_contradicts_nothing() -> None:
    """Nothing is seen after it, and a line through the frames before it leads elsewhere."""
    thrown = motion()
    for frame, degrees in ((28, 2.0), (29, 12.0), (30, 42.0)):
        key = turned(Keyframe(frame, swing(frame / RATE)), "right_thigh", degrees)
        pose = turned(key, "right_thigh", 0.0).pose
        thrown.rotations[frame], thrown.joints_m[frame] = pose.rotations, kinematics.joints(BODY, pose)
    last = Keyframe(30, Pose(thrown.root_position_m[30], thrown.rotations[30]))
    assert contradicted([last], thrown) == ()
    [found] = contradicted([turned(last, "right_thigh", 70.0)], thrown)
    assert found.parts == ("right leg",)


@pytest.mark.parametrize("late", [-2, 2])
def test_a_pose_of_another_instant_is_told_which(late: int) -> None:
    (found,) = contradicted([by_hand(0), by_hand(10, of=10 + late)])
    assert found.frame == 10
    assert found.like is not None
    assert abs(found.like - (10 + late)) <= 1  # a hand's error is as large as what is moved in a frame
    assert f"check its timecode, {TIMECODES[found.like]} would do" in found.told(TIMECODES)


def test_what_the_images_do_not_tell_contradicts_nothing() -> None:
    keys = [by_hand(0), turned(by_hand(10), "left_upper_arm", -40.0)]
    unsure = np.full((FRAMES, 16), 0.01)
    unsure[10, 4:7] = 0.5
    assert contradicted(keys, motion(unsure)) == ()
    beside = np.full((FRAMES, 16), 0.01)
    beside[[8, 9, 11, 12], 4:7] = 0.5
    assert contradicted(keys, motion(beside)) == ()
    alone = motion()
    alone.valid[:] = False
    assert contradicted(keys, alone) == ()


def test_the_tracker_is_not_led_astray_by_a_wrong_arm() -> None:
    """On rendered views: what is found beside a keyframe with a wrong arm contradicts it, and it alone."""
    keys = [rendered.by_hand(0), turned(rendered.by_hand(6), "left_upper_arm", 40.0), rendered.by_hand(12)]
    found = tracker.collect(rendered.run(keys, rendered.inputs()), keys, rendered.taped())
    (only,) = keyframe_diagnostics.contradictions(found, keys, rendered.taped())
    assert (only.frame, only.parts) == (6, ("left arm",))
    sound = [rendered.by_hand(frame) for frame in (0, 6, 12)]
    found = tracker.collect(rendered.run(sound, rendered.inputs()), sound, rendered.taped())
    assert keyframe_diagnostics.contradictions(found, sound, rendered.taped()) == ()


# --------------------------------------------------------------------------------------------------------------
# The next one


def test_the_next_keyframe_goes_between_those_where_a_limb_is_in_doubt() -> None:
    sigma = np.full((FRAMES, 16), 0.01)
    sigma[12:14, 7:10] = 0.2
    found = keyframe_diagnostics.suggestion(motion(sigma))
    assert found == keyframe_diagnostics.Suggestion(15, "right arm")
    assert found.told(TIMECODES).endswith("at frame 15 (10:00:00:15), where the right arm is least certain")


def test_where_all_is_alike_it_goes_where_keyframes_are_furthest_apart() -> None:
    found = keyframe_diagnostics.suggestion(motion(keyframes=(0, 10, 30)))
    assert found is not None
    assert 19 <= found.frame <= 21
    after = keyframe_diagnostics.suggestion(motion(keyframes=(0, 3)))
    assert after is not None
    assert 15 <= after.frame <= 25  # nothing follows that would help from the other side


def test_frames_that_nobody_was_tracked_in_come_first() -> None:
    lost = motion()
    lost.valid[21:30] = False
    found = keyframe_diagnostics.suggestion(lost)
    assert found is not None
    assert 21 <= found.frame < 30


@pytest.mark.parametrize("keyframes", [(), range(FRAMES)])
def test_without_any_keyframe_or_any_other_frame_there_is_no_advice(keyframes: Sequence[int]) -> None:
    assert keyframe_diagnostics.suggestion(motion(keyframes=keyframes)) is None


def test_advice_is_a_line_each() -> None:
    keys = [turned(by_hand(k), "right_thigh", 40.0) if k == 20 else by_hand(k) for k in KEYS]
    first, second = keyframe_diagnostics.notes(motion(), keys, BODY, TIMECODES, detected=False)
    assert first.startswith("keyframe 20: the images have its right leg ")
    assert second.startswith("the next keyframe would help most at frame ")


@pytest.mark.parametrize("frames", [7, 8])
def test_where_limbs_are_often_in_doubt_a_detector_is_advised(frames: int) -> None:
    """From a quarter of the 31 frames on, and never to those who have run one."""
    sigma = np.full((FRAMES, 16), 0.01)
    sigma[11 : 11 + frames, 9] = 0.2

    def notes(detected: bool) -> tuple[str, ...]:
        return keyframe_diagnostics.notes(motion(sigma), [by_hand(k) for k in KEYS], BODY, TIMECODES, detected)

    assert len(notes(True)) == 1
    own = notes(False)[1:]
    assert len(own) == (frames == 8)
    assert all("in 8 of 31 frames a limb is known to no better than 150 mm" in note for note in own)
    assert all(keyframe_diagnostics.is_advice(note) for note in notes(False))
