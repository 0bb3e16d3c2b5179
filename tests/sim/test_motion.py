"""Motions measured like footage: from poses alone, with kinematics written for the test, not those of the fit."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, JOINTS, PARENTS, SEGMENTS, Array, PzcapError
from sim import motion
from sim.motion._fit import GRAVITY, Contact, _Problem, fit, knots
from sim.motion._kinematics import CHAINS, DOF, Frames, exp
from sim.motion._normal import NormalEquations
from sim.people.anthropometry import body_tree, draw_measurements, joint_limit_rad

pytestmark = pytest.mark.xdist_group("motion")  # a clip is made once
RATE = 240
CASES = [
    ("floor_exercise", 0), ("floor_exercise", 7), ("pedestrian", 0), ("pedestrian", 5), ("full_turn_jump", 0),
    ("full_turn_jump", 3), ("crouching_turn", 0), ("crouching_turn", 6), ("pirouette", 0), ("pirouette", 3),
    ("half_turn_jump", 1), ("crouching_half_turn", 1),
]  # fmt: skip


class Watched:
    """A clip sampled at RATE: joints, rotations, centre of mass, contacts."""

    def __init__(self, name: str, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.measurements = draw_measurements(rng)
        self.clip = motion.make(name, self.measurements, rng)
        self.times = np.arange(round(self.clip.duration_s * RATE) + 1) / RATE
        poses = [self.clip.at(t) for t in self.times]
        self.quaternions = np.stack([pose.rotations for pose in poses])
        self.local = Rotation.from_quat(self.quaternions.reshape(-1, 4), scalar_first=True)
        matrices = self.local.as_matrix().reshape(-1, 16, 3, 3)
        tree = body_tree(self.measurements)
        self.joints, self.world = np.empty((len(poses), 16, 3)), matrices.copy()
        self.joints[:, 0] = [pose.root_position_m for pose in poses]
        for s in range(1, 16):
            p = PARENTS[s]
            self.world[:, s] = np.einsum("tij,tjk->tik", self.world[:, p], matrices[:, s])
            self.joints[:, s] = self.joints[:, p] + np.einsum("tij,j->ti", self.world[:, p], tree.offsets_m[s])
        centres = self.joints + np.einsum("tsij,sj->tsi", self.world, tree.centres_m)
        self.centre = np.einsum("s,tsi->ti", tree.masses, centres)
        self.contacts = np.array([list(self.clip.contacts(t).values()) for t in self.times])
        self.airborne = np.array([self.clip.airborne(t) for t in self.times])

    def place(self, segment: str, x: float, z: float) -> Array:
        """Return where (T, 3) a point of a segment is."""
        s = SEGMENTS.index(segment)
        return self.joints[:, s] + np.einsum("tij,j->ti", self.world[:, s], np.array([x, 0.0, z]))

    def soles(self, end: str) -> list[Array]:
        """Return the points (T, 3) that touch the floor: heel and toe, or palm and finger tips."""
        m = self.measurements
        if end.endswith("foot"):
            return [self.place(end, x * m["foot"], -m["ankle_height"]) for x in (-0.25, 0.70)]
        return [self.place(end, 0.0, -x * m["hand"]) - (0, 0, r) for x, r in ((0.30, 0.022), (0.92, 0.012))]


@functools.cache
def watch(name: str, seed: int) -> Watched:
    return Watched(name, seed)


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def watched(request: pytest.FixtureRequest) -> Watched:
    return watch(*request.param)


def test_frame_counts_are_those_of_the_paper() -> None:
    assert watch("floor_exercise", 0).clip.frame_count == 171
    assert watch("pedestrian", 0).clip.frame_count == 150


def test_nothing_slides_while_it_stands(watched: Watched) -> None:
    """What touches may change from heel to toe, so the way of whichever point is lowest is added up."""
    for e, end in enumerate(motion.END_POINTS):
        points = np.stack(watched.soles(end))
        lowest = np.argmin(points[:, :-1, 2], axis=0)
        steps = np.linalg.norm(np.diff(points[:, :, :2], axis=1), axis=2)[lowest, np.arange(len(lowest))]
        held = watched.contacts[:-1, e]
        episodes = np.cumsum(np.diff(held.astype(int), prepend=0) == 1)
        for episode in np.unique(episodes[held]):
            assert steps[held & (episodes == episode)].sum() < 0.02, end


def test_what_stands_is_on_the_floor_and_nothing_is_below_it(watched: Watched) -> None:
    for e, end in enumerate(motion.END_POINTS):
        heights = np.stack(watched.soles(end))[:, :, 2].min(axis=0)
        assert np.abs(heights[watched.contacts[:, e]]).max(initial=0.0) < 0.01, end
        assert heights.min() > -0.01, end
    for joint in ("neck", "left_knee", "right_knee", "left_elbow", "right_elbow", "pelvis"):
        assert watched.joints[:, JOINTS.index(joint), 2].min() > 0.05, joint


def test_flight_is_ballistic(watched: Watched) -> None:
    acceleration = np.diff(watched.centre, n=2, axis=0) * RATE**2
    flying = watched.airborne[:-2] & watched.airborne[1:-1] & watched.airborne[2:]
    assert np.abs(acceleration[flying] - GRAVITY).max(initial=0.0) < 0.2


def test_flight_keeps_angular_momentum() -> None:
    watched = watch("floor_exercise", 0)
    tree = body_tree(watched.measurements)
    momentum = np.zeros((len(watched.times) - 1, 3))
    for s in range(16):
        for end in (-1.0, 1.0):
            middle = tree.centres_m[s] + (0, 0, end * tree.gyration_m[s])
            arm = watched.joints[:, s] + watched.world[:, s] @ middle - watched.centre
            momentum += 0.5 * tree.masses[s] * np.cross(arm[:-1], arm[1:]) * RATE
    somersault = (watched.times[:-1] > 3.85) & (watched.times[:-1] < 4.45)
    assert watched.airborne[:-1][somersault].all()
    assert np.linalg.norm(momentum[somersault], axis=1).min() > 0.3
    assert np.ptp(momentum[somersault], axis=0).max() < 0.15


def test_floor_exercise_is_inverted_and_airborne_and_crosses_the_carpet() -> None:
    for seed in (0, 7):
        watched = watch("floor_exercise", seed)
        head, pelvis = watched.joints[:, JOINTS.index("neck"), 2], watched.joints[:, 0, 2]
        assert np.mean(head < pelvis) > 0.15
        assert np.mean(watched.airborne) > 0.15
        assert watched.contacts.any(axis=0).all(), "each hand and foot stands at some time"
        assert 9.0 < np.linalg.norm(watched.joints[-1, 0, :2] - watched.joints[0, 0, :2]) < 13.5
        assert np.abs(watched.joints[:, :, :2]).max() < 6.0
        last = watched.times > watched.times[-1] - 0.2
        assert np.ptp(watched.joints[last], axis=0).max() < 0.05, "ends standing still"


def test_pedestrian_walks_from_near_camera_3_to_near_camera_2() -> None:
    for seed in (0, 5):
        watched = watch("pedestrian", seed)
        root = watched.joints[:, 0, :2]
        camera_3, camera_2 = np.array([10.5, 8.0]), np.array([10.5, -8.0])
        from_3, from_2 = np.linalg.norm(root - camera_3, axis=1), np.linalg.norm(root - camera_2, axis=1)
        assert 3.5 < from_3[0] < 5.5
        assert 3.5 < from_2[-1] < 5.5
        assert min(from_2.min(), from_3.min()) > 3.5
        assert root[len(root) // 2, 0] < min(root[0, 0], root[-1, 0]) - 0.4, "bulges towards the middle"
        speed = np.linalg.norm(np.diff(root, axis=0), axis=1).sum() / watched.clip.duration_s
        assert 1.2 < speed < 1.9
        assert not watched.airborne.any()
        assert watched.contacts[:, 2:].all(axis=1).mean() > 0.1, "both feet stand for a while in each step"
        assert not watched.contacts[:, :2].any()


def _turned(watched: Watched) -> Array:
    """How far (T,) rad the line through the hips has turned to the left since the start."""
    across = watched.joints[:, JOINTS.index("left_hip"), :2] - watched.joints[:, JOINTS.index("right_hip"), :2]
    azimuth = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    return azimuth - azimuth[0]


def test_the_jump_turns_once_and_most_of_that_in_the_air_with_the_arms_in() -> None:
    for seed in (0, 3):
        watched = watch("full_turn_jump", seed)
        turned, flight = _turned(watched), np.flatnonzero(watched.airborne)
        assert abs(turned[-1] - 2 * np.pi) < 0.2
        assert np.array_equal(flight, np.arange(flight[0], flight[-1] + 1)), "one flight"
        assert 0.5 < len(flight) / RATE < 0.65
        assert turned[flight[-1]] - turned[flight[0]] > 1.5 * np.pi
        assert np.ptp(watched.centre[flight, 2]) > 0.3
        middle = flight[len(flight) // 2]
        for side in ("left", "right"):
            wrist = watched.joints[middle, JOINTS.index(f"{side}_wrist")]
            assert np.linalg.norm((wrist - watched.centre[middle])[:2]) < 0.32, side
        assert not watched.contacts[:, :2].any()


def test_the_crouching_turn_goes_down_round_with_the_arms_wrapped_and_up_again() -> None:
    for seed in (0, 6):
        watched = watch("crouching_turn", seed)
        turned, height = _turned(watched), watched.joints[:, 0, 2] / watched.joints[0, 0, 2]
        assert abs(turned[-1] - 2 * np.pi) < 0.2
        crouched = (turned > 0.3) & (turned < 2 * np.pi - 0.3)
        assert height[crouched].max() < 0.65
        assert height[-1] > 0.97
        for side, other in (("left", "right"), ("right", "left")):
            wrist = watched.joints[:, JOINTS.index(f"{side}_wrist")]
            near, far = (watched.joints[:, JOINTS.index(f"{name}_elbow")] for name in (side, other))
            assert np.all(
                np.linalg.norm(wrist - far, axis=1)[crouched] < np.linalg.norm(near - far, axis=1)[crouched]
            ), "the forearm crosses the trunk"
        assert not watched.airborne.any()
        assert not watched.contacts[:, :2].any()


def test_the_pirouette_turns_with_both_hands_close_before_the_chest() -> None:
    for seed in (0, 3):
        watched = watch("pirouette", seed)
        turned = np.abs(_turned(watched))
        assert abs(turned[-1] - 3 * np.pi) < 0.2
        held = (watched.times > 1.5) & (watched.times < 3.5)
        assert np.ptp(turned[held]) > 1.7 * np.pi, "most of it"
        thorax = SEGMENTS.index("thorax")
        for side in ("left", "right"):
            wrist = watched.joints[:, JOINTS.index(f"{side}_wrist")] - watched.joints[:, thorax]
            ahead, aside, _ = np.einsum("tji,tj->it", watched.world[:, thorax], wrist)
            assert 0.12 < ahead[held].min() < ahead[held].max() < 0.30, side
            assert np.abs(aside[held]).max() < 0.08, side
            assert np.abs(aside[[0, -1]]).min() > 0.5, "opened"
        assert not watched.airborne.any()


def test_joint_limits_hold(watched: Watched) -> None:
    vectors = watched.local.as_rotvec().reshape(-1, 16, 3)
    for s, name in enumerate(SEGMENTS[1:], start=1):
        low, high = joint_limit_rad(name)
        if name in HINGE_AXES:
            axis = np.array(HINGE_AXES[name])
            angles = vectors[:, s] @ axis
            assert np.abs(vectors[:, s] - angles[:, None] * axis).max() < 1e-6, f"{name} turns about its axis alone"
        else:
            angles = np.linalg.norm(vectors[:, s], axis=1)
        assert low - 0.02 < angles.min(), name
        assert angles.max() < high + 0.02, name


def test_motion_is_continuous_and_no_faster_than_people_are(watched: Watched) -> None:
    turns = (watched.local[:-16].inv() * watched.local[16:]).magnitude().reshape(-1, 16) * RATE
    fastest = np.degrees(turns.max())
    assert fastest < 1500.0
    assert fastest > (600.0 if watched.clip.frame_count == 171 else 200.0)
    assert np.abs(np.diff(watched.joints, axis=0)).max() * RATE < 19.0  # m/s, the hands in the back handspring
    assert np.abs(np.diff(watched.centre, n=2, axis=0)).max() * RATE**2 < 150.0  # 15 times the body's weight


def test_time_is_clamped_and_quaternions_are_unit() -> None:
    clip = watch("pedestrian", 0).clip
    np.testing.assert_array_equal(clip.at(-1.0).rotations, clip.at(0.0).rotations)
    np.testing.assert_array_equal(clip.at(99.0).root_position_m, clip.at(clip.duration_s).root_position_m)
    np.testing.assert_allclose(np.linalg.norm(watch("pedestrian", 0).quaternions, axis=2), 1.0, atol=1e-12)
    assert clip.contacts(-1.0) == clip.contacts(0.0)


def test_the_same_seed_gives_the_same_motion() -> None:
    first, again = watch("pedestrian", 5), Watched("pedestrian", 5)
    np.testing.assert_array_equal(first.joints, again.joints)


def test_an_unknown_motion_names_the_nearest() -> None:
    with pytest.raises(PzcapError, match=r"'floor_exercize'.*floor_exercise"):
        motion.make("floor_exercize", {}, np.random.default_rng(0))
    assert set(motion.names()) >= {"floor_exercise", "pedestrian", "full_turn_jump", "crouching_turn"}


def test_a_motion_is_a_file(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module beside the others is found by its name, with nothing else edited."""
    (tmp_path / "handstand.py").write_text("def make(measurements, rng):\n    return None\n")  # type: ignore[operator]
    monkeypatch.setattr(motion, "__path__", [*motion.__path__, str(tmp_path)])
    assert "handstand" in motion.names()


# The fit -------------------------------------------------------------------------------------------------------


def _random_frames(seed: int, count: int = 3) -> Frames:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(0.0, 0.5, (count, 16, 3))
    for s, name in enumerate(SEGMENTS):
        if name in HINGE_AXES:
            vectors[:, s] = rng.normal(0.0, 0.5, (count, 1)) * np.array(HINGE_AXES[name])
    return Frames.place(body_tree(draw_measurements(rng)), rng.normal(0.0, 1.0, (count, 3)), exp(vectors))


def test_jacobians_agree_with_finite_differences() -> None:
    frames, local = _random_frames(1), np.array([0.1, 0.2, 0.3])
    for segment in (3, 6, 12):
        jacobian = frames.jacobian(segment, frames.points(segment, local))
        centre_jacobian = frames.centre_of_mass_jacobian()
        for dof in range(DOF):
            step = np.zeros((3, DOF))
            step[:, dof] = 1e-6
            ahead, back = frames.moved(step), frames.moved(-step)
            moved = (ahead.points(segment, local) - back.points(segment, local)) / 2e-6
            np.testing.assert_allclose(moved, jacobian[:, :, dof], atol=1e-7)
            moved = (ahead.centre_of_mass() - back.centre_of_mass()) / 2e-6
            np.testing.assert_allclose(moved, centre_jacobian[:, :, dof], atol=1e-7)


def test_chains_end_at_the_pelvis() -> None:
    assert all(chain[0] == s and chain[-1] == 0 for s, chain in enumerate(CHAINS))


def test_normal_equations_agree_with_dense_least_squares() -> None:
    rng, count = np.random.default_rng(2), 4
    normal, rows, values = NormalEquations(count), [], []
    for first, width in ((np.arange(count), 1), (np.arange(count - 1), 2), (np.arange(count - 2), 3)):
        parts = [rng.normal(size=(len(first), 50, DOF)) for _ in range(width)]
        residuals = rng.normal(size=(len(first), 50))
        normal.add(first, parts, residuals, 0.5)
        for n, t in enumerate(first):
            row = np.zeros((50, count, DOF))
            for i, part in enumerate(parts):
                row[:, t + i] = part[n]
            rows.append(row.reshape(50, -1) / 0.5)
            values.append(-residuals[n] / 0.5)
    expected = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    np.testing.assert_allclose(normal.solve().ravel(), expected, rtol=1e-8, atol=1e-10)


class Recorder:
    """Stands in for the normal equations and keeps the residuals in flight and their jacobians."""

    def add(self, first: Array, jacobians: list[Array], residuals: Array, sigma: float) -> None:
        del sigma
        if len(first):
            self.jacobians, self.residuals = jacobians, residuals


def test_angular_momentum_jacobian_agrees_with_finite_differences() -> None:
    frames = _random_frames(4, count=3)
    flight = np.array([False, True, False])
    problem = _Problem(frames, (), np.zeros((0, 3), dtype=bool), flight, np.ones(3))

    def record(frames: Frames) -> Recorder:
        recorder = Recorder()
        problem._angular_momentum(recorder, frames, 1.0)  # type: ignore[arg-type]
        return recorder

    found = record(frames)
    for knot in range(3):
        for dof in range(DOF):
            step = np.zeros((3, DOF))
            step[knot, dof] = 1e-6
            change = (record(frames.moved(step)).residuals - record(frames.moved(-step)).residuals) / 2e-6
            np.testing.assert_allclose(change[0], found.jacobians[knot][0, :, dof], atol=1e-4)


def test_a_foot_that_is_authored_to_slide_is_made_to_stand() -> None:
    """An injected fault: the author slides a standing person by 0.3 m/s; the fit holds the soles."""
    measurements = draw_measurements(np.random.default_rng(3))
    frame_count = 16
    times = knots(frame_count)
    leg = measurements["thigh"] + measurements["shank"] + measurements["ankle_height"]
    roots = np.stack([0.3 * times, 0.0 * times, 0.0 * times + leg - 0.03], axis=1)
    rotations = np.tile(np.eye(3), (len(times), 16, 1, 1))
    contacts = [Contact(f"{side}_{end}", 0.0, 1.0) for side in ("left", "right") for end in ("heel", "toe")]
    clip = fit(measurements, frame_count, roots, rotations, contacts, (0.1, 0.1, 0.1))
    tree, places = body_tree(measurements), []
    for t in times:
        pose = clip.at(t)
        matrices = Rotation.from_quat(pose.rotations, scalar_first=True).as_matrix()
        frames = Frames.place(tree, pose.root_position_m[None], matrices[None])
        places.append(
            frames.points(12, np.array([-0.25 * measurements["foot"], 0.0, -measurements["ankle_height"]]))[0]
        )
    assert np.ptp(places, axis=0).max() < 0.003
