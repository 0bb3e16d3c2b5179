"""The athlete measured on the compiled model: joints, girths by slicing, limits, what the camera sees."""

from __future__ import annotations

import cv2
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, MEASUREMENTS, PARENTS, SEGMENTS, Array, Image, Mask, Pose, without_side
from sim import motion
from sim.cameras.render import Stage
from sim.people.anthropometry import body_tree, draw_measurements, joint_limit_rad
from sim.people.athlete import GEOM_GROUP, AthleteConfig, add_athlete, set_pose

SEEDS = st.integers(min_value=0, max_value=99)
IDENTITY = Rotation.identity(16).as_quat(scalar_first=True)


def scene(seed: int, config: AthleteConfig | None = None) -> tuple[mujoco.MjSpec, dict[str, float]]:
    rng = np.random.default_rng(seed)
    config = config or AthleteConfig()
    measurements = draw_measurements(rng)
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient = [1.0, 1.0, 1.0]
    spec.visual.headlight.diffuse = [0.0, 0.0, 0.0]
    add_athlete(spec, measurements, config, rng)
    return spec, measurements


def build(seed: int) -> tuple[mujoco.MjModel, mujoco.MjData, dict[str, float]]:
    spec, measurements = scene(seed)
    model = spec.compile()
    return model, mujoco.MjData(model), measurements


def stand(model: mujoco.MjModel, data: mujoco.MjData, m: dict[str, float], rotations: Array = IDENTITY) -> None:
    set_pose(model, data, Pose(np.array([0.0, 0.0, m["thigh"] + m["shank"] + m["ankle_height"]]), rotations))
    mujoco.mj_kinematics(model, data)


def support(model: mujoco.MjModel, data: mujoco.MjData, direction: Array) -> float:
    """Return how far (m) the body's geoms reach in a direction."""
    reach = []
    for g in range(model.ngeom):
        local = data.geom_xmat[g].reshape(3, 3).T @ direction
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            extent = np.linalg.norm(local * model.geom_size[g])
        else:
            extent = model.geom_size[g, 0] + model.geom_size[g, 1] * abs(local[2])
        reach.append(data.geom_xpos[g] @ direction + extent)
    return float(max(reach))


def girth(model: mujoco.MjModel, data: mujoco.MjData, segment: str, height: float, middle: Array) -> float:
    """Return what a taut tape reads about one segment's geoms at a height (m, world): the hull of the slice."""
    body = model.body(segment).id
    points = []
    azimuth = np.linspace(0.0, 2 * np.pi, 180, endpoint=False)
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    for g in np.flatnonzero(model.geom_bodyid == body):
        origin = np.array([*middle, height])
        for ray in rays:
            # From outside inwards, so that the far side of an off-centre geom does not count.
            distance = mujoco.mju_rayGeom(
                data.geom_xpos[g], data.geom_xmat[g], model.geom_size[g], origin + ray, -ray, model.geom_type[g], None
            )
            if distance >= 0:
                points.append((origin + ray * (1 - distance))[:2])
    hull = np.array(points)[ConvexHull(points).vertices]
    return float(np.linalg.norm(np.diff(np.vstack([hull, hull[:1]]), axis=0), axis=1).sum())


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_measurements_are_plausible(seed: int) -> None:
    m = draw_measurements(np.random.default_rng(seed))
    assert tuple(m) == MEASUREMENTS
    assert 1.5 < m["stature"] < 1.95
    column = m["trunk"] + m["head"] + m["thigh"] + m["shank"] + m["ankle_height"]
    np.testing.assert_allclose(column, m["stature"], rtol=1e-12)
    assert m["girth_chest"] > m["girth_waist"] > m["girth_thigh"] > m["girth_calf"] > m["girth_ankle"]
    assert m["girth_upper_arm"] > m["girth_wrist"]
    assert m["shoulder_width"] > 1.7 * m["hip_width"]


def test_seeds_give_different_people_and_the_same_seed_the_same() -> None:
    people = [draw_measurements(np.random.default_rng(seed)) for seed in (0, 1, 0)]
    assert people[0] != people[1]
    assert people[0] == people[2]


def test_tree_has_43_degrees_of_freedom_and_named_joints() -> None:
    model, _, _ = build(0)
    assert model.nv == 43
    assert {model.body(i).name for i in range(1, model.nbody)} == set(SEGMENTS)
    assert {model.joint(i).name for i in range(model.njnt)} == {"root", *SEGMENTS[1:]}
    assert set(model.geom_group) == {GEOM_GROUP}
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    for s, name in enumerate(SEGMENTS[1:], start=1):
        joint = model.joint(name)
        kind = mujoco.mjtJoint.mjJNT_HINGE if name in HINGE_AXES else mujoco.mjtJoint.mjJNT_BALL
        assert joint.type[0] == kind
        assert model.jnt_limited[joint.id]
        np.testing.assert_allclose(joint.range, joint_limit_rad(name), atol=1e-9)
        assert model.body(name).parentid[0] == model.body(SEGMENTS[PARENTS[s]]).id


@pytest.mark.parametrize("seed", [0, 3])
def test_zero_pose_stands_on_its_soles_and_is_as_tall_as_measured(seed: int) -> None:
    model, data, m = build(seed)
    stand(model, data, m)
    assert support(model, data, np.array([0.0, 0.0, -1.0])) == pytest.approx(0.0, abs=0.004)
    assert support(model, data, np.array([0.0, 0.0, 1.0])) == pytest.approx(m["stature"], abs=0.005)
    z = {name: data.body(name).xpos[2] for name in SEGMENTS}
    assert z["head"] - z["pelvis"] == pytest.approx(m["trunk"])
    assert z["head"] - z["left_upper_arm"] == pytest.approx(m["shoulder_drop"])
    assert data.body("left_upper_arm").xpos[1] == pytest.approx(m["shoulder_width"] / 2)
    assert data.body("right_thigh").xpos[1] == pytest.approx(-m["hip_width"] / 2)
    assert z["left_foot"] == pytest.approx(m["ankle_height"])
    assert z["left_upper_arm"] - z["left_hand"] == pytest.approx(m["upper_arm"] + m["forearm"])


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize(
    ("name", "segment", "along"),
    [
        ("girth_chest", "thorax", 0.16), ("girth_waist", "lumbar", 0.105), ("girth_upper_arm", "left_upper_arm", -0.36),
        ("girth_forearm", "right_forearm", -0.28), ("girth_wrist", "left_forearm", -0.97),
        ("girth_thigh", "left_thigh", -0.26), ("girth_knee", "right_thigh", -0.995),
        ("girth_calf", "left_shank", -0.30), ("girth_ankle", "right_shank", -0.97),
    ],
)  # fmt: skip
def test_girths_are_those_of_the_tape(name: str, segment: str, along: float, seed: int) -> None:
    model, data, m = build(seed)
    stand(model, data, m)
    kind = without_side(segment)
    length = m["trunk"] if kind in ("thorax", "lumbar") else m[kind]
    origin = data.body(segment).xpos
    assert girth(model, data, segment, origin[2] + along * length, origin[:2]) == pytest.approx(m[name], rel=0.06)


def test_set_pose_puts_joints_where_the_tree_says() -> None:
    model, data, m = build(2)
    clip = motion.make("pedestrian", m, np.random.default_rng(2))
    tree = body_tree(m)
    for t in (0.3, 2.0, 4.4):
        pose = clip.at(t)
        set_pose(model, data, pose)
        mujoco.mj_kinematics(model, data)
        world = [Rotation.from_quat(pose.rotations[0], scalar_first=True)]
        joints = [pose.root_position_m]
        for s in range(1, 16):
            p = PARENTS[s]
            joints.append(joints[p] + world[p].apply(tree.offsets_m[s]))
            world.append(world[p] * Rotation.from_quat(pose.rotations[s], scalar_first=True))
        found = np.array([data.body(name).xpos for name in SEGMENTS])
        np.testing.assert_allclose(found, joints, atol=1e-6)


@given(st.floats(-0.05, 2.6), st.sampled_from(sorted(HINGE_AXES)), st.sampled_from([-1.0, 1.0]))
@settings(max_examples=30, deadline=None)
def test_hinges_take_either_sign_of_the_quaternion(angle: float, name: str, sign: float) -> None:
    model, data, m = _MODEL
    rotations = IDENTITY.copy()
    axis = np.array(HINGE_AXES[name])
    rotations[SEGMENTS.index(name)] = sign * np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    stand(model, data, m, rotations)
    assert data.qpos[model.joint(name).qposadr[0]] == pytest.approx(angle, abs=1e-9)


_MODEL = build(0)


def _render(config: AthleteConfig, seed: int = 1) -> tuple[Image, Mask]:
    spec, m = scene(seed, config)
    stage = Stage(spec, 240, 360, GEOM_GROUP, 3)
    stand(stage.model, stage.data, m)
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = [[0, 0, -1], [1, 0, 0], [0, -1, 0]]  # in front of the athlete, looking at the face
    world_T_cam[:3, 3] = (2.6, 0.0, 0.5 * m["stature"])
    stage.aim(world_T_cam, 45.0)
    picture, mask = stage.picture((240, 360), athlete=True)[::-1].copy(), stage.mask((240, 360))[::-1] > 0
    stage.close()
    return picture, mask


def _texture(config: AthleteConfig) -> float:
    """Return the mean of the local contrast within the silhouette, grey levels."""
    image, mask = _render(config)
    grey = image.astype(float).mean(axis=2)
    inside = mask[1:-1, 1:-1] & mask[2:, 1:-1] & mask[:-2, 1:-1] & mask[1:-1, 2:] & mask[1:-1, :-2]
    slope = np.abs(grey[1:-1, 2:] - grey[1:-1, :-2]) + np.abs(grey[2:, 1:-1] - grey[:-2, 1:-1])
    return float(slope[inside].mean())


def test_rich_clothing_is_textured_and_plain_clothing_is_not() -> None:
    rich, plain = _texture(AthleteConfig("rich")), _texture(AthleteConfig("plain"))
    assert rich > 1.8 * plain
    assert plain > 0.5


def test_silhouette_is_one_piece_of_human_size() -> None:
    _, mask = _render(AthleteConfig())
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    assert stats[1:, cv2.CC_STAT_AREA].max() > 0.99 * mask.sum(), count
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    assert 0.25 < np.ptp(columns) / np.ptp(rows) < 0.55


def test_clothing_is_the_same_for_the_same_seed() -> None:
    np.testing.assert_array_equal(_render(AthleteConfig(), 4)[0], _render(AthleteConfig(), 4)[0])


def test_long_sleeves_cover_the_arms_and_leave_the_shape_as_it_is() -> None:
    short, mask = _render(AthleteConfig())
    long, same = _render(AthleteConfig(sleeves="long"))
    np.testing.assert_array_equal(mask, same)
    changed = np.abs(short.astype(int) - long.astype(int)).max(axis=2) > 30
    assert 0.02 < changed.sum() / mask.sum() < 0.15
    columns = np.nonzero(mask)[1]
    beside = np.abs(np.nonzero(changed)[1] - columns.mean()) > 0.2 * np.ptp(columns)
    assert beside.mean() > 0.95  # specks of other cloth are drawn anew
