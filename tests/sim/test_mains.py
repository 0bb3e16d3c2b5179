"""Lamps on the mains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.cameras.sensor import Sensor, SensorConfig, row_delay_s
from sim.hall.gym import GymConfig
from sim.hall.mains import draw_mains
from sim.light import light_of
from sim.session import ShootConfig, assemble

LIT = GymConfig(mains_share=0.3)


def streams(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    return np.random.default_rng(seed), np.random.default_rng([seed, 1])


def test_the_open_shutter_averages_the_flicker() -> None:
    mains, open_s = draw_mains(LIT, 0.0, *streams(0)), 0.004
    assert mains.share == pytest.approx(0.3)
    assert mains.hz == pytest.approx(100.0, rel=5e-4)
    seen = draw_mains(LIT, open_s, *streams(0))
    for time_s in (0.0, 0.0013, 0.4):
        fine_s = time_s + np.linspace(-0.5, 0.5, 4001) * open_s
        assert float(seen(time_s)) == pytest.approx(float(mains(fine_s).mean()), abs=1e-4)
    assert draw_mains(LIT, 1 / mains.hz, *streams(0)).share == pytest.approx(0.0, abs=1e-12)


def test_lamps_on_three_phases_flicker_less_and_in_each_view_differently() -> None:
    three = replace(LIT, mains_phases=3)
    shares = [draw_mains(three, 0.0, *streams(seed)).share for seed in range(40)]
    assert max(shares) < 0.3
    assert np.mean(shares) < 0.2
    assert np.ptp(shares) > 0.1


def test_all_cameras_see_the_motion_in_the_same_light_and_the_hall_each_in_its_own() -> None:
    session = assemble(ShootConfig(motion="pedestrian", gym=LIT))
    motion, sweep = (
        [session.mains(c, purpose) for c in range(session.config.cameras)] for purpose in ("motion video", "sweep")
    )
    assert len(set(motion)) == 1
    assert len(set(sweep)) == session.config.cameras
    assert assemble(ShootConfig(motion="pedestrian")).mains(0, "sweep") is None


def test_rows_of_a_rolling_shutter_are_bands() -> None:
    config = SensorConfig(read_noise=0.0, shot_noise=0.0)
    sensor = Sensor(config, np.ones((120, 160, 1), np.float32), np.random.default_rng(0))
    mains = draw_mains(LIT, config.shutter_s, *streams(3))
    delays_s = row_delay_s(np.arange(120.0), 120, 0.02)
    light = np.full((120, 160, 3), 100, np.uint8)
    seen = sensor.develop(light, mains(delays_s[:, None, None]), np.random.default_rng(1)).astype(float)
    assert np.ptp(seen, axis=1).max() == 0.0
    np.testing.assert_allclose(seen[:, 0, 0], 100 * mains(delays_s), atol=0.5)
    bands = np.abs(np.fft.rfft(seen[:, 0, 0] - seen.mean()))
    assert np.argmax(bands) == 2  # two periods of 10 ms in a readout of 20


def test_light_is_filmed_once_for_all_lamps() -> None:
    flickering = ShootConfig(gym=replace(LIT, mains_hz=120.0, mains_phases=3))
    assert light_of(flickering) == light_of(ShootConfig())
