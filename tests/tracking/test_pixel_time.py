"""Views that are not exposed at one instant: where their skin is, and what the body tells of the clocks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pzcap.body.kinematics import forward, place, retract, screws, world_points
from pzcap.body.segment_equations import SegmentSums, lift
from pzcap.body.skeleton import MOVES
from pzcap.geometry.pinhole import projected
from pzcap.tracking.camera_refinement import CAMERA_DOF, eliminate, segment_twists
from pzcap.tracking.pixel_time import (
    ClockEstimate,
    ClockSystem,
    Exposure,
    clock_equations,
    exposed,
    moved_frames,
    rates_between,
    sequence_rates,
)
from pzcap.tracking.tracker import Tracker, TrackInput
from pzcap.tracking.tuning import CLOCK
from pzcap.tracking.visibility import SkinPoints
from pzcap.types import DOF, SEGMENTS, Array
from tests.scenes.body_scene import Clip, shoot
from tests.scenes.tracked import CONFIG, FRAMES, as_fields, by_hand, clip, inputs_of, taped, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
CLOCKS = (0.30, -0.25, 0.15, -0.20)  # frame periods
UP = np.array([0.0, 0.0, 1.0])


@cache
def late() -> Clip:
    """The clip, filmed by cameras whose clocks are off by CLOCKS."""
    return shoot(FRAMES, clocks=CLOCKS)


def test_rows_are_exposed_about_the_clock_s_time() -> None:
    times = Exposure(0.2, -0.5).times(np.array([-0.5, 119.5, 239.5, 900.0]), 240)
    np.testing.assert_allclose(times, [0.45, 0.2, -0.05, -0.05])  # what lies beyond the image is as its edge


@settings(deadline=None)  # the first one compiles
@given(st.integers(0, 2**31), st.floats(-0.5, 0.5))
def test_skin_moves_as_the_segments_do(seed: int, time: float) -> None:
    """To first order in time, against the pose moved by its tangent; `moved_frames` likewise."""
    rng = np.random.default_rng(seed)
    body, pose, small = true_body(), clip().poses[3], 1e-5
    tangent = rng.normal(0.0, 1.0, DOF)
    frames = forward(body, pose)
    rates = rates_between(
        forward(body, retract(pose, -small * tangent)), forward(body, retract(pose, small * tangent)), 2.0
    )
    segment, local = rng.integers(0, len(SEGMENTS), 50), rng.normal(0.0, 0.2, (50, 3))
    points = np.asfortranarray(world_points(frames, segment, local))
    after = forward(body, retract(pose, time * small * tangent))
    there = world_points(after, segment, local)
    speed = np.abs(there - points).max() + 1e-12
    skin, camera = SkinPoints(points, np.zeros_like(points), segment), clip().shots[0][0].camera
    late = exposed(skin, frames, rates, camera, Exposure(0.4 * time, 0.0, 0.6 * time))
    assert np.abs(late - there).max() < 1e-3 * speed + 1e-12
    np.testing.assert_allclose(moved_frames(frames, rates, np.full(16, time)), after, atol=1e-3 * speed + 1e-12)


def test_each_point_moves_for_the_time_of_its_row() -> None:
    body, camera, exposure = true_body(), clip().shots[0][0].camera, Exposure(0.1, 0.6, -0.05)
    frames, rates = forward(body, clip().poses[3]), np.random.default_rng(1).normal(0.0, 0.1, (len(SEGMENTS), 12))
    skin = SkinPoints(*place(body, frames), body.surface.segment)
    times = exposure.times(projected(skin.points, camera)[0][:, 1], camera.height)
    assert np.ptp(times) > 0.1
    arm = skin.points - frames[skin.segment, :3, 3]
    velocity, turning, acceleration, faster = rates[skin.segment].reshape(-1, 4, 3).transpose(1, 0, 2)
    spun = np.cross(turning, arm)
    moved = skin.points + times[:, None] * (velocity + spun)
    moved += 0.5 * times[:, None] ** 2 * (acceleration + np.cross(faster, arm) + np.cross(turning, spun))
    np.testing.assert_allclose(exposed(skin, frames, rates, camera, exposure), moved, atol=1e-12)


@pytest.mark.parametrize("period", [-1.0, 1.0, 2.0])
def test_rates_of_a_sequence_lead_to_the_instants_about(period: float) -> None:
    """Joints meet both; segments turn there to second order, as a body does that spins and speeds up."""
    spin, slower = np.array([0.02, -0.03, 0.05]), np.array([0.004, 0.002, -0.003])
    frames = np.tile(np.eye(4), (3, len(SEGMENTS), 1, 1))
    for k, t in enumerate((-1.0, 0.0, 1.0)):
        frames[k, :, :3, 3] = np.array([t, 2.0 - t * t, 0.1 * t])
        frames[k, :, :3, :3] = Rotation.from_rotvec(t * spin + 0.5 * t * t * slower).as_matrix()
    _, rates, _ = sequence_rates(list(frames), period)
    for k, t in ((0, -period), (2, period)):
        there = moved_frames(frames[1], rates, np.full(len(SEGMENTS), t))
        np.testing.assert_allclose(there[:, :3, 3], frames[k, :, :3, 3], atol=1e-12)
        np.testing.assert_allclose(there[:, :3, :3], frames[k, :, :3, :3], atol=2e-4)


def test_rates_of_a_sequence_are_central_differences() -> None:
    frames = [forward(true_body(), pose) for pose in clip().poses[:3]]
    found = sequence_rates(frames, 1.0)
    np.testing.assert_allclose(found[1][:, :3], (frames[2] - frames[0])[:, :3, 3] / 2.0)
    np.testing.assert_allclose(found[0][:, :3], (frames[1] - frames[0])[:, :3, 3])
    assert not sequence_rates(frames[:1], 1.0)[0].any()
    for whole, half in zip(found, sequence_rates(frames, 0.5), strict=True):
        np.testing.assert_allclose(half[:, :6], 2.0 * whole[:, :6])  # as far in half the time
        assert not half[:, 6:].any(), "of fields a parabola leads anywhere"


@pytest.mark.parametrize("with_camera", [False, True])
def test_clocks_are_solved_for_as_if_with_all_else_at_once(with_camera: bool) -> None:
    """Two instants and two views: the Schur complement against the whole least-squares problem."""
    rng, frames = np.random.default_rng(5), forward(true_body(), clip().poses[0])
    centre = np.ascontiguousarray(frames[0, :3, 3])
    twists, stiff = screws(frames, centre), 3.0 * np.eye(DOF)
    prior, known = ClockEstimate.of(2, 0.3), np.diag([30.0, 20.0])
    system, blocks, right, unknowns = ClockSystem(prior), [], [], 2 + 2 * (DOF + 2 * CAMERA_DOF)
    for instant in range(2):
        hessian, gradient = np.zeros((DOF, DOF)), np.zeros(DOF)
        velocity = rng.normal(0.0, 0.1, (len(SEGMENTS), 6))
        told = []
        for view in range(2):
            rows, residuals = rng.normal(size=(len(SEGMENTS), 20, 6)), rng.normal(size=(len(SEGMENTS), 20))
            sums = SegmentSums(np.einsum("sni,snj->sij", rows, rows), np.einsum("sni,sn->si", rows, residuals), centre)
            own = lift(sums, twists)
            moves = segment_twists(clip().shots[0][view].camera.world_T_cam, UP, frames, centre)
            hessian += own[0]
            gradient += own[1]
            camera = None
            if with_camera:
                camera = eliminate(sums, moves, known, np.zeros(2), twists, hessian, gradient), moves
            told.append(clock_equations(sums, velocity, frames, twists, camera))
            about = velocity.copy()
            about[:, :3] += np.cross(velocity[:, 3:], centre - frames[:, :3, 3])
            jacobian = np.zeros((len(SEGMENTS) * 20, unknowns))
            jacobian[:, view] = np.einsum("sni,si->sn", rows, about).ravel()
            start = 2 + instant * (DOF + 2 * CAMERA_DOF)
            by_pose = np.einsum("sni,di,ds->snd", rows, twists, MOVES.astype(np.float64))
            jacobian[:, start : start + DOF] = by_pose.reshape(-1, DOF)
            if with_camera:
                at = start + DOF + view * CAMERA_DOF
                jacobian[:, at : at + CAMERA_DOF] = (rows @ moves).reshape(-1, CAMERA_DOF)
            blocks.append(jacobian)
            right.append(residuals.ravel())
        system.add(told, hessian + stiff, gradient)
    jacobian, residual = np.vstack(blocks), np.concatenate(right)
    whole = jacobian.T @ jacobian
    whole[:2, :2] += CLOCK.doubt * prior.information
    for instant in range(2):
        start = 2 + instant * (DOF + 2 * CAMERA_DOF)
        whole[start : start + DOF, start : start + DOF] += stiff
        for view in range(2):
            at = start + DOF + view * CAMERA_DOF
            whole[at : at + CAMERA_DOF, at : at + CAMERA_DOF] += known
    expected = np.linalg.solve(whole, jacobian.T @ residual)[:2]
    np.testing.assert_allclose(system.solve(np.zeros(2)).clock, expected, rtol=1e-6)


def test_clocks_drift_and_what_they_share_is_not_told() -> None:
    estimate = ClockEstimate(np.array([1e-3, -1e-3, 0.0]), np.eye(3) * 1e4 - 1e4 / 3 + np.eye(3) * 1e-2)
    assert (estimate.sigma < 0.0101).all()  # though each by itself is not known to better than 5
    later = estimate.after(3000)
    np.testing.assert_allclose(later.clock, estimate.clock)
    assert (later.sigma > 0.2).all()
    further = replace(estimate, clock=np.array([0.5, -0.5, 0.0]))  # comes out too small by a share
    np.testing.assert_allclose(further.sigma[:2] ** 2, estimate.sigma[:2] ** 2 + (0.5 * CLOCK.short) ** 2, rtol=1e-3)
    assert further.sigma[2] == pytest.approx(estimate.sigma[2])


def errors_mm(tracker: Tracker, items: tuple[TrackInput, ...]) -> Array:
    results = [result for item in items for result in tracker.push(item)] + tracker.finish()
    return 1e3 * np.array([np.linalg.norm(r.joints_m - clip().joints_m[r.frame], axis=1) for r in results])


def test_the_moving_body_tells_the_clocks() -> None:
    """With clocks that are believed to be locked the motion is off; without, the offsets are found."""
    items, keys = inputs_of(late()), [by_hand(0), by_hand(FRAMES - 1)]
    free, locked = Tracker(taped(), keys, CONFIG), Tracker(taped(), keys, replace(CONFIG, clock_sigma=0.0))
    off = errors_mm(free, items)[1:-1].mean(), errors_mm(locked, items)[1:-1].mean()
    assert free.clocks is not None
    apart = free.clocks.clock - free.clocks.clock.mean() - (np.array(CLOCKS) - np.mean(CLOCKS))
    assert np.sqrt(np.mean(apart**2)) < 0.03  # a millisecond
    assert off[0] < 0.7 * off[1]


def test_the_clocks_of_interlaced_cameras_are_in_periods_of_frames() -> None:
    """The same pictures taken for fields: twice as many a frame period, and so the clocks are half as far off."""
    keys = [by_hand(0), replace(by_hand(FRAMES - 1), frame=FRAMES // 2)]
    tracker = Tracker(taped(), keys, CONFIG, by_fields=True)
    for item in as_fields(inputs_of(late())):
        tracker.push(item)
    tracker.finish()
    assert tracker.clocks is not None
    apart = tracker.clocks.clock - tracker.clocks.clock.mean() - 0.5 * (np.array(CLOCKS) - np.mean(CLOCKS))
    assert np.sqrt(np.mean(apart**2)) < 0.015
