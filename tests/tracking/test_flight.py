"""What is in the air falls; what stands, on the floor or on a box, does not."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pzcap.body import skeleton as bodies
from pzcap.body.skeleton import DOF, Body, forward, retract
from pzcap.tracking.banded_solver import smooth_step
from pzcap.tracking.frame_tracker import TrackingConfig
from pzcap.tracking.temporal_constraints import ballistic, masses
from pzcap.tracking.tuning import FLIGHT
from pzcap.types import SEGMENTS, Array, Pose, Subject
from sim import motion
from sim.people import athlete
from tests.scenes.body_scene import swing

RATE = 30.0  # frames a second
SIGMA_M_S2 = 1.0


@cache
def body() -> Body:
    return bodies.build(Subject(athlete.draw_measurements(athlete.AthleteConfig(), np.random.default_rng(1)), 0.005))


def centre(pose: Pose, model: Body | None = None) -> Array:
    """(3,) of mass."""
    model = model or body()
    share, inner = masses(model.surface)
    frames = forward(model, pose)
    return np.asarray(share @ (np.einsum("sij,sj->si", frames[:, :3, :3], inner) + frames[:, :3, 3]))


def moved(pose: Pose, by_m: Array) -> Pose:
    return replace(pose, root_position_m=pose.root_position_m + by_m)


def somersault(count: int) -> list[Pose]:
    """In the air, turning over and bending in every joint."""
    spin = np.random.default_rng(3).normal(0.0, 0.08, DOF)
    spin[:3] = 0.0
    poses = []
    for t in np.arange(count) / RATE:
        pose = retract(swing(0.2), spin * t * RATE)
        fallen = np.array([1.5 * t, -0.5 * t, 2.0 + 3.0 * t - FLIGHT.gravity_m_s2 * t**2 / 2])
        poses.append(moved(pose, fallen - centre(pose)))
    return poses


def test_all_of_a_body_has_mass_and_inside_it() -> None:
    share, inner = masses(body().surface)
    assert share.sum() == pytest.approx(1.0)
    assert (share > 0.002).all()
    for segment, _ in enumerate(SEGMENTS):
        skin = body().surface.points_m[body().surface.segment == segment]
        assert ((skin.min(axis=0) < inner[segment]) & (inner[segment] < skin.max(axis=0))).all()


def test_where_a_segment_has_its_origin_does_not_change_its_mass() -> None:
    surface, beside = body().surface, np.array([0.3, -0.2, 0.1])
    share, inner = masses(surface)
    again, moved = masses(replace(surface, points_m=surface.points_m + beside))
    np.testing.assert_allclose(again, share, atol=1e-9)
    np.testing.assert_allclose(moved, inner + beside, atol=1e-9)


def test_whatever_a_body_does_in_the_air_it_falls() -> None:
    poses = somersault(8)
    found = ballistic(body(), poses, RATE, SIGMA_M_S2)
    assert [tie.first for tie in found] == list(range(6))
    for tie in found:
        np.testing.assert_allclose(tie.residual_m, 0.0, atol=1e-12)
        np.testing.assert_allclose(tie.weight, (RATE**2 / SIGMA_M_S2) ** 2)


def test_how_a_fall_changes_is_differentiated() -> None:
    poses = somersault(3)
    (tie,) = ballistic(body(), poses, RATE, SIGMA_M_S2)
    step = 1e-6
    for which, k in itertools.product(range(3), range(DOF)):
        nudged = list(poses)
        nudged[which] = retract(poses[which], step * np.eye(DOF)[k])
        (other,) = ballistic(body(), nudged, RATE, SIGMA_M_S2)
        np.testing.assert_allclose((other.residual_m - tie.residual_m) / step, tie.jacobians[which][:, k], atol=1e-5)


def test_who_stands_is_not_falling_on_a_box_either() -> None:
    high = moved(swing(0.2), np.array([0.0, 0.0, 1.0]))
    low = [moved(pose, np.array([0.0, 0.0, -1.8])) for pose in somersault(3)]
    assert not ballistic(body(), [high] * 4, RATE, SIGMA_M_S2)
    assert not ballistic(body(), low, RATE, SIGMA_M_S2)


def test_what_is_not_seen_in_the_air_falls_on() -> None:
    """Images of the first two frames alone."""
    fallen = [moved(swing(0.2), centre(pose)) for pose in somersault(8)]
    chain = [moved(pose, np.array([0.0, 0.0, 0.001 * t**2])) for t, pose in enumerate(fallen)]
    seen, free = chain[:2], np.full(DOF, 0.05)
    for _ in range(3):
        tied = ballistic(body(), chain, RATE, 0.01)
        steps = smooth_step(chain[2:], [1e-9 * np.eye(DOF)] * 6, [np.zeros(DOF)] * 6, free, seen, tied)
        chain = [*seen, *(retract(pose, step) for pose, step in zip(chain[2:], steps, strict=True))]
    came = centre(seen[1]) - centre(seen[0])
    wanted = centre(seen[1]) + 6 * came - np.array([0.0, 0.0, FLIGHT.gravity_m_s2 / RATE**2]) * 21
    np.testing.assert_allclose(centre(chain[-1]), wanted, atol=0.005)


def test_what_is_claimed_of_a_fall_is_what_masses_make_it_wrong_by() -> None:
    """Somersaults and leaps of three athletes, whose masses are those of a table and not as their volume."""
    off = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        measures = athlete.draw_measurements(athlete.AthleteConfig(), rng)
        clip = motion.make("floor_exercise", measures, rng)
        times = np.arange(round(clip.duration_s * RATE)) / RATE
        flying = np.array([clip.airborne(t) for t in times])
        model = bodies.build(Subject(measures, 0.005))
        centres = [centre(clip.at(time), model) for time in times]
        fall = np.diff(centres, n=2, axis=0) * RATE**2 + [0.0, 0.0, FLIGHT.gravity_m_s2]
        off.append(fall[flying[:-2] & flying[1:-1] & flying[2:]])
    root_mean_square = float(np.sqrt(np.mean(np.vstack(off) ** 2)))
    assert 0.6 < root_mean_square / TrackingConfig().fall_sigma_m_s2 < 1.3
