"""The body: kinematics against MuJoCo's own, every derivative against finite differences, laws of the tangent."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pzcap.body import kinematics
from pzcap.body import skeleton as bodies
from pzcap.body.mesh import ellipse_half_axes
from pzcap.body.segment_equations import SegmentSums, lift
from pzcap.types import DOF, SEGMENTS, Array, Pose, PzcapError, Subject
from sim.people import athlete
from tests.scenes.bodies import BODY, random_pose, subject


@pytest.mark.parametrize("seed", [0, 1])
def test_joints_stand_where_mujoco_puts_them(seed: int) -> None:
    person = subject(seed)
    spec = mujoco.MjSpec()
    athlete.add_athlete(spec, person.measurements_m, athlete.AthleteConfig(), np.random.default_rng(seed))
    model = spec.compile()
    data = mujoco.MjData(model)
    body = bodies.build(Subject(person.measurements_m, 1e-6))
    for k in range(3):
        pose = random_pose(10 * seed + k)
        athlete.set_pose(model, data, pose)
        mujoco.mj_kinematics(model, data)
        frames = kinematics.forward(body, pose)
        for i, name in enumerate(SEGMENTS):
            np.testing.assert_allclose(frames[i, :3, 3], data.body(name).xpos, atol=1e-9)
            np.testing.assert_allclose(frames[i, :3, :3].ravel(), data.body(name).xmat, atol=1e-9)


@pytest.mark.parametrize("name", ["thorax", "head", "left_hand", "right_hand", "left_foot", "right_foot"])
def test_skin_lies_along_the_axes_that_an_athlete_s_does(name: str) -> None:
    """Palms face back in the zero pose: a hand that is broad from front to back is a forearm that is twisted."""
    person = subject(2)
    spec = mujoco.MjSpec()
    athlete.add_athlete(spec, person.measurements_m, athlete.AthleteConfig(), np.random.default_rng(2))
    model = spec.compile()
    own = np.flatnonzero(model.geom_bodyid == model.body(name).id)
    axes = Rotation.from_quat(model.geom_quat[own], scalar_first=True).as_matrix()
    size = model.geom_size[own]
    capsule = (model.geom_type[own] == mujoco.mjtGeom.mjGEOM_CAPSULE)[:, None]
    ellipsoids = np.linalg.norm(axes * size[:, None], axis=2)
    capsules = np.abs(axes[:, :, 2]) * size[:, 1:2] + size[:, :1]
    reach = np.where(capsule, capsules, ellipsoids)
    theirs = (model.geom_pos[own] + reach).max(axis=0) - (model.geom_pos[own] - reach).min(axis=0)
    skin = bodies.build(Subject(person.measurements_m, 1e-6)).surface
    ours = np.ptp(skin.points_m[skin.segment == SEGMENTS.index(name)], axis=0)
    np.testing.assert_allclose(np.log(ours / theirs), 0.0, atol=np.log(1.6))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 99), st.floats(1e-9, 1.0))
def test_difference_undoes_retract(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    pose, delta = random_pose(seed), size * rng.uniform(-1, 1, DOF)
    np.testing.assert_allclose(kinematics.difference(kinematics.retract(pose, delta), pose), delta, atol=1e-9)


def numeric(function: object, pose: Pose, step: float = 1e-6) -> Array:
    columns = []
    for k in range(DOF):
        delta = np.zeros(DOF)
        delta[k] = step
        ahead, behind = function(kinematics.retract(pose, delta)), function(kinematics.retract(pose, -delta))  # type: ignore[operator]
        columns.append((ahead - behind) / (2 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_joint_jacobians(seed: int) -> None:
    pose = random_pose(seed)
    expected = numeric(lambda p: kinematics.joints(BODY, p), pose)
    np.testing.assert_allclose(kinematics.joint_jacobians(kinematics.forward(BODY, pose)), expected, atol=1e-7)


@given(st.integers(0, 2**31), st.sampled_from([0.0, 1e-12, 1e-5, 0.3, 2.0, np.pi - 1e-3, np.pi - 1e-9]))
def test_turns_between_frames_are_those_of_scipy(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(4, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    before, after = np.tile(np.eye(4), (4, 1, 1)), np.tile(np.eye(4), (4, 1, 1))
    before[:, :3, :3] = Rotation.random(4, random_state=rng).as_matrix()
    after[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix() @ before[:, :3, :3]
    np.testing.assert_allclose(kinematics.turned(before, after), vectors, atol=1e-6)


@pytest.mark.parametrize("segment", range(len(SEGMENTS)))
def test_point_jacobian(segment: int) -> None:
    pose, local = random_pose(segment), np.array([0.1, -0.05, -0.2, 1.0])
    frames = kinematics.forward(BODY, pose)
    expected = numeric(lambda p: (kinematics.forward(BODY, p)[segment] @ local)[:3], pose)
    got = kinematics.point_jacobians(frames, np.array([segment]), (frames[segment] @ local)[None, :3])[0]
    np.testing.assert_allclose(got, expected, atol=1e-7)


def test_lifting_segments_equals_the_dense_normal_equations() -> None:
    rng = np.random.default_rng(4)
    pose = random_pose(4)
    frames = kinematics.forward(BODY, pose)
    centre = frames[0, :3, 3]
    hessians, gradients = np.zeros((16, 6, 6)), np.zeros((16, 6))
    dense_h, dense_g = np.zeros((DOF, DOF)), np.zeros(DOF)
    for _ in range(200):
        s = int(rng.integers(16))
        point, a, residual = rng.normal(0, 1, 3) + centre, rng.normal(0, 1, 3), rng.normal()
        row = np.concatenate([a, np.cross(point - centre, a)])
        hessians[s] += np.outer(row, row)
        gradients[s] += row * residual
        full = a @ kinematics.point_jacobians(frames, np.array([s]), point[None])[0]
        dense_h += np.outer(full, full)
        dense_g += full * residual
    hessian, gradient = lift(SegmentSums(hessians, gradients, centre), kinematics.screws(frames, centre))
    np.testing.assert_allclose(hessian, dense_h, atol=1e-9)
    np.testing.assert_allclose(gradient, dense_g, atol=1e-9)


def test_skin_is_closed_and_its_normals_point_outward() -> None:
    surface = BODY.surface
    for s in range(len(SEGMENTS)):
        faces = surface.faces[surface.segment[surface.faces[:, 0]] == s]
        directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        assert {tuple(e) for e in directed} == {tuple(e[::-1]) for e in directed}, "every edge runs once each way"
        a, b, c = (surface.points_m[faces[:, k]] for k in range(3))
        assert np.sum(np.cross(a, b) * c) > 0, "positive volume: counter-clockwise from outside"
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-12)
    assert 1.5 < surface.area_m2.sum() < 3.0


@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.3, 3.0])
def test_a_ring_has_the_girth_that_was_measured(ratio: float) -> None:
    depth, width = ellipse_half_axes(0.9, ratio)
    phi = np.linspace(0, 2 * np.pi, 20001)
    ring = np.stack([depth * np.cos(phi), width * np.sin(phi)], axis=1)
    assert np.sum(np.linalg.norm(np.diff(ring, axis=0), axis=1)) == pytest.approx(0.9, rel=1e-6)
    assert depth / width == pytest.approx(ratio)


def test_a_skirt_hangs_from_the_pelvis_to_the_middle_of_the_thighs() -> None:
    tape = subject(0).measurements_m
    dressed = bodies.build(Subject(tape, 0.005, loose_m={"trousers": 0.03, "skirt": 0.05}))
    bare = bodies.build(Subject(tape, 0.005, loose_m={"trousers": 0.03}))
    of_pelvis, of_thigh = (SEGMENTS.index(name) for name in ("pelvis", "left_thigh"))
    assert dressed.loose_m[of_pelvis] == 0.05
    assert dressed.loose_m[of_thigh] == 0.03
    skirt = dressed.surface.points_m[dressed.surface.segment == of_pelvis]
    assert skirt[:, 2].min() == pytest.approx(-0.5 * tape["thigh"] - 0.04, abs=0.01)
    assert bare.surface.points_m[bare.surface.segment == of_pelvis][:, 2].min() > -0.2
    # at its hem it is as wide as at the hips
    hem = skirt[np.abs(skirt[:, 2] + 0.35 * tape["thigh"]) < 0.02]
    hips = skirt[np.abs(skirt[:, 2]) < 0.02]
    np.testing.assert_allclose(np.ptp(hem, axis=0)[1], np.ptp(hips, axis=0)[1], atol=0.03)
    for body in (dressed, bodies.of(dressed.measured, dressed.worn)):
        np.testing.assert_array_equal(body.surface.points_m, dressed.surface.points_m)
    assert (dressed.offsets_m == bare.offsets_m).all()
    wide = bodies.build(Subject(tape, 0.005, loose_m={"skirt": 0.5}))  # however wide, it hides the pelvis
    assert wide.surface.points_m[wide.surface.segment == of_pelvis][:, 2].min() < -0.09


def test_limits_leave_the_standing_body_alone_and_catch_a_knee_that_bends_forward() -> None:
    standing = Pose(np.zeros(3), np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1)))
    assert not kinematics.limit_residuals(standing)[0].any()
    delta = np.where(SEGMENTS.index("left_shank") == bodies.DOF_SEGMENT, -0.5, 0.0)
    residual, _ = kinematics.limit_residuals(kinematics.retract(standing, delta))
    assert np.flatnonzero(residual).tolist() == np.flatnonzero(delta).tolist()


def test_an_absurd_measurement_is_named() -> None:
    measured = subject().measurements_m
    with pytest.raises(PzcapError, match=r"girth_chest = 95.* metres"):
        bodies.build(Subject({**measured, "girth_chest": 95.0}, 0.005))
