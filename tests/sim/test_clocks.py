"""Cameras on clocks of their own, and the truth of what they film with a rolling shutter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.cameras.operator import OperatorConfig
from sim.cameras.optics import OpticsConfig
from sim.cameras.sensor import SensorConfig, nearest_frames
from sim.session import ShootConfig, assemble
from sim.shoot import shoot
from sim.truth import Truth, load
from tests.scenes.captures import TINY, project

READOUT_S = 0.016
TROUBLED = replace(
    TINY, motion="floor_exercise", motion_frames=3, zoom_frames=0, operator=OperatorConfig(sweep_speed_variation=0.0),
    optics=OpticsConfig(settled_deg=0.5, bump_deg=1.0, zoom_max=1.8),
    sensor=SensorConfig(readout_s=READOUT_S, clock_offset=0.5, clock_drift_ppm=1000.0),
)  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_clocks_are_off_by_no_more_than_configured_and_by_nothing_in_the_mean(seed: int) -> None:
    session = assemble(replace(ShootConfig(motion="pedestrian"), seed=seed, sensor=TROUBLED.sensor))
    offset_s, drift = session.own_clocks()
    assert offset_s.mean() == pytest.approx(0.0, abs=1e-12)
    assert drift.mean() == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(offset_s) <= 1 / 30
    assert np.ptp(drift) <= 2e-3
    assert np.ptp(offset_s) > 1e-3
    for c in range(session.config.cameras):
        exposed_s, early = session.exposed_s(c), session.clock().early[c]
        np.testing.assert_allclose(exposed_s[early] - offset_s[c], 0.0, atol=1e-12)
        np.testing.assert_allclose(np.diff(exposed_s), (1 + drift[c]) / 30, atol=1e-12)


def test_genlocked_cameras_are_not_off_at_all() -> None:
    session = assemble(ShootConfig(motion="pedestrian"))
    assert not any(each.any() for each in session.own_clocks())
    early = session.clock().early[2]
    np.testing.assert_array_equal(session.exposed_s(2), (np.arange(len(session.exposed_s(2))) - early) / 30)


@given(st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=8))
def test_without_timecode_the_nearest_frames_belong_together(offsets_s: list[float]) -> None:
    """The same clocks, whole frames apart from how they were drawn, but for the last tenth beside half a frame."""
    drawn, period_s = np.array(offsets_s), 1 / 30
    apart, before = (each - each[0] for each in (nearest_frames(drawn, period_s), drawn))
    assert np.abs(apart).max() <= 0.4 * period_s + 1e-12
    whole = (apart - before) / period_s
    assert np.abs(whole - np.round(whole)).max() <= 0.1 + 1e-9
    assert nearest_frames(drawn, period_s).mean() == pytest.approx(0.0, abs=1e-12)


def test_untimed_cameras_have_other_frame_numbers_and_the_same_drift() -> None:
    """Seed 32 draws two cameras that are 19 and 31 ms behind the first: a frame of theirs is nearer than that."""
    timed = replace(ShootConfig(motion="pedestrian"), seed=32, sensor=SensorConfig(clock_offset=0.5))
    untimed = replace(timed, crew=replace(timed.crew, sync="sound"))
    (one, drift), (other, same) = (assemble(each).own_clocks() for each in (timed, untimed))
    np.testing.assert_array_equal(drift, same)
    np.testing.assert_array_equal(np.round(30 * (one - one[0] - (other - other[0]))), [0, 1, 1, 0])


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    folder = tmp_path_factory.mktemp("troubled")
    for _ in shoot(TROUBLED, folder):
        pass
    return load(folder / "truth")


def test_the_truth_tells_clocks_readout_and_tripods(truth: Truth) -> None:
    session = assemble(TROUBLED)
    np.testing.assert_array_equal(truth.clock_offset_s, session.own_clocks()[0])
    np.testing.assert_array_equal(truth.clock_drift, session.own_clocks()[1])
    np.testing.assert_array_equal(truth.readout_s, np.full(len(truth.camera_names), READOUT_S))
    for c, rig in enumerate(session.rigs):
        unrest = session.unrest(c)
        assert unrest is not None
        for f, time_s in enumerate(session.own_s(c, session.times_s).tolist()):
            _, tilt_rad, roll_rad = unrest.at(time_s).tolist()
            assert truth.tilt_rad[c, f] == pytest.approx(rig.tilt_rad + tilt_rad)
            assert truth.roll_rad[c, f] == pytest.approx(rig.roll_rad + roll_rad)
            pose = rig.world_T_cam(truth.pan_rad[c, f], truth.focal_px[c, f], tilt_rad, roll_rad)
            np.testing.assert_allclose(pose, truth.world_T_cam[c, f], atol=1e-9)
    assert np.ptp(truth.roll_rad, axis=1).max() > 1e-3  # the bump
    assert np.all(np.abs(truth.tilt_rad[:, 0] - [rig.tilt_rad for rig in session.rigs]) > 0.008)


def test_joints_lie_on_the_athlete_at_the_cameras_own_time(truth: Truth) -> None:
    """They are of a body that stands nearly still, in cameras that have settled and been bumped."""
    inside = []
    for c in range(len(truth.camera_names)):
        for f in range(len(truth.timecodes)):
            pixels = project(truth.camera(c, f), truth.joints_m[f][[0, 2, 3]])
            rows = np.clip(np.rint(pixels[:, 1]), 0, truth.height - 1).astype(int)
            columns = np.clip(np.rint(pixels[:, 0]), 0, truth.width - 1).astype(int)
            inside.append(truth.mask(c, f)[rows, columns].mean())
    assert np.mean(inside) > 0.9
