"""Poses of early frames with a body that was known better later."""

from __future__ import annotations

import numpy as np

from pzcap.body.shape_basis import basis, corrected
from pzcap.body.shape_estimation import Shape
from pzcap.body.skeleton import DOF, Body, difference, forward, joints, place, retract
from pzcap.tracking.frame_tracker import UNSEEN, TrackingConfig
from pzcap.tracking.interval_solver import IntervalSolver
from pzcap.tracking.shape_refit import refit_poses
from pzcap.tracking.tracker import Tracker
from pzcap.types import SEGMENTS, Keyframe, Pose
from tests.scenes.bodies import BODY

RNG = np.random.default_rng(5)
POSE = retract(
    Pose(np.array([0.3, -0.2, 1.0]), np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1))), RNG.normal(0, 0.3, DOF)
)


def wrong(scale: float) -> Body:
    """The body as a tape may have it."""
    change = basis(BODY)
    return corrected(BODY, change, scale * np.random.default_rng(1).normal(0.0, change.sigma_m))


def test_the_same_body_stays_where_it_is() -> None:
    np.testing.assert_allclose(difference(refit_poses(POSE, BODY, BODY), POSE), 0.0, atol=1e-9)


def test_the_skin_is_nowhere_nearer_to_where_it_was_seen() -> None:
    """Across it above all; joints move in it by millimetres."""
    body = wrong(0.5)
    wanted = place(body, forward(body, POSE))[0]

    def cost(pose: Pose) -> float:
        points, normals = place(BODY, forward(BODY, pose))
        off = points - wanted
        across, along = np.sum(off * normals, axis=1) ** 2, np.sum(off**2, axis=1)
        return float(np.average(0.97 * across + 0.03 * along, weights=BODY.surface.area_m2))

    found = refit_poses(POSE, body, BODY)
    assert cost(found) < cost(POSE)
    ways = np.random.default_rng(3).normal(0.0, 0.01, (40, DOF))
    assert all(cost(retract(found, way)) > cost(found) for way in ways)
    assert np.linalg.norm(joints(BODY, found) - joints(body, POSE), axis=1).max() > 0.002


def test_early_results_get_the_body_and_the_certainty_of_the_last() -> None:
    solver = IntervalSolver(BODY, 30.0, TrackingConfig())
    early = solver.result(0, POSE, 1e4 * np.eye(DOF), UNSEEN, True)
    change = basis(BODY)
    amounts = 0.5 * np.random.default_rng(2).normal(0.0, change.sigma_m)
    solver.body, solver._known = corrected(BODY, change, amounts), Shape(amounts, np.full(len(SEGMENTS), 1e-6))
    late = solver.result(1, POSE, 1e4 * np.eye(DOF), UNSEEN, True)
    first, second = solver.refit_shape([early, late])
    assert second is late
    np.testing.assert_array_equal(first.joints_m, joints(solver.body, first.pose))
    np.testing.assert_allclose(first.pose.rotations, refit_poses(POSE, BODY, solver.body).rotations)
    np.testing.assert_allclose(
        early.sigma_m**2 - first.sigma_m**2, early.shape.joint_variance_m2 - 1e-6, rtol=1e-9, atol=1e-15
    )


def test_a_tracker_gives_back_what_one_body_tracked_as_it_is() -> None:
    tracker = Tracker(BODY, [Keyframe(0, POSE)], 30.0, TrackingConfig())
    only = IntervalSolver.result(tracker._solver, 0, POSE, 1e4 * np.eye(DOF), UNSEEN, True)
    np.testing.assert_array_equal(tracker.motion([only]).joints_m, [only.joints_m])
