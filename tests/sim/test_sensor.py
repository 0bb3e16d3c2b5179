"""Exposure, noise and clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.cameras.sensor import Automatics, Exposure, Sensor, SensorConfig, draw_dropped, rolls

QUIET = SensorConfig(read_noise=0.0, shot_noise=0.0, exposure_drift=0.0)
FLAT = np.ones((120, 160, 1), np.float32)


def develop(config: SensorConfig, level: int, gain: float = 1.0) -> np.ndarray:
    light = np.full((120, 160, 3), level, np.uint8)
    return Sensor(config, FLAT, np.random.default_rng(0)).develop(light, gain, np.random.default_rng(1)).astype(float)


def test_read_noise_has_its_size() -> None:
    assert np.std(develop(replace(QUIET, read_noise=2.0), 100)) == pytest.approx(2.0, abs=0.05)


def test_shot_noise_grows_with_the_light() -> None:
    config = replace(QUIET, shot_noise=0.02)
    for level in (50, 200):
        variance = np.var(develop(config, level)) - 1 / 12  # less rounding
        assert variance == pytest.approx(0.02 * level, rel=0.05)


def test_without_noise_light_is_only_scaled() -> None:
    light = np.random.default_rng(2).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    sensor = Sensor(QUIET, FLAT, np.random.default_rng(0))
    np.testing.assert_array_equal(sensor.develop(light, 1.0, np.random.default_rng(1)), light[..., ::-1])
    assert develop(QUIET, 100, 1.03).mean() == pytest.approx(103)


def test_noise_differs_from_frame_to_frame() -> None:
    sensor = Sensor(SensorConfig(), FLAT, np.random.default_rng(0))
    light, rng = np.full((120, 160, 3), 100, np.uint8), np.random.default_rng(1)
    first, second = (sensor.develop(light, 1.0, rng).astype(float) - 100 for _ in range(2))
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.03


def test_exposure_drifts_slowly_within_its_bound() -> None:
    exposure = Exposure(0.03, np.random.default_rng(3))
    gains = np.array([exposure(t) for t in np.arange(0, 60, 1 / 30)])
    assert np.abs(gains - 1).max() <= 0.03
    assert np.ptp(gains) > 0.01
    assert np.abs(np.diff(gains)).max() < 0.002
    assert Exposure(0.0, np.random.default_rng(3))(1.0) == 1.0


@pytest.mark.parametrize("seed", range(10))
def test_some_camera_starts_and_some_camera_stops_just_in_time(seed: int) -> None:
    early, late = rolls(4, 5, np.random.default_rng(seed))
    assert min(early) == min(late) == 0
    assert max(early + late) <= 5


def test_dropped_frames_are_never_the_first_or_the_last() -> None:
    assert not draw_dropped(50, 0.0, np.random.default_rng(0)).any()
    dropped = draw_dropped(1000, 0.1, np.random.default_rng(0))
    assert dropped.mean() == pytest.approx(0.1, abs=0.03)
    assert draw_dropped(9, 1.0, np.random.default_rng(0)).tolist() == [False] + [True] * 7 + [False]


def test_an_automatic_exposure_steps_within_five_frames() -> None:
    config = SensorConfig(auto_exposure=0.2)
    automatics = Automatics(config, 1 / 30, np.random.default_rng(0))
    gains = np.array([automatics(t) for t in np.arange(0, 20, 1 / 30).tolist()])
    assert gains.shape == (600, 3)
    np.testing.assert_array_equal(gains[:, 0], gains[:, 2])
    assert np.abs(gains - 1).max() <= 0.1 + 1e-9
    step = np.abs(np.diff(gains[:, 1]))
    assert step.max() <= 0.2 / 5 + 1e-9
    assert step.max() > 0.1 / 5
    moving = step > 1e-9
    starts = np.flatnonzero(moving & ~np.roll(moving, 1))
    assert 10 < len(starts) < 40
    assert all(5 <= moving[start : start + 8].sum() <= 6 for start in starts[1:-1].tolist())


def test_a_white_balance_drifts_by_the_colour() -> None:
    automatics = Automatics(SensorConfig(white_drift=0.05), 1 / 30, np.random.default_rng(0))
    gains = np.array([automatics(t) for t in np.arange(0, 60, 0.1).tolist()])
    assert np.abs(gains - 1).max() <= 0.05
    assert np.ptp(gains[:, 0] / gains[:, 2]) > 0.02
    assert np.abs(np.diff(gains, axis=0)).max() < 0.01
