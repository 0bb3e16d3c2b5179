"""What rests on the floor is tied to where it is; what moves, or is in the air, is not."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from pzcap.body import skeleton as bodies
from pzcap.body.kinematics import forward, retract, world_points
from pzcap.body.skeleton import Body
from pzcap.tracking.temporal_constraints import contacts, smooth_step, soles
from pzcap.types import DOF, SEGMENTS, Array, Pose, Subject
from sim.people.anthropometry import draw_measurements
from tests.scenes.body_scene import swing

SIGMA = np.full(DOF, 0.05)
TREMBLE = 0.001  # radians and metres


def body() -> Body:
    return bodies.build(Subject(draw_measurements(np.random.default_rng(1)), 0.005))


def placed(pose: Pose) -> Array:
    """(6, 3) what a body may stand on, in the world."""
    frames = forward(body(), pose)
    return world_points(frames, *soles(body()))


def raised(pose: Pose, by_m: float) -> Pose:
    """The lowest sole so high above the floor."""
    lift = np.array([0.0, 0.0, by_m - placed(pose)[:, 2].min()])
    return replace(pose, root_position_m=pose.root_position_m + lift)


def trembling(count: int) -> list[Pose]:
    """Standing, each pose a little off."""
    rng = np.random.default_rng(2)
    return [retract(raised(swing(0.2), 0.0), TREMBLE * rng.normal(size=DOF)) for _ in range(count)]


def slide_m(poses: list[Pose]) -> float:
    """How far what is lowest moves from frame to frame."""
    lowest = int(np.argmin(placed(poses[0])[:, 2]))
    return float(np.linalg.norm(np.diff([placed(pose)[lowest] for pose in poses], axis=0), axis=1).mean())


def test_feet_and_hands_bear_a_body() -> None:
    names = [SEGMENTS[segment] for segment in soles(body())[0]]
    assert sorted(names) == ["left_foot"] * 2 + ["left_hand"] + ["right_foot"] * 2 + ["right_hand"]


def test_how_a_tie_changes_is_differentiated() -> None:
    poses = trembling(2)
    (tie,) = contacts(body(), poses)
    assert len(tie.weight)
    step = 1e-6
    for which, k in itertools.product(range(2), range(DOF)):
        nudged = list(poses)
        nudged[which] = retract(poses[which], step * np.eye(DOF)[k])
        (other,) = contacts(body(), nudged)
        np.testing.assert_allclose((other.residual_m - tie.residual_m) / step, tie.jacobians[which][:, k], atol=1e-5)


def test_what_is_in_the_air_or_walks_is_free() -> None:
    flying = [raised(pose, 0.1) for pose in trembling(3)]
    walking = [replace(pose, root_position_m=pose.root_position_m + 0.04 * t) for t, pose in enumerate(trembling(3))]
    assert not [*contacts(body(), flying), *contacts(body(), walking)]


def test_a_foot_that_stands_stops_trembling() -> None:
    poses = trembling(12)
    hessians, rest = [0.01 * np.eye(DOF) / TREMBLE**2] * 12, [np.zeros(DOF)] * 12
    steps = smooth_step(poses, hessians, rest, 1e3 * SIGMA, [], contacts(body(), poses))
    still = [retract(pose, step) for pose, step in zip(poses, steps, strict=True)]
    assert slide_m(still) < 0.25 * slide_m(poses)
