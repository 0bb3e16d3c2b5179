"""A stretch solved at once: it follows the images where they speak and is smooth where they do not."""

from __future__ import annotations

import numpy as np

from pzcap.body import kinematics
from pzcap.tracking.temporal_constraints import Tie, smooth_step
from pzcap.types import DOF, Array, Pose
from tests.scenes.body_scene import swing

SIGMA = np.full(DOF, 0.05)


def shaken(count: int) -> tuple[list[Pose], Array]:
    """Poses of a body that moves evenly, and what each is off by."""
    rng = np.random.default_rng(1)
    velocity = rng.normal(0, 0.02, DOF)
    start = swing(0.2)
    errors = 0.02 * rng.normal(size=(count, DOF))
    even = [kinematics.retract(start, t * velocity) for t in range(count)]
    return [kinematics.retract(pose, error) for pose, error in zip(even, errors, strict=True)], errors


def test_without_images_a_stretch_between_known_ends_becomes_even() -> None:
    poses, _ = shaken(12)
    known = [*[np.zeros((DOF, DOF))] * 10, 1e9 * np.eye(DOF)]  # of the last
    chain = poses
    for _ in range(3):
        steps = smooth_step(chain[1:], known, [np.zeros(DOF)] * 11, SIGMA, chain[:1], [])
        chain = [chain[0], *(kinematics.retract(pose, step) for pose, step in zip(chain[1:], steps, strict=True))]
    assert np.abs(kinematics.difference(chain[-1], poses[-1])).max() < 1e-3
    velocity = [kinematics.difference(chain[t + 1], chain[t]) for t in range(11)]
    assert np.abs(np.diff(velocity, axis=0)).max() < 1e-3


def test_without_images_a_body_goes_on_as_it_came() -> None:
    poses, _ = shaken(8)
    before, chain = poses[:2], poses
    for _ in range(4):
        steps = smooth_step(chain[2:], [1e-9 * np.eye(DOF)] * 6, [np.zeros(DOF)] * 6, SIGMA, before, [])
        chain = [*before, *(kinematics.retract(pose, step) for pose, step in zip(chain[2:], steps, strict=True))]
    came = kinematics.difference(chain[1], chain[0])
    went = np.array([kinematics.difference(chain[t + 1], chain[t]) for t in range(1, 7)])
    np.testing.assert_allclose(went, np.tile(came, (6, 1)), atol=1e-3)


def test_strong_images_have_their_way() -> None:
    poses, errors = shaken(8)
    hessians = [1e8 * np.eye(DOF)] * 8
    gradients = [-1e8 * error for error in errors]
    steps = smooth_step(poses, hessians, gradients, SIGMA, [], [])
    np.testing.assert_allclose(steps, -errors, atol=1e-4)


def test_weak_images_are_smoothed() -> None:
    poses, errors = shaken(30)
    hessians = [np.eye(DOF) / 0.02**2] * 30
    steps = smooth_step(poses, hessians, [np.zeros(DOF)] * 30, 0.1 * SIGMA, [], [])
    left = np.array([e + s for e, s in zip(errors, steps, strict=True)])
    assert np.sqrt(np.mean(left**2)) < 0.6 * np.sqrt(np.mean(errors**2))


def test_one_frame_alone_takes_its_own_step() -> None:
    poses, errors = shaken(1)
    steps = smooth_step(poses, [2.0 * np.eye(DOF)], [2.0 * errors[0]], SIGMA, [], [])
    np.testing.assert_allclose(steps[0], errors[0])


def test_the_banded_solution_is_the_dense_one() -> None:
    """With ties of two frames and of three, some to a frame before the stretch, which stays."""
    poses, _ = shaken(6)
    rng = np.random.default_rng(3)
    gradients = list(1e3 * rng.normal(size=(5, DOF)))
    ties = [
        Tie(first, rng.normal(size=4), rng.uniform(0.5, 2.0, 4) * 1e4, rng.normal(size=(frames, 4, DOF)))
        for first, frames in ((0, 2), (0, 3), (1, 2), (2, 3), (3, 3), (4, 2))
    ]
    steps = smooth_step(poses[1:], [1e5 * np.eye(DOF)] * 5, gradients, 1e6 * SIGMA, poses[:1], ties)
    matrix, right = 1e5 * np.eye(6 * DOF), np.concatenate([np.zeros(DOF), *gradients])
    for tie in ties:
        rows = np.zeros((4, 6 * DOF))
        rows[:, tie.first * DOF : (tie.first + len(tie.jacobians)) * DOF] = np.hstack(list(tie.jacobians))
        matrix += rows.T * tie.weight @ rows
        right -= rows.T @ (tie.weight * tie.residual_m)
    inner = slice(DOF, 6 * DOF)
    dense = np.linalg.solve(matrix[inner, inner], right[inner])
    np.testing.assert_allclose(steps.ravel(), dense, atol=1e-6 * np.abs(dense).max())
