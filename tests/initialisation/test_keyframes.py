"""Keyframes from keypoints and images: what is sure is taken, what the images contradict is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from pzcap.body.kinematics import joints
from pzcap.body.skeleton import DOF_SEGMENT
from pzcap.initialisation import selection
from pzcap.initialisation.keyframes import find_keyframes, is_borne_out
from pzcap.initialisation.people import Detections
from pzcap.tracking.observation import ViewInput, expect
from pzcap.tracking.pixel_time import AT_REST
from pzcap.types import SEGMENTS, Array, Camera, Keyframe, Pose, Silhouette
from tests.scenes import tracked
from tests.scenes.detected import RATE, Faults, body, cameras, detections, poses
from tests.scenes.tracked import CONFIG, lost
from tests.tracking.test_tracker_keypoints import with_keypoints

FRAMES = 13
THIGH_FORWARD = int(np.argmax(SEGMENTS.index("left_thigh") == DOF_SEGMENT)) + 1
UNSEEN = (None,) * 4


def cut_out(camera: Camera, pose: Pose | None) -> ViewInput:
    """A view of a grey body before a grey wall, of which the silhouette alone tells; None: nobody is there."""
    probability = np.zeros((camera.height, camera.width), np.uint8)
    if pose is not None:
        expected = expect(body(), pose, 0.01, camera, 0.1)
        assert expected is not None
        inside = cv2.resize(expected.distance_px, None, fx=2, fy=2)
        rows, columns = (slice(a, a + n) for a, n in zip((expected.top, expected.left), inside.shape, strict=True))
        probability[rows, columns] = np.clip(127.5 + 64.0 * inside, 0.0, 255.0)
    image = np.full((camera.height, camera.width, 3), 128, np.uint8)
    evidence = np.where(probability[::2, ::2] > 127, np.float32(3.0), np.float32(-3.0))
    return ViewInput(image, camera, Silhouette(probability, image, evidence, True))


def observe(key: Keyframe) -> Sequence[ViewInput | None]:
    return [cut_out(camera, poses(FRAMES)[key.frame]) for camera in cameras()]


def keyframes(seen: Sequence[Detections], given: Sequence[Keyframe] = (), empty: bool = False) -> list[Keyframe]:
    def nobody(_: Keyframe) -> Sequence[ViewInput | None]:
        return [cut_out(camera, None) for camera in cameras()]

    return find_keyframes(seen, body(), given, RATE, nobody if empty else observe, CONFIG)


@cache
def found() -> tuple[Keyframe, ...]:
    return tuple(keyframes(detections(FRAMES, Faults())))


def off_m(key: Keyframe) -> Array:
    return np.linalg.norm(joints(body(), key.pose) - joints(body(), poses(FRAMES)[key.frame]), axis=1)


def test_they_are_near_the_truth_and_say_how_near() -> None:
    assert 1 <= len(found()) <= 3
    for key in found():
        assert off_m(key).mean() < 0.03
        assert key.covariance is not None
        assert np.linalg.eigvalsh(key.covariance).min() > 0.0


def test_a_bystander_and_sides_exchanged_in_a_sixth_of_the_views_change_little() -> None:
    rng = np.random.default_rng(5)
    wrong = tuple((frame, view) for frame in range(FRAMES) for view in range(4) if rng.uniform() < 1 / 6)
    harsh = keyframes(detections(FRAMES, Faults(backward=wrong, other=True)))
    assert harsh
    assert all(off_m(key).mean() < 0.035 for key in harsh)


def test_frames_that_the_images_do_not_bear_out_are_passed_over() -> None:
    assert keyframes(detections(FRAMES, Faults()), empty=True) == []


def test_without_anybody_there_is_none() -> None:
    nobody = [Detections(tuple(v and (v[0], v[1][:0]) for v in each.views)) for each in detections(FRAMES, Faults())]
    assert keyframes(nobody) == []


def test_beside_a_hands_keyframes_only_gaps_are_filled(monkeypatch: pytest.MonkeyPatch) -> None:
    first, last = (Keyframe(frame, poses(FRAMES)[frame]) for frame in (0, FRAMES - 1))
    assert keyframes(detections(FRAMES, Faults()), [first, last]) == []
    monkeypatch.setattr(selection, "SELECTION", selection.SELECTION._replace(spacing_s=0.3))
    filled = keyframes(detections(FRAMES, Faults()), [first])
    assert filled
    assert all(key.frame > 2 for key in filled)


def test_a_limb_that_stands_elsewhere_is_not_borne_out() -> None:
    (key, *_), speed = found(), AT_REST
    assert is_borne_out(body(), key, observe(key), speed, CONFIG)
    wrong = replace(key, pose=lost(key.pose, THIGH_FORWARD, 1.0))
    assert not is_borne_out(body(), wrong, observe(key), speed, CONFIG)
    assert not is_borne_out(body(), key, UNSEEN, speed, CONFIG)


@pytest.mark.heavy
def test_the_body_is_tracked_from_them() -> None:
    items = with_keypoints(tracked.inputs())
    seen = [Detections(tuple(v and (v.camera, v.people) for v in item.views)) for item in items]

    def view(key: Keyframe) -> Sequence[ViewInput | None]:
        return items[key.frame].views

    keys = find_keyframes(seen, tracked.taped(), (), RATE, view, CONFIG)
    assert tracked.errors_m(tracked.run(keys, items)).mean() < 0.012
