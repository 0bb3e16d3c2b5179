"""Keyframes from keypoints and images: what is sure is taken, what the images contradict is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pzcap.body.kinematics import joints
from pzcap.body.skeleton import DOF_SEGMENT
from pzcap.initialisation import selection
from pzcap.initialisation.keyframes import find_keyframes, is_borne_out
from pzcap.initialisation.people import Detections
from pzcap.tracking.observation import ViewInput
from pzcap.types import SEGMENTS, Keyframe
from tests.scenes.tracked import CONFIG, FRAMES, by_hand, clip, errors_m, inputs, lost, run, taped
from tests.tracking.test_tracker_keypoints import blank, detected, with_keypoints

RATE = 15.0
THIGH_FORWARD = int(np.argmax(SEGMENTS.index("left_thigh") == DOF_SEGMENT)) + 1


@cache
def detections() -> tuple[Detections, ...]:
    return tuple(
        Detections(tuple((view.camera, detected(item.frame, c)) for c, view in enumerate(item.views) if view))
        for item in inputs()
    )


def observe(key: Keyframe) -> Sequence[ViewInput | None]:
    return inputs()[key.frame].views


@cache
def found() -> tuple[Keyframe, ...]:
    return tuple(find_keyframes(detections(), taped(), (), RATE, observe, CONFIG))


def test_they_are_near_the_truth() -> None:
    assert 1 <= len(found()) <= 3
    for key in found():
        off = np.linalg.norm(joints(taped(), key.pose) - clip().joints_m[key.frame], axis=1)
        assert off.mean() < 0.03


@pytest.mark.heavy
def test_the_body_is_tracked_from_them() -> None:
    assert errors_m(run(list(found()), with_keypoints(inputs()[: found()[0].frame + 3]))).mean() < 0.012


def test_frames_that_the_images_do_not_bear_out_are_passed_over() -> None:
    unseen = blank(inputs())
    assert find_keyframes(detections(), taped(), (), RATE, lambda key: unseen[key.frame].views, CONFIG) == []


def test_without_anybody_there_is_none() -> None:
    nobody = [Detections(tuple(v and (v[0], v[1][:0]) for v in each.views)) for each in detections()]
    assert find_keyframes(nobody, taped(), (), RATE, observe, CONFIG) == []


def test_beside_a_hands_keyframes_only_gaps_are_filled(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_keyframes(detections(), taped(), [by_hand(0), by_hand(FRAMES - 1)], RATE, observe, CONFIG) == []
    monkeypatch.setattr(selection, "SELECTION", selection.SELECTION._replace(spacing_s=0.3))
    filled = find_keyframes(detections(), taped(), [by_hand(0)], RATE, observe, CONFIG)
    assert filled
    assert all(key.frame > 2 for key in filled)


def test_a_limb_that_stands_elsewhere_is_not_borne_out() -> None:
    (key, *_), speed = found(), np.zeros((len(SEGMENTS), 6))
    assert is_borne_out(taped(), key, observe(key), speed, CONFIG)
    wrong = replace(key, pose=lost(key.pose, THIGH_FORWARD, 1.0))
    assert not is_borne_out(taped(), wrong, observe(key), speed, CONFIG)
    assert not is_borne_out(taped(), key, (None,) * 4, speed, CONFIG)


def test_it_is_no_pose_of_a_persons() -> None:
    """So its frames are scored, and its contradictions with the images count in its sigmas."""
    assert all(key.covariance is not None for key in found())
    assert np.linalg.eigvalsh(found()[0].covariance).min() > 0.0
