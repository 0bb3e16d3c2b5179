"""Clicks pose the body: their derivatives, what follows a drag and what stays, what the covariance claims."""

from __future__ import annotations

import numpy as np
import pytest

from pzcap.body.kinematics import joint_angles, joints, limit_residuals, retract
from pzcap.editor.inverse_kinematics import HANDLES, MIRRORED, Click, Held, Problem, epipolar, is_ready, loose, standing
from pzcap.types import DOF, Array, Pose
from tests.scenes import edited
from tests.scenes.bodies import BODY, random_pose
from tests.scenes.captures import project


def off_m(pose: Pose, frame: int = 0) -> Array:
    """(16,) by how much the joints of a pose are off."""
    return np.linalg.norm(joints(edited.BODY, pose) - joints(edited.BODY, edited.true_pose(frame)), axis=1)


def test_the_derivatives_are_those_of_finite_differences() -> None:
    pose = random_pose(3, 0.4)
    pose = retract(pose, np.r_[np.array([-2.0, 0.0, 0.95]) - pose.root_position_m, np.zeros(DOF - 3)])
    problem = Problem(BODY, edited.cameras(0))
    clicks = [Click(handle, handle % 4, 150.0 + handle, 110.0, 2.0) for handle in range(len(HANDLES))]
    _, rows = problem.residuals(pose, clicks)
    step = 1e-6
    for dof in range(DOF):
        delta = np.zeros(DOF)
        delta[dof] = step
        ahead, behind = (problem.residuals(retract(pose, way * delta), clicks)[0] for way in (1.0, -1.0))
        # the residual is click minus projection, over a sigma that grows a little with nearness
        slope = -(ahead - behind) / (2 * step)
        assert np.allclose(slope, rows[:, dof], atol=2e-2 * np.abs(rows[:, dof]).max() + 2e-2), dof


def test_a_standing_body_comes_to_where_it_was_clicked() -> None:
    problem = edited.problem()
    start = standing(problem.cameras)
    assert start is not None
    clicks = edited.clicks(0, (0, 1))
    found = problem.settle(start, clicks, Held.of(start, "standing"))
    assert off_m(found.pose).max() < 0.03
    sigma = problem.sigma_m(found.pose, problem.covariance(found.pose, clicks, loose("standing")))
    assert is_ready(sigma)


def test_turned_the_wrong_way_it_is_turned_round() -> None:
    problem = edited.problem()
    truth = edited.true_pose(0)
    away = retract(truth, np.r_[np.zeros(5), np.pi, np.zeros(DOF - 6)])
    found = problem.settle(away, edited.clicks(0, (0, 1)), Held.of(away, "tracker"))
    assert off_m(found.pose).max() < 0.03


def test_noise_of_two_pixels_costs_what_the_covariance_says() -> None:
    """Over seeds, in sigmas: honest, and not idle."""
    problem, truth = edited.problem(), edited.true_pose(0)
    ratios = []
    for seed in range(3):
        clicks = [one._replace(sigma_px=2.0) for one in edited.clicks(0, (0, 1, 2, 3), 2.0, seed)]
        found = problem.settle(truth, clicks, Held.of(truth, "standing"))
        sigma = problem.sigma_m(found.pose, problem.covariance(found.pose, clicks, loose("standing")))[:16]
        ratios.append(off_m(found.pose) / sigma)
        assert sigma.max() < 0.06
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_an_arm_follows_its_hand_and_the_rest_stays() -> None:
    problem, start = edited.problem(), edited.true_pose(0)
    wrist, before = HANDLES.index("right_wrist"), problem.handles(start)
    pixel = project(problem.cameras[1], before)[wrist] + [10.0, -14.0]
    click = Click(wrist, 1, *pixel.tolist(), 1.0)
    found = problem.solve(start, [click], Held.of(start, "tracker"), 8)
    after = problem.handles(found.pose)
    assert np.linalg.norm(project(problem.cameras[1], after)[wrist] - pixel) < 0.5
    moved = np.linalg.norm(after - before, axis=1)
    legs = [n for n, name in enumerate(HANDLES) if "ankle" in name or "knee" in name or name == "pelvis"]
    assert moved[wrist] > 0.25
    assert moved[legs].max() < 0.2 * moved[wrist]


@pytest.mark.parametrize(("frame", "views"), [(3, (1, 3)), (9, (0, 2))])
def test_two_opposite_views_leave_the_depth_as_it_was(frame: int, views: tuple[int, int]) -> None:
    """The athlete stands all but on the line between the cameras; noise would move the wrist along it by a metre."""
    problem, start = edited.problem(frame), edited.true_pose(frame)
    wrist, before = HANDLES.index("left_wrist"), problem.handles(start)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        seen = {view: project(problem.cameras[view], before)[wrist] + rng.normal([0.0, -3.0], 2.0) for view in views}
        clicks = [Click(wrist, view, *pixel.tolist(), 1.5) for view, pixel in seen.items()]
        found = problem.settle(start, clicks, Held.of(start, "tracker"), [wrist])
        moved = np.linalg.norm(problem.handles(found.pose) - before, axis=1)
        assert moved[:3].max() < 0.05
        assert 0.05 < moved[wrist] < 0.25


def test_joints_keep_to_their_limits_and_out_of_reach_stays_finite() -> None:
    problem, start = edited.problem(), edited.true_pose(0)
    ankle = HANDLES.index("left_ankle")
    for way in ([400.0, -300.0], [-500.0, 50.0]):
        pixel = project(problem.cameras[0], problem.handles(start))[ankle] + way
        pose = problem.solve(start, [Click(ankle, 0, *pixel.tolist(), 1.0)], Held.of(start, "tracker"), 40).pose
        assert np.isfinite(pose.rotations).all()
        knee = joint_angles(pose)[np.flatnonzero(np.abs(limit_residuals(pose)[0]) > np.deg2rad(15.0))]
        assert len(knee) == 0


def test_what_no_click_bears_on_is_not_known() -> None:
    problem, pose = edited.problem(), edited.true_pose(0)
    clicks = [one for one in edited.clicks(0, (0, 1)) if "left" not in HANDLES[one.handle]]
    sigma = problem.sigma_m(pose, problem.covariance(pose, clicks, loose("standing")))
    left, right = (sigma[HANDLES.index(f"{side}_wrist")] for side in ("left", "right"))
    assert left > 4 * right
    assert not is_ready(sigma)
    one_view = problem.covariance(pose, [one for one in clicks if one.camera == 0], loose("standing"))
    assert problem.sigma_m(pose, one_view)[0] > 5 * sigma[0]


def test_clicks_that_contradict_each_other_are_trusted_less() -> None:
    problem, pose = edited.problem(), edited.true_pose(0)
    clicks = edited.clicks(0, (0, 1))
    wrong = [one._replace(x=one.x + 40.0) if one.camera else one for one in clicks]
    found = problem.settle(pose, wrong, Held.of(pose, "keyframe")).pose
    sure, unsure = (
        problem.sigma_m(found, problem.covariance(found, these, loose("standing"))).max() for these in (clicks, wrong)
    )
    assert unsure > 1.2 * problem.sigma_m(pose, problem.covariance(pose, clicks, loose("standing"))).max()
    assert np.isfinite(sure)


def test_the_epipolar_line_meets_the_point() -> None:
    problem = edited.problem()
    world = problem.handles(edited.true_pose(0))
    for other in (1, 2, 3):
        pixel, there = (project(problem.cameras[n], world)[5] for n in (0, other))
        line = epipolar(problem.cameras[0], pixel, problem.cameras[other])  # type: ignore[arg-type]
        ways = np.diff(line, axis=0)
        along = np.clip(np.sum((there - line[:-1]) * ways, axis=1) / np.sum(ways**2, axis=1), 0, 1)
        assert np.linalg.norm(line[:-1] + along[:, None] * ways - there, axis=1).min() < 0.5


@pytest.mark.parametrize("limbs", ["legs", "whole"])
def test_left_and_right_are_exchanged(limbs: str) -> None:
    problem, pose = edited.problem(), edited.true_pose(0)
    names = ("knee", "ankle", "toe", "heel")
    chosen = [n for n, name in enumerate(HANDLES) if name.partition("_")[2] in names] if limbs == "legs" else []
    before, after = problem.handles(pose), problem.handles(problem.exchanged(pose, chosen))
    ankle = HANDLES.index("left_ankle")
    assert np.linalg.norm(after[ankle] - before[MIRRORED[ankle]]) < 0.2
    assert np.linalg.norm(after[ankle] - before[ankle]) > 0.3
    wrist = HANDLES.index("left_wrist")
    stays = np.linalg.norm(after[wrist] - before[wrist]) < 0.05
    assert stays == (limbs == "legs")
