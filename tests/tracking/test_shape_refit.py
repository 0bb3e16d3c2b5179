"""Poses of early frames with a body that was known better later."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.body.kinematics import difference, forward, joints, place, retract
from pzcap.body.shape_basis import basis, corrected
from pzcap.body.shape_estimation import Shape
from pzcap.body.skeleton import Body
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.frame_tracker import NO_CONTOUR, PoseEstimate
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.shape_refit import refit_pose, refit_shape
from pzcap.tracking.tracked_body import tracked
from pzcap.tracking.tracker import Tracker, TrackInput
from pzcap.tracking.tuning import SHAPE
from pzcap.types import DOF, SEGMENTS, Keyframe, Pose
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
    np.testing.assert_allclose(difference(refit_pose(POSE, BODY, BODY), POSE), 0.0, atol=1e-9)


def test_the_skin_is_nowhere_nearer_to_where_it_was_seen() -> None:
    """Across it above all; joints move in it by millimetres."""
    body = wrong(0.5)
    wanted = place(body, forward(body, POSE))[0]

    def cost(pose: Pose) -> float:
        points, normals = place(BODY, forward(BODY, pose))
        off = points - wanted
        across, along = np.sum(off * normals, axis=1) ** 2, np.sum(off**2, axis=1)
        return float(np.average(0.97 * across + 0.03 * along, weights=BODY.surface.area_m2))

    found = refit_pose(POSE, body, BODY)
    assert cost(found) < cost(POSE)
    ways = np.random.default_rng(3).normal(0.0, 0.01, (40, DOF))
    assert all(cost(retract(found, way)) > cost(found) for way in ways)
    assert np.linalg.norm(joints(BODY, found) - joints(body, POSE), axis=1).max() > 0.002


def test_early_results_get_the_body_and_the_certainty_of_the_last() -> None:
    found = PoseEstimate(POSE, 1e4 * np.eye(DOF), NO_CONTOUR, True)
    before = BodyEstimate.of(BODY)
    early = tracked(before, 0, found)
    change = basis(BODY)
    amounts = 0.5 * np.random.default_rng(2).normal(0.0, change.sigma_m)
    known = Shape(amounts, np.full(len(SEGMENTS), 1e-6))
    after = replace(before, body=corrected(BODY, change, amounts), known=known)
    late = tracked(after, 1, found)
    first, second = refit_shape(after, [early, late])
    assert second is late
    np.testing.assert_array_equal(first.joints_m, joints(after.body, first.pose))
    np.testing.assert_allclose(first.pose.rotations, refit_pose(POSE, BODY, after.body).rotations)
    np.testing.assert_allclose(
        early.sigma_m**2 - first.sigma_m**2, early.shape.joint_variance_m2 - 1e-6, rtol=1e-9, atol=1e-15
    )


def test_a_tracker_gives_back_what_one_body_tracked_as_it_is() -> None:
    tracker = Tracker(BODY, [Keyframe(0, POSE)], TrackingConfig())
    (only,) = tracker._tracked(TrackInput(0, ()), PoseEstimate(POSE, 1e4 * np.eye(DOF), NO_CONTOUR, True))
    np.testing.assert_array_equal(tracker.motion([only]).joints_m, [only.joints_m])


def test_sigma_is_wider_until_a_hand_has_set_a_keyframe() -> None:
    config, still = TrackingConfig(), np.zeros((len(SEGMENTS), 6))

    def widened(*found: bool) -> float:
        estimate = BodyEstimate.of(BODY)
        for number, by_detector in enumerate(found):
            key = Keyframe(number, POSE, found=by_detector)
            estimate = estimate.with_keyframe(key, POSE, [], still, config)
        after = estimate.commit(estimate.shape.equations)
        return float(after.known.joint_variance_m2.sum() / after.shape.joint_variance().sum())

    assert widened(True) == pytest.approx(SHAPE.found_keyframes)
    for found in ((False,), (True, False), (False, True)):
        assert widened(*found) == pytest.approx(1.0)
