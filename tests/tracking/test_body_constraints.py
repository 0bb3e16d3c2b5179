"""Arms that stand beside the trunk are let alone; one inside it is driven out, by a derivative that is right."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.body.kinematics import forward, joints, retract
from pzcap.body.skeleton import DOF, Body, build
from pzcap.tracking import body_constraints
from pzcap.types import JOINTS, SEGMENTS, Pose, Subject
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
