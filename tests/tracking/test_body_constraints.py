"""Arms that stand beside the trunk are let alone; one inside it is driven out, by a derivative that is right. A spine
bends by what is believed of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.body.kinematics import forward, joint_angles, joints, retract
from pzcap.body.skeleton import DOF_SEGMENT, Body, build
from pzcap.tracking import body_constraints
from pzcap.tracking.settings import TrackingConfig
from pzcap.types import DOF, JOINTS, SEGMENTS, Pose, Subject
from sim.people.anthropometry import draw_measurements

_WRISTS = [JOINTS.index("left_wrist"), JOINTS.index("right_wrist")]


@pytest.fixture(scope="module")
def body() -> Body:
    return build(Subject(draw_measurements(np.random.default_rng(4)), 0.005))


def _arms(flexion: float, inward: float, elbow: float) -> Pose:
    """Upright; both arms raised forward, turned inward and bent (degrees)."""
    vectors = {name: Rotation.identity() for name in SEGMENTS}
    for side, sign in (("left_", 1.0), ("right_", -1.0)):
        vectors[side + "upper_arm"] = Rotation.from_euler("YZ", (-flexion, -sign * inward), degrees=True)
        vectors[side + "forearm"] = Rotation.from_euler("Y", -elbow, degrees=True)
    rotations = np.array([vectors[name].as_quat(scalar_first=True) for name in SEGMENTS])
    return Pose(np.array([0.3, -0.2, 0.9]), rotations)


@pytest.mark.parametrize("pose", [_arms(0, 0, 0), _arms(0, 0, 90), _arms(45, 70, 95), _arms(90, 0, 0)])
def test_arms_beside_and_before_the_trunk_are_let_alone(body: Body, pose: Pose) -> None:
    depth = body_constraints.collision_residuals(body_constraints.collision_shapes(body), forward(body, pose))[1]
    assert depth.max(initial=0.0) < 0.5, "sigmas: a hand may rest on the hip"


def test_a_forearm_in_the_chest_comes_out_in_front(body: Body) -> None:
    solid, pose = body_constraints.collision_shapes(body), _arms(2, 75, 95)
    before = joints(body, pose)[_WRISTS, 0]
    deep = body_constraints.collision_residuals(solid, forward(body, pose))[1].max()
    for _ in range(10):
        rows, depth = body_constraints.collision_residuals(solid, forward(body, pose))
        pose = retract(pose, -np.linalg.solve(rows.T @ rows + np.eye(DOF), rows.T @ depth))
    assert deep > 2.0
    assert depth.max(initial=0.0) < 0.2
    assert np.all(joints(body, pose)[_WRISTS, 0] > before + 0.02)


def test_the_derivative_agrees_with_finite_differences(body: Body) -> None:
    solid = body_constraints.collision_shapes(body)
    pose = retract(_arms(2, 75, 95), np.random.default_rng(0).normal(0.0, 0.1, DOF))
    rows, depth = body_constraints.collision_residuals(solid, forward(body, pose))
    assert len(depth) > 1
    step = 1e-6
    for d, axis in enumerate(np.eye(DOF)):
        ahead, back = (
            body_constraints.collision_residuals(solid, forward(body, retract(pose, k * step * axis)))[1]
            for k in (1, -1)
        )
        np.testing.assert_allclose(rows[:, d], (ahead - back) / (2 * step), rtol=1e-5, atol=1e-5)


_SPINE = [np.flatnonzero(SEGMENTS.index(name) == DOF_SEGMENT) for name in ("lumbar", "thorax")]


def _bent(lumbar_rad: float, thorax_rad: float) -> np.ndarray:
    """(43,) Joint angles of a spine that is bent forward."""
    angles = np.zeros(DOF)
    angles[_SPINE[0][1]], angles[_SPINE[1][1]] = lumbar_rad, thorax_rad
    return angles


def test_an_uneven_bend_of_the_spine_is_less_likely_than_an_even_one() -> None:
    assert body_constraints.spine(_bent(0.1, -0.1), 0.1)[2] > 3.0 * body_constraints.spine(_bent(0.1, 0.1), 0.1)[2]
    limp = np.zeros(DOF)
    limp[np.setdiff1d(np.arange(DOF), np.concatenate(_SPINE))] = 1.0
    assert body_constraints.spine(limp, 0.1)[2] == 0.0


def test_the_pull_of_the_spine_is_the_derivative_of_its_cost() -> None:
    angles = np.random.default_rng(1).normal(0.0, 0.2, DOF)
    pull = body_constraints.spine(angles, 0.1)[1]
    for d, axis in enumerate(np.eye(DOF)):
        ahead, back = (body_constraints.spine(angles + k * 1e-6 * axis, 0.1)[2] for k in (1, -1))
        assert -2.0 * pull[d] == pytest.approx((ahead - back) / 2e-6, rel=1e-5, abs=1e-6)


def test_a_spine_that_is_seen_to_bend_far_is_let_alone() -> None:
    near, far = (body_constraints.spine(_bent(rad, rad), 0.07)[1] for rad in (0.1, 0.8))
    assert np.linalg.norm(far) < np.linalg.norm(near)


def test_a_bent_spine_straightens_where_nothing_else_tells(body: Body) -> None:
    pose = retract(_arms(0, 0, 0), _bent(-0.12, 0.04))
    for _ in range(3):
        hessian, gradient = body_constraints.constraints(
            body, pose, 0.05, self_collision=False, spine_sigma_rad=TrackingConfig().spine_sigma_rad
        )
        pose = retract(pose, np.linalg.solve(hessian + 1e-3 * np.eye(DOF), gradient))
    assert np.abs(joint_angles(pose)[np.concatenate(_SPINE)]).max() < 1e-3


def test_a_spine_is_let_alone_where_nothing_is_believed_of_it(body: Body) -> None:
    bent = retract(_arms(0, 0, 0), _bent(-0.12, 0.04))
    hessian, gradient = body_constraints.constraints(body, bent, 0.05, self_collision=False, spine_sigma_rad=np.inf)
    assert not hessian.any()
    assert not gradient.any()
