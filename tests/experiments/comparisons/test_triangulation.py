"""The baseline: keypoints of several views brought to one point, and filtered over time."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from experiments.comparisons import triangulation
from experiments.comparisons.triangulation import cameras_at, meet, smooth, triangulate
from pzcap.geometry.camera import project
from pzcap.io.detections import KEYPOINTS
from pzcap.types import JOINTS, Array, Camera, Capture, Keyframe, Pose, PzcapError, Subject
from tests.scenes.body_scene import POSITIONS, aim
from tests.scenes.fabricated import reconstruction

RNG = np.random.default_rng(4)
POINTS = np.array([0.0, 0.2, 0.9]) + RNG.uniform(-0.8, 0.8, (len(KEYPOINTS), 3))
LEFT, RIGHT = KEYPOINTS.index("left_knee"), KEYPOINTS.index("right_knee")


def views(k1: float = -0.05) -> list[tuple[Camera, Array]]:
    found = []
    for position in POSITIONS:
        level = aim(position, np.array([0.0, 0.2, 0.9]))
        camera = Camera(level.width, level.height, level.world_T_cam, level.focal_px, level.principal_px, k1)
        found.append((camera, np.column_stack([project(camera, POINTS)[0], np.full(len(POINTS), 0.8)])))
    return found


def test_exact_without_noise() -> None:
    points, off = meet(views())
    np.testing.assert_allclose(points, POINTS, atol=1e-6)
    assert off.max() < 1e-6
    np.testing.assert_allclose(meet(views()[1:3])[0], POINTS, atol=1e-6)


@pytest.mark.parametrize("camera", range(4))
def test_a_view_that_is_wrong_is_left_out(camera: int) -> None:
    seen = views()
    person = seen[camera][1]
    person[[LEFT, RIGHT]] = person[[RIGHT, LEFT]]  # swapped
    person[:5, :2] += 60.0
    points, _ = meet(seen)
    np.testing.assert_allclose(points, POINTS, atol=1e-6)


def test_what_only_one_view_has_is_not_known() -> None:
    seen = views()
    for _, person in seen[1:]:
        person[3, 2] = 0.0
    points, off = meet(seen)
    assert np.isinf(off[3])
    np.testing.assert_allclose(np.delete(points, 3, axis=0), np.delete(POINTS, 3, axis=0), atol=1e-6)
    assert np.isinf(meet(seen[:1])[1]).all()
    assert np.isinf(meet([])[1]).all()


def test_noise_is_averaged_over_the_views() -> None:
    rng = np.random.default_rng(0)
    seen = views()
    for _, person in seen:
        person[:, :2] += rng.normal(0.0, 2.0, (len(person), 2))
    points, off = meet(seen)
    assert np.sqrt(np.mean((points - POINTS) ** 2)) < 0.015
    assert 0.001 < off.mean() < 0.05


def test_the_filter_bridges_gaps_and_keeps_slow_motion() -> None:
    time = np.arange(90) / 30.0
    way = np.column_stack([np.sin(2 * np.pi * time), time, 0.3 * np.sin(4 * np.pi * time)])
    off = np.zeros(90)
    off[29:32] = np.inf  # where it goes straight
    shaken = np.where(np.isinf(off)[:, None], 99.0, way)
    shaken = shaken + 0.01 * (-1.0) ** np.arange(90)[:, None] * np.isfinite(off)[:, None]
    np.testing.assert_allclose(smooth(shaken, off, 30.0, "nose")[10:-10], way[10:-10], atol=0.02)
    with pytest.raises(PzcapError, match="nose"):
        smooth(shaken, np.full(90, np.inf), 30.0, "nose")


class Sets(list[tuple[Array, ...]]):
    """Frame sets, of which only the keypoints are looked at."""

    keyframes = (Keyframe(3, Pose(np.zeros(3), np.zeros((16, 4)))),)

    def people(self, index: int) -> tuple[Array, ...]:
        return self[index]


def test_the_body_from_keypoints_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exact in the limbs, where nothing errs; also with a second person in a view, and a view that nobody is in."""
    whole = reconstruction()
    assert whole.motion is not None
    true, sets = whole.motion.joints_m, Sets()
    for frame, joints in enumerate(true):
        people = []
        for camera in cameras_at(whole, frame):
            assert camera is not None
            person = np.zeros((1, len(KEYPOINTS), 3))
            for name in set(JOINTS) & set(KEYPOINTS):
                pixels, _ = project(camera, joints[[JOINTS.index(name)]])
                person[0, KEYPOINTS.index(name)] = [*pixels[0], 0.8]
            people.append(person)
        people[0] = np.concatenate([0.5 * people[0], people[0]])
        people[1] = people[1][: frame % 2]
        sets.append(tuple(people))
    monkeypatch.setattr(triangulation, "frame_sets", lambda _: sets)
    subject = Subject({"shoulder_drop": 0.05}, 0.005)
    capture = Capture(Path(), "fabricated", Fraction(30), (), None, subject, {}, True)
    motion = triangulate(capture, whole)
    limbs = [joint for joint, name in enumerate(JOINTS) if name in KEYPOINTS and name != "neck"]
    np.testing.assert_allclose(motion.joints_m[:, limbs], true[:, limbs], atol=1e-6)
    assert np.abs(motion.joints_m - true).max() < 0.05
    assert motion.valid.all()
    assert motion.keyframes.tolist() == [3]
    monkeypatch.setattr(triangulation, "frame_sets", lambda _: Sets([()] * len(true)))
    with pytest.raises(PzcapError, match="no camera has keypoints"):
        triangulate(capture, whole)
