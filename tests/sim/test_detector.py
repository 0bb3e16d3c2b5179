"""The simulated detector of keypoints: that it errs as it should, and that what it writes is read."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pzcap.body import kinematics, landmarks
from pzcap.body import skeleton as bodies
from pzcap.io.detections import BODY_25, KEYPOINTS, read_keypoints
from pzcap.tracking import keypoint_residuals
from pzcap.types import Array, Subject
from sim.cameras.operator import Trajectory, through
from sim.cameras.optics import OpticsConfig, Rig, build_rig
from sim.cameras.render import Stage
from sim.cameras.sensor import SensorConfig, row_delay_s
from sim.people import athlete, detector
from sim.people.anthropometry import draw_measurements
from sim.people.detector import Detector, DetectorConfig
from tests.scenes.body_scene import swing

FRAMES = 60
TIMES_S = np.arange(FRAMES) / 30.0
PERFECT = DetectorConfig(True, 0, 0, 0, 0, 1.0, 1.0, 0, 0, 4.0, 0, 0)
ROWS = [KEYPOINTS.index(name) for name in BODY_25]


@cache
def scene() -> tuple[Stage, dict[str, float], Rig, Trajectory]:
    rng = np.random.default_rng(0)
    config = athlete.AthleteConfig()
    measurements = draw_measurements(rng)
    spec = mujoco.MjSpec()
    athlete.add_athlete(spec, measurements, config, rng)
    stage = Stage(spec, 64, 64, athlete.GEOM_GROUP, object_group=5)
    rig = build_rig(0, 640, 480, OpticsConfig(), rng)
    ahead = (np.linalg.inv(rig.world_T_head) @ [0.0, 0.2, 1.0, 1.0])[:3]
    pan = np.full(FRAMES, np.arctan2(ahead[1], ahead[0]))
    return stage, measurements, rig, through(TIMES_S, pan, np.full(FRAMES, 1500.0))


def watch(config: DetectorConfig, seed: int = 0, camera: int = 0) -> Array:
    stage, measurements, rig, trajectory = scene()
    found = Detector(stage.model, measurements, config, np.random.default_rng(seed))
    return found.watch(rig, trajectory, swing, TIMES_S, SensorConfig(), np.random.default_rng([seed, camera]))


def ideal() -> Array:
    return watch(PERFECT)[..., :2]


def test_its_keypoints_lie_where_ours_are_expected() -> None:
    """Projected with the simulator's numbers, our places on the body and the detector's agree within our sigmas."""
    _, measurements, rig, trajectory = scene()
    body = bodies.build(Subject(measurements, 0.005))
    aim = trajectory.at(0.0)
    pose = rig.world_T_cam(aim.pan_rad, aim.focal_px, aim.raised_rad)
    for frame in range(0, FRAMES, 7):
        ours = keypoint_residuals.in_world(body.landmarks, kinematics.forward(body, swing(TIMES_S[frame])))
        pixels, depth = rig.project(pose, aim.focal_px, ours)
        off_m = np.linalg.norm(pixels[ROWS] - ideal()[frame], axis=1) * depth[ROWS] / aim.focal_px
        assert np.all(off_m < 1.7 * landmarks.SIGMA_M[ROWS])


def test_the_same_seed_finds_the_same() -> None:
    config = DetectorConfig(True)
    np.testing.assert_array_equal(watch(config), watch(config))
    assert not np.array_equal(watch(config), watch(config, camera=1))


def test_its_errors_grow_with_what_is_hard_to_see() -> None:
    quiet = replace(DetectorConfig(True), meaning=0.0, swapped=0.0, astray=0.0, missed=0.0)

    def rms(config: DetectorConfig) -> float:
        found = watch(config)
        seen = found[..., 2] > 0
        return float(np.sqrt(np.mean(np.sum((found[..., :2] - ideal())[seen] ** 2, axis=1))))

    assert 2.0 < rms(quiet) < 8.0  # of a body of some 250 pixels
    assert rms(replace(quiet, hidden=8.0)) > 1.1 * rms(quiet)
    assert rms(replace(quiet, noise=0.014)) > 1.5 * rms(quiet)
    steady = watch(replace(quiet, memory=0.95))[..., :2] - ideal()
    assert np.mean(steady[1:] * steady[:-1]) > 0.8 * np.mean(steady**2)


def test_confidence_tells_something() -> None:
    found = watch(replace(DetectorConfig(True), swapped=0.0))
    off = np.linalg.norm(found[..., :2] - ideal(), axis=2)
    seen = found[..., 2] > 0
    assert 0.9 < seen.mean() < 1.0
    sure, unsure = (off[seen & which] for which in (found[..., 2] > 0.8, found[..., 2] < 0.6))
    assert np.median(unsure) > 1.5 * np.median(sure)
    assert found[..., 2].max() <= 1.0


@pytest.mark.parametrize("names", [("wrist", "elbow"), ("knee", "ankle")])
def test_left_and_right_are_swapped_for_some_frames(names: tuple[str, ...]) -> None:
    found = watch(replace(PERFECT, swapped=0.8))
    for name in names:
        left, right = BODY_25.index(f"left_{name}"), BODY_25.index(f"right_{name}")
        swapped = np.all(found[:, left, :2] == ideal()[:, right], axis=1)
        assert 3 <= swapped.sum() <= 45
        np.testing.assert_array_equal(swapped, np.all(found[:, right, :2] == ideal()[:, left], axis=1))


def test_a_rolling_shutter_shows_each_keypoint_as_it_is_when_its_row_is_read() -> None:
    stage, measurements, rig, trajectory = scene()
    found = Detector(stage.model, measurements, PERFECT, np.random.default_rng(0))
    sensor = SensorConfig(shutter_s=0.0, readout_s=-0.02)
    times_s = TIMES_S[5:15:3]
    rolled = found.watch(rig, trajectory, swing, times_s, sensor, np.random.default_rng(1))[..., :2]
    at_once = replace(sensor, readout_s=0.0)
    for k, time_s in enumerate(times_s.tolist()):
        own_s = time_s + row_delay_s(rolled[k, :, 1], rig.height, sensor.readout_s)
        own = found.watch(rig, trajectory, swing, own_s, at_once, np.random.default_rng(1))[..., :2]
        np.testing.assert_allclose(rolled[k], own[np.arange(25), np.arange(25)], atol=0.01)
    still = found.watch(rig, trajectory, swing, times_s, at_once, np.random.default_rng(1))[..., :2]
    assert np.abs(still - rolled).max() > 0.5


def test_what_it_writes_is_read(tmp_path: Path) -> None:
    assert detector.BODY_25 == BODY_25
    found = watch(DetectorConfig(True))
    found[3] = 0.0
    detector.write_openpose(tmp_path / "keypoints", "motion", [found])
    people = read_keypoints(tmp_path / "keypoints", np.arange(FRAMES), (640, 480))
    assert sorted(people) == [frame for frame in range(FRAMES) if frame != 3]
    np.testing.assert_allclose(people[7][0][ROWS], found[7], atol=1e-3)


def test_whole_views_are_seen_from_the_wrong_side() -> None:
    found = watch(replace(PERFECT, exchanged=0.8))
    pairs = [(k, BODY_25.index(name.replace("left_", "right_"))) for k, name in enumerate(BODY_25) if "left_" in name]
    for left, right in pairs:
        wrong = np.all(found[:, left, :2] == ideal()[:, right], axis=1)
        assert 3 <= wrong.sum() <= 45
        np.testing.assert_array_equal(wrong, np.all(found[:, 1, :2] == ideal()[:, 1], axis=1) & wrong)
    assert len({tuple(np.all(found[:, a, :2] == ideal()[:, b], axis=1)) for a, b in pairs}) == 1


def test_hard_postures_are_lost_and_others_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(PERFECT, lost=0.9, missed=0.0)
    np.testing.assert_array_equal(watch(config)[..., :2], ideal())  # it stands upright, and nobody looks down on it
    monkeypatch.setattr(detector, "_end_on", lambda pixels, _: np.ones(len(pixels), bool))
    found = watch(config)
    nobody = ~found[..., 2].any(axis=1)
    turned = ~nobody & (found[:, BODY_25.index("nose"), 1] > found[:, BODY_25.index("left_ankle"), 1])
    assert 0 < nobody.sum() < turned.sum() < FRAMES
    usual = ~nobody & ~turned
    np.testing.assert_array_equal(found[usual][..., :2], ideal()[usual])


def test_faults_that_are_off_leave_the_rest_as_it_was() -> None:
    """To the bit: captures that are kept stay valid."""
    config = DetectorConfig(True)
    usual, harsh = watch(config), watch(replace(config, exchanged=0.2, lost=0.5, candid=False))
    same = np.all(usual[..., :2] == harsh[..., :2], axis=(1, 2))
    assert same.sum() > FRAMES / 3
    assert set(np.unique(harsh[..., 2])) == {0.0, 0.99}


def test_of_several_people_each_is_read(tmp_path: Path) -> None:
    one = watch(DetectorConfig(True))
    other = one + np.where(one[..., 2:] > 0, [10.0, 0.0, 0.0], 0.0)
    other[5] = 0.0
    detector.write_openpose(tmp_path / "keypoints", "motion", [one, other])
    people = read_keypoints(tmp_path / "keypoints", np.arange(FRAMES), (640, 480))
    assert [len(people[frame]) for frame in (4, 5, 6)] == [2, 1, 2]
    np.testing.assert_allclose(people[4][0][ROWS], one[4], atol=1e-3)
    np.testing.assert_allclose(people[7][0][ROWS], other[7], atol=1e-3)  # in no fixed order
