"""The operators: do they keep the athlete in the picture, and do their trajectories look hand-made?"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from pzcap.types import Array
from sim.cameras.operator import OperatorConfig, Trajectory, faltering, follow, sweep, sweep_length, through
from sim.cameras.optics import OpticsConfig, Rig, build_rig

CONFIG = OperatorConfig()
STILL = replace(CONFIG, tremor_deg=0.0)
RIG = build_rig(0, 640, 480, OpticsConfig(), np.random.default_rng(1))
TIMES_S = np.arange(180) / 30


def body(centre_m: Array) -> Array:
    """(T, 8, 3) corners of a box as large as a person, standing at (T, 2)."""
    corners = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (0.0, 1.7)])
    return np.concatenate([centre_m, np.zeros((len(centre_m), 1))], axis=1)[:, None] + corners


def run(speed_m_s: float) -> Array:
    """Stand at one corner of the carpet, run along its diagonal, across the camera's view, stop at the other."""
    along = np.clip((TIMES_S - 1.0) * speed_m_s - 6.5, -6.5, 6.5)
    return along[:, None] * np.array([[np.sqrt(0.5), -np.sqrt(0.5)]])


def pixels(rig: Rig, trajectory: Trajectory, points_m: Array) -> Array:
    """(T, N, 2) without distortion."""
    result = []
    for time_s, points in zip(TIMES_S.tolist(), points_m, strict=True):
        aim = trajectory.at(time_s)
        cam_T_world = np.linalg.inv(rig.world_T_cam(*aim))
        seen = points @ cam_T_world[:3, :3].T + cam_T_world[:3, 3]
        result.append(rig.principal_px + aim.focal_px * seen[:, :2] / seen[:, 2:])
    return np.array(result)


@pytest.mark.parametrize("speed_m_s", [0.0, 1.5, 4.0, 7.0])
@pytest.mark.parametrize("camera", [0, 1])
def test_the_body_stays_in_the_picture(speed_m_s: float, camera: int) -> None:
    rig = build_rig(camera, 640, 480, OpticsConfig(), np.random.default_rng(camera))
    points_m = body(run(speed_m_s))
    seen = pixels(rig, follow(rig, TIMES_S, points_m, CONFIG, np.random.default_rng(0)), points_m)
    assert ((seen > 0) & (seen < [640, 480])).all(axis=2).mean() > 0.995
    assert np.abs(seen.mean(axis=1)[:, 0] - 320).mean() < 60


@pytest.mark.parametrize("camera", [0, 1])
def test_who_does_not_zoom_or_stays_away_frames_all_of_the_way(camera: int) -> None:
    """The body is in the picture all the same, and the smaller for it."""
    rig = build_rig(camera, 640, 480, OpticsConfig(zoom_min=0.4), np.random.default_rng(camera))
    points_m, height_px = body(run(4.0)), []
    moves: tuple[Literal["pan_zoom", "pan", "none"], ...] = ("pan_zoom", "pan", "none")
    for each in moves:
        trajectory = follow(rig, TIMES_S, points_m, replace(CONFIG, moves=each), np.random.default_rng(0))
        aims = np.array([trajectory.at(t)[:2] for t in TIMES_S.tolist()])
        assert (np.ptp(aims[:, 0]) < 1e-9) == (each == "none")
        assert (np.ptp(aims[:, 1]) < 1e-6) == (each != "pan_zoom")
        seen = pixels(rig, trajectory, points_m)
        assert ((seen > 0) & (seen < [640, 480])).all(axis=2).mean() > 0.995
        height_px.append(float(np.median(np.ptp(seen[..., 1], axis=1))))
    assert height_px[0] > 0.99 * height_px[1] > 0.98 * height_px[2]
    assert height_px[0] > 1.3 * height_px[2]


def test_a_standing_body_has_the_height_asked_for() -> None:
    points_m = body(np.zeros((180, 2)))
    trajectory = follow(RIG, TIMES_S, points_m, STILL, np.random.default_rng(0))
    height_px = np.ptp(pixels(RIG, trajectory, points_m)[..., 1], axis=1)
    assert 240 < height_px.mean() < 300
    assert np.ptp(height_px) < 1


def test_zoom_stays_in_its_range() -> None:
    near = np.tile(RIG.world_T_head[:2, 3] + 2.0 * RIG.world_T_head[:2, 0], (180, 1))
    far = np.tile(RIG.world_T_head[:2, 3] + 24.0 * RIG.world_T_head[:2, 0], (180, 1))
    for place, zoom in ((near, 0.7), (far, 3.0)):
        trajectory = follow(RIG, TIMES_S, body(place), CONFIG, np.random.default_rng(0))
        assert trajectory.at(2.0)[1] == pytest.approx(880 * zoom, rel=1e-9)


def test_hands_lag_and_overshoot() -> None:
    points_m = body(run(4.0))
    trajectory = follow(RIG, TIMES_S, points_m, STILL, np.random.default_rng(0))
    pan_rad = np.array([trajectory.at(t)[0] for t in TIMES_S])
    direction = np.sign(pan_rad[-1] - pan_rad[0])
    start = 30  # the athlete sets off
    assert abs(pan_rad[start + 3] - pan_rad[start]) < np.deg2rad(0.3)  # nobody has reacted yet
    assert (direction * (pan_rad - pan_rad[-1])).max() > np.deg2rad(0.05)  # past where the athlete stopped
    assert np.rad2deg(np.abs(np.diff(pan_rad)).max()) < 1.2  # degrees a frame


def test_tremor_has_its_size() -> None:
    points_m = body(np.zeros((180, 2)))
    shaken = follow(RIG, TIMES_S, points_m, CONFIG, np.random.default_rng(0))
    still = follow(RIG, TIMES_S, points_m, STILL, np.random.default_rng(0))
    times_s = np.linspace(0, 5.9, 2000)
    difference = np.rad2deg([shaken.at(t)[0] - still.at(t)[0] for t in times_s])
    assert 0.5 * CONFIG.tremor_deg < np.std(difference) < 1.5 * CONFIG.tremor_deg
    assert np.ptp([still.at(t)[0] for t in times_s]) < 1e-6


def test_the_same_seed_gives_the_same_trajectory() -> None:
    points_m = body(run(4.0))
    first, second = (follow(RIG, TIMES_S, points_m, CONFIG, np.random.default_rng(4)) for _ in range(2))
    assert first.at(3.21) == second.at(3.21)


def test_a_full_sweep_overlaps_its_start() -> None:
    pan_deg = np.rad2deg(sweep(360.0, CONFIG, np.random.default_rng(0)))
    assert len(pan_deg) == sweep_length(360.0, CONFIG)
    assert 170 < len(pan_deg) < 190
    view_deg = 2 * np.rad2deg(np.arctan(320 / 880))
    assert np.ptp(pan_deg) > 360 + 4
    assert view_deg - (np.ptp(pan_deg) - 360) > 20  # the last frame and the first share this much
    steps = np.diff(pan_deg)
    assert steps.min() > 1.0
    assert steps.max() < 3.0
    assert np.std(steps) > 0.02


def test_a_partial_sweep_is_centred_on_the_reference() -> None:
    pan_deg = np.rad2deg(sweep(120.0, CONFIG, np.random.default_rng(0)))
    assert len(pan_deg) == sweep_length(120.0, CONFIG)
    assert pan_deg[0] == pytest.approx(-pan_deg[-1])
    assert np.ptp(pan_deg) == pytest.approx(120, abs=8)


def test_hands_pass_through_what_they_are_given() -> None:
    times_s, pan_rad = np.arange(5) / 5, np.array([0.0, 0.1, 0.25, 0.3, 0.31])
    trajectory = through(times_s, pan_rad, np.geomspace(600, 2600, 5))
    assert trajectory.at(0.4) == pytest.approx((0.25, np.sqrt(600 * 2600), 0.0, 0.0))


@pytest.mark.parametrize("seed", range(5))
def test_a_hand_that_falters_sweeps_as_wide(seed: int) -> None:
    config = replace(CONFIG, sweep_speed_variation=0.0, sweep_uneven=0.5, sweep_stop_frames=5, sweep_back_frames=4)
    even_rad = sweep(360.0, config, np.random.default_rng(seed))
    pan_rad = faltering(even_rad, config, np.random.default_rng([seed, 1]))
    assert len(pan_rad) == len(even_rad) + 5 + 2 * 4
    np.testing.assert_allclose(pan_rad[[0, -1]], even_rad[[0, -1]], atol=1e-9)
    steps = np.diff(pan_rad) / np.deg2rad(config.sweep_step_deg)
    assert np.sum(np.abs(steps) < 1e-9) == 4  # five frames of the same place
    assert np.sum(steps < 0) == 4
    assert 0.45 < np.abs(steps[steps > 1e-9] - 1).max() < 1.3
    assert len(np.unique(pan_rad)) == len(pan_rad) - 4 - 3  # of the way back and forth again, all but its end


def test_nothing_falters_by_default() -> None:
    even_rad = sweep(120.0, CONFIG, np.random.default_rng(3))
    np.testing.assert_allclose(faltering(even_rad, CONFIG, np.random.default_rng(4)), even_rad, atol=1e-12)
