"""Size of an athlete by silhouettes: named where the tape contradicts it, and tracked with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pzcap.body import skeleton
from pzcap.body.kinematics import retract
from pzcap.body.skeleton import Body
from pzcap.plausibility import athlete_of_another_size, guessed_measurements
from pzcap.tracking.body_size import BodySize, body_size, resized, scaled, seen_sizes
from pzcap.tracking.observation import expect
from pzcap.types import SEGMENTS, Array, Camera, Pose, Silhouette, Subject
from tests.scenes.bodies import BODY, subject

MARGIN = 0.1
STANDING = Pose(np.array([0.0, 0.0, 1.0]), np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1)))


def camera(azimuth: float) -> Camera:
    """A camera 6 m off, at the height of the hips."""
    forward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    world = np.eye(4)
    world[:3, :3] = np.column_stack([[forward[1], -forward[0], 0.0], [0.0, 0.0, -1.0], forward])
    world[:3, 3] = np.array([0.0, 0.0, 1.0]) - 6.0 * forward
    return Camera(320, 240, world, 420.0, np.array([159.5, 119.5]), 0.0)


def seen(ratio: float, hand: Array, body: Body = BODY) -> tuple[Pose, list[Camera], list[Silhouette]]:
    """What cameras see of the body when it is so many times as large, and the pose a hand makes of it."""
    cameras, silhouettes = [camera(azimuth) for azimuth in (0.3, 1.4, 2.9, 4.4)], []
    for each in cameras:
        expected = expect(scaled(body, ratio), STANDING, 0.0, each, 0.6)
        assert expected is not None
        evidence = np.full((120, 160), -3.0, np.float32)
        height, width = expected.distance_px.shape
        part = np.s_[expected.top // 2 : expected.top // 2 + height, expected.left // 2 : expected.left // 2 + width]
        evidence[part] = np.where(expected.distance_px > 0.0, 3.0, -3.0)
        black = np.zeros((240, 320), np.uint8)
        silhouettes.append(Silhouette(black, np.dstack([black] * 3), evidence, True))
    return retract(STANDING, hand), cameras, silhouettes


def size_by(body: Body, *views: tuple[Pose, Sequence[Camera | None], Sequence[Silhouette | None]]) -> BodySize | None:
    """Size by a keyframe's pose and its views, each."""
    return body_size(body, [log for each in views for log in seen_sizes(body, *each, MARGIN)])


def by_hand(seed: int) -> Array:
    return np.random.default_rng(seed).normal(0.0, np.r_[np.full(3, 0.006), np.full(40, 0.03)])


@pytest.mark.parametrize("ratio", [0.9, 1.1])
def test_another_persons_tape_is_named_and_replaced(ratio: float) -> None:
    views = [seen(ratio, by_hand(seed)) for seed in (1, 2)]
    size = size_by(BODY, *views)
    assert size is not None
    assert size.contradicts
    assert size.ratio == pytest.approx(ratio, rel=0.02)
    [note] = athlete_of_another_size(size, 0.9)
    assert f"{abs(size.ratio - 1):.1%} {'larger' if ratio > 1 else 'smaller'}" in note
    assert "90% of the keyframes' joints" in note
    body = resized(BODY, size)
    np.testing.assert_allclose(body.offsets_m, ratio * BODY.offsets_m, atol=0.01)
    # that it is somebody else's tape leaves the lengths less sure than the tape says
    assert body.measured.sigma("thigh") > BODY.measured.sigma("thigh")


def test_the_right_tape_is_believed() -> None:
    size = size_by(BODY, seen(1.0, by_hand(3)))
    assert size is not None
    assert not size.contradicts
    assert athlete_of_another_size(size, 0.9) == []
    np.testing.assert_allclose(resized(BODY, size).offsets_m, BODY.offsets_m, atol=0.003)


@pytest.mark.parametrize("share", [0.6, 1.4])
def test_clothes_that_hang_closer_or_wider_make_nobody_another_person(share: float) -> None:
    said, worn = ({"shirt": room, "trousers": room} for room in (0.03, 0.03 * share))
    body, dressed = (skeleton.build(replace(subject(), loose_m=room)) for room in (said, worn))
    size = size_by(body, *(seen(1.0, by_hand(seed), dressed) for seed in (1, 2)))
    assert size is not None
    assert 0.01 < abs(np.log(size.ratio)) < 1.5 * size.sigma
    assert athlete_of_another_size(size, 0.9) == []
    tight = size_by(BODY, *(seen(1.0, by_hand(seed)) for seed in (1, 2)))
    assert tight is not None
    assert tight.sigma < 0.6 * size.sigma


def test_a_size_that_was_guessed_is_measured() -> None:
    true = BODY.measured.named()
    smaller = {name: 0.94 * value for name, value in true.items()}
    guess = skeleton.build(Subject(smaller, 0.005, {name: 0.2 * value for name, value in true.items()}))
    size = size_by(guess, seen(1.0, by_hand(4)))
    assert size is not None
    assert not size.contradicts
    better = resized(guess, size)
    assert abs(better.measured.value("stature") - true["stature"]) < 0.03 < 0.06 * true["stature"]
    assert better.measured.sigma("stature") < 0.95 * guess.measured.sigma("stature")


def test_what_was_guessed_is_said() -> None:
    assert guessed_measurements(subject(), BODY) == []
    tall = Subject({"stature": 1.7}, 0.005)
    [note] = guessed_measurements(tall, skeleton.build(tall))
    assert "25 of 26 measurements" in note
    assert "girth_waist, to" in note


def test_views_that_show_nobody_tell_no_size() -> None:
    pose, cameras, silhouettes = seen(1.0, np.zeros(43))
    empty = [replace(each, evidence=np.full_like(each.evidence, -3.0)) for each in silhouettes if each is not None]
    assert size_by(BODY, (pose, cameras, empty)) is None
    assert size_by(BODY, (pose, [None] * 4, [None] * 4)) is None
    assert athlete_of_another_size(None, 1.0) == []


def test_a_size_is_a_measurement_like_the_others() -> None:
    """Uncertain bodies take it over, sure ones keep theirs, and the covariance stays one."""
    size = BodySize(1.03, 0.015, 0.02)
    sure, unsure = (
        skeleton.build(Subject(person.measurements_m, 0.005, {k: share * v for k, v in person.measurements_m.items()}))
        for person, share in ((subject(), 0.001), (subject(), 0.3))
    )
    assert resized(sure, size).measured.value("thigh") < 1.005 * sure.measured.value("thigh")
    assert resized(unsure, size).measured.value("thigh") > 1.01 * unsure.measured.value("thigh")
    assert np.linalg.eigvalsh(resized(unsure, size).measured.covariance_m2).min() > 0.0
