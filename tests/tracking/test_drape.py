"""Drape of loose clothes: the Schur complement against the joint solution, and what it leaves of a pose."""

from __future__ import annotations

import numpy as np

from pzcap.body import skeleton
from pzcap.body.kinematics import forward, screws
from pzcap.body.segment_equations import SegmentSums
from pzcap.tracking.drape import eliminate_drape, expected_drape, segments_twists
from pzcap.tracking.tuning import DRAPE
from pzcap.types import SEGMENTS, Array, Subject
from tests.scenes.bodies import BODY, random_pose, subject

CLOTHED = [SEGMENTS.index(name) for name in ("thorax", "left_thigh")]
LOOSE_M = np.where(np.isin(np.arange(16), CLOTHED), 0.03, 0.0)


def residuals(rng: np.random.Generator, count: int = 12) -> tuple[Array, Array]:
    """Rows (16, count, 6) of the Jacobian by each segment's twist, and residuals (16, count)."""
    return rng.normal(size=(16, count, 6)) * 50.0, rng.normal(size=(16, count))


def sums(rows: Array, right: Array) -> SegmentSums:
    return SegmentSums(rows.transpose(0, 2, 1) @ rows, np.einsum("sij,si->sj", rows, right), np.zeros(3))


def test_the_twist_is_that_of_the_joint_solution_with_the_drape() -> None:
    rng = np.random.default_rng(1)
    views = [residuals(rng), residuals(rng)]
    drape, expected = rng.normal(0.0, 0.01, (2, 16, 3))
    found = eliminate_drape([sums(*view) for view in views], LOOSE_M, drape, expected)
    hessians, gradients = (np.sum([each[k] for each in (*found.views, found.prior)], axis=0) for k in range(2))
    for s in range(16):
        rows, right = (np.concatenate([view[k][s] for view in views]) for k in range(2))
        if s in CLOTHED:  # nine unknowns: the twist, and the drape, which moves points as a translation does
            rows = np.hstack([rows, rows[:, :3]])
            information = np.eye(3) / (DRAPE.sigma * LOOSE_M[s]) ** 2
            joint, pull = rows.T @ rows, rows.T @ right
            joint[6:, 6:] += information
            pull[6:] += information @ (expected - drape)[s]
            wanted = np.linalg.solve(joint, pull)
            twists = np.zeros((16, 6))
            twists[s] = wanted[:6]
            np.testing.assert_allclose(found.drape.step(twists)[s], wanted[6:], rtol=1e-6, atol=1e-9)
            covariance = np.linalg.inv(joint)[:6, :6]
            np.testing.assert_allclose(np.linalg.inv(hessians[s]), covariance, rtol=1e-6)
        else:
            wanted = np.linalg.solve(rows.T @ rows, rows.T @ right)
        np.testing.assert_allclose(np.linalg.solve(hessians[s], gradients[s]), wanted[:6], rtol=1e-6, atol=1e-9)
    for view in found.views:
        assert np.linalg.eigvalsh(view.hessians).min() > -1e-6


def test_cloth_alone_tells_where_it_is_and_not_where_the_body_is() -> None:
    """However many residuals: no better than the room allows."""
    rng = np.random.default_rng(2)
    found = eliminate_drape([sums(*residuals(rng, 2000))], LOOSE_M, *np.zeros((2, 16, 3)))
    hessians = found.views[0].hessians + found.prior.hessians
    sigma = np.sqrt(np.diagonal(np.linalg.inv(hessians), axis1=1, axis2=2))
    np.testing.assert_allclose(sigma[CLOTHED, :3], DRAPE.sigma * 0.03, rtol=0.02)
    assert sigma[SEGMENTS.index("head"), :3].max() < 0.001


def test_cloth_hangs_behind_as_far_as_it_can() -> None:
    velocity = np.zeros((16, 6))
    velocity[:, 0] = 0.15  # 4.5 m/s
    lag = expected_drape(LOOSE_M, velocity)
    assert np.all(lag[CLOTHED, 0] < -0.4 * 0.03)
    assert np.all(lag[CLOTHED, 0] > -0.03)
    assert not lag[SEGMENTS.index("head")].any()
    assert not expected_drape(LOOSE_M, None).any()


def test_segments_move_by_the_screws_of_what_carries_them() -> None:
    pose = random_pose(3, 0.3)
    frames = forward(BODY, pose)
    twists, step = screws(frames, frames[0, :3, 3]), np.zeros(43)
    step[:3] = 0.01, 0.02, -0.01
    np.testing.assert_allclose(
        segments_twists(step, twists), np.tile([0.01, 0.02, -0.01, 0, 0, 0], (16, 1)), atol=1e-12
    )
    elbow = np.flatnonzero(SEGMENTS.index("left_forearm") == skeleton.DOF_SEGMENT)
    step = np.zeros(43)
    step[elbow] = 0.1
    moved = np.flatnonzero(np.abs(segments_twists(step, twists)).max(axis=1) > 0)
    assert moved.tolist() == [SEGMENTS.index("left_forearm"), SEGMENTS.index("left_hand")]


def test_a_body_in_loose_clothes_is_wider_where_these_are() -> None:
    person = subject()
    loose = skeleton.build(Subject(person.measurements_m, 0.005, loose_m={"shirt": 0.04}))
    grown = loose.surface.points_m - BODY.surface.points_m
    thorax, shank = (BODY.surface.segment == SEGMENTS.index(name) for name in ("thorax", "left_shank"))
    np.testing.assert_allclose(np.linalg.norm(grown[thorax], axis=1), 0.04, rtol=1e-9)
    assert not grown[shank].any()
    np.testing.assert_array_equal(loose.offsets_m, BODY.offsets_m)
