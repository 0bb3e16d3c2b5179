"""Cameras and body together: what a view's pan and focal length are off by is found along with the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.body.kinematics import forward, screws
from pzcap.body.segment_equations import SegmentSums, lift
from pzcap.body.skeleton import MOVES
from pzcap.calibration.settings import PanZoomConfig
from pzcap.geometry.camera import at, project
from pzcap.localisation.covariance import systematic
from pzcap.tracking import camera_refinement
from pzcap.tracking.camera_refinement import CAMERA_DOF, CameraPrior
from pzcap.tracking.frame_tracker import fit_pose
from pzcap.tracking.observation import ViewCrop
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_appearance import Appearance, learn
from pzcap.tracking.tracker import Tracker, TrackInput
from pzcap.types import DOF, SEGMENTS, Array, Lens, Localisation, PanZoomCamera
from tests.scenes.tracked import FRAMES, by_hand, clip, crops, errors_m, inputs, taped, track, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
CONFIG = TrackingConfig()
UP = np.array([0.0, 0.0, 1.0])
SHAKEN = np.array([np.deg2rad(0.15), 0.004])  # of pan and log focal: one or two pixels


def known_to(sigma: Array) -> CameraPrior:
    """A camera of the clip whose pan and log focal length are known to ``sigma`` (2,)."""
    return CameraPrior(UP, np.diag(1.0 / sigma**2), np.zeros(CAMERA_DOF))


def test_a_corrected_camera_is_the_head_panned_and_zoomed_on() -> None:
    lens = Lens(640, 480, 900.0, np.array([[320.0, 240.0]]), np.array([-0.1]))
    tilted = np.eye(4)
    tilted[:3, :3] = np.linalg.qr(np.array([[1.0, 0.02, 0.05], [-0.03, 1.0, 0.01], [0.04, 0.02, 1.0]]))[0]
    head = PanZoomCamera(lens, tilted, tilt_rad=-0.1, roll_rad=0.02)
    config, alone, none = PanZoomConfig(), np.diag([1e-8, 1e-6]), np.empty((0, 2))
    shared = systematic(config, head, np.array(0.3), np.array(1200.0))
    known = camera_refinement.camera_prior(
        config, head, Localisation(0.3, -0.1, 1200.0, alone + shared, True, none, none)
    )
    camera, after = camera_refinement.corrected(at(head, 0.3, -0.1, 1200.0), known, SHAKEN)
    there = at(head, 0.3 + SHAKEN[0], -0.1, 1200.0 * np.exp(SHAKEN[1]))
    np.testing.assert_allclose(camera.world_T_cam, there.world_T_cam, atol=1e-12)
    assert camera.focal_px == pytest.approx(there.focal_px)
    np.testing.assert_array_equal(after.correction, SHAKEN)
    np.testing.assert_allclose(np.linalg.inv(known.information), alone, rtol=1e-5, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(frame=st.integers(0, FRAMES - 1), view=st.integers(0, 3), seed=st.integers(0, 99))
def test_what_is_wrong_with_a_camera_is_a_motion_of_the_segments(frame: int, view: int, seed: int) -> None:
    """A pan as exactly as rotation is linear; a zoom as far as a segment is as deep as its joint."""
    pose, camera, known = clip().poses[frame], clip().shots[frame][view].camera, known_to(SHAKEN)
    frames = forward(true_body(), pose)
    centre = frames[0, :3, 3] + 0.1
    points = frames[:, :3, 3] + 0.1 * np.random.default_rng(seed).uniform(-1.0, 1.0, (len(SEGMENTS), 3))
    moves = camera_refinement.segment_twists(camera.world_T_cam, UP, frames, centre)
    before = project(camera, points)[0]
    for k, within in ((0, 1e-4), (1, 0.1)):
        step = 1e-5 * np.eye(CAMERA_DOF)[k]
        velocity = moves[:, :3, k] + np.cross(moves[:, 3:, k], points - centre)
        by_points = project(camera, points + 1e-5 * velocity)[0] - before
        by_camera = project(camera_refinement.corrected(camera, known, step)[0], points)[0] - before
        assert np.abs(by_points - by_camera).max() < within * np.abs(by_camera).max()


def test_eliminating_a_camera_is_solving_for_all_at_once() -> None:
    rng = np.random.default_rng(3)
    camera, frames = clip().shots[0][0].camera, forward(true_body(), clip().poses[0])
    centre = np.ascontiguousarray(frames[0, :3, 3])
    twists = screws(frames, centre)
    known = replace(known_to(SHAKEN), correction=0.3 * SHAKEN)
    moves = camera_refinement.segment_twists(camera.world_T_cam, UP, frames, centre)
    rows = rng.normal(size=(len(SEGMENTS), 20, 6))  # of each segment, by its twist
    residuals = rng.normal(size=(len(SEGMENTS), 20))
    hessians, gradients = np.einsum("sni,snj->sij", rows, rows), np.einsum("sni,sn->si", rows, residuals)
    stiff = 3.0 * np.eye(DOF)

    view = SegmentSums(hessians, gradients, centre)
    hessian, gradient = lift(view, twists)
    free = camera_refinement.eliminate(view, moves, known.information, known.correction, twists, hessian, gradient)
    pose = np.linalg.solve(hessian + stiff, gradient)

    by_pose = np.einsum("sni,di,ds->snd", rows, twists, MOVES.astype(np.float64))
    jacobian = np.concatenate([by_pose, rows @ moves], axis=2).reshape(-1, DOF + CAMERA_DOF)
    prior = np.zeros((DOF + CAMERA_DOF, DOF + CAMERA_DOF))
    prior[:DOF, :DOF], prior[DOF:, DOF:] = stiff, known.information
    right = jacobian.T @ residuals.ravel()
    right[DOF:] -= known.information @ known.correction
    both = np.linalg.solve(jacobian.T @ jacobian + prior, right)
    np.testing.assert_allclose(pose, both[:DOF], atol=1e-9)
    np.testing.assert_allclose(free.step(pose), both[DOF:], atol=1e-9)
    covariance = np.linalg.inv(jacobian.T @ jacobian + prior)[DOF:, DOF:]
    np.testing.assert_allclose(free.covariance_with(np.linalg.inv(hessian + stiff)), covariance, rtol=1e-6)


def shaken(frame: int, steps: Sequence[Array], sigma: Array) -> list[ViewCrop | None]:
    """The views of a frame, the camera of each wrong by a step (2,) and known to ``sigma`` (2,)."""
    found: list[ViewCrop | None] = []
    for view, step in zip(crops(frame), steps, strict=True):
        assert view is not None
        camera, _ = camera_refinement.corrected(view.camera, known_to(sigma), step)
        found.append(replace(view, camera=camera, camera_prior=known_to(sigma)))
    return found


def test_the_body_tells_a_camera_where_it_looks() -> None:
    """One view is wrong by pixels and not sure of itself; the others are. The pose, half known, leads it back."""
    body, pose = true_body(), clip().poses[6]
    appearances: list[Appearance | None] = [Appearance.unseen(body) for _ in range(4)]
    known = PoseObjective(body, crops(6))
    learn(known.views, known.place(pose)[1], appearances, 1.0)
    views = shaken(6, [SHAKEN, *3 * [np.zeros(CAMERA_DOF)]], SHAKEN)
    views[1:] = [None if view is None else replace(view, camera_prior=known_to(1e-3 * SHAKEN)) for view in views[1:]]
    objective = PoseObjective(body, views)
    fit = fit_pose(objective, pose, 30.0 * np.eye(DOF), appearances, CONFIG, CONFIG.schedule[1:])
    corrections = np.array(
        [
            view.camera_prior.correction
            for view in fit.objective.views
            if view is not None and view.camera_prior is not None
        ]
    )
    assert np.all(np.abs(corrections[0] + SHAKEN) < 0.15 * SHAKEN)
    assert np.all(np.abs(corrections[1:]) < 1e-3 * SHAKEN)


def test_shaken_cameras_cost_the_motion_little_where_they_are_corrected() -> None:
    """All cameras pan to and fro by a pixel and a half, and say so."""
    rng = np.random.default_rng(5)
    sigma = np.array([np.deg2rad(0.12), 1e-6])
    items, told, truth = [], [], {}
    for item in inputs():
        views = [view for view in item.views if view is not None]
        steps = sigma * rng.standard_normal((len(views), CAMERA_DOF))
        wrong = [
            replace(
                view,
                camera=camera_refinement.corrected(view.camera, known_to(sigma), step)[0],
                camera_prior=known_to(sigma),
            )
            for view, step in zip(views, steps, strict=True)
        ]
        told.append(TrackInput(item.frame, tuple(wrong)))
        items.append(TrackInput(item.frame, tuple(replace(view, camera_prior=None) for view in wrong)))
        truth[item.frame] = -steps[:, 0]
    keys = [by_hand(0), by_hand(FRAMES - 1)]
    steady, kept, corrected = (list(track(taped(), keys, each, CONFIG)) for each in (inputs(), items, told))
    usual, as_they_are, mended = (errors_m(each)[1:-1].mean() for each in (steady, kept, corrected))
    assert mended - usual < 0.6 * (as_they_are - usual)
    left = np.array([
        [each.step[0] for each in result.corrections if each is not None] - truth[result.frame]
        for result in corrected[1:-1]
    ])  # fmt: skip
    claimed = np.array([
        [each.covariance[0, 0] for each in result.corrections if each is not None] for result in corrected[1:-1]
    ])  # fmt: skip
    assert np.sqrt(np.mean(left**2)) < 0.6 * sigma[0]
    assert np.sqrt(np.mean(left**2)) < 1.5 * np.sqrt(np.mean(claimed))
    assert not any(each for result in kept for each in result.corrections)


def test_cameras_stay_as_they_are_where_they_are_not_to_be_refined() -> None:
    views = [replace(view, camera_prior=known_to(SHAKEN)) for view in inputs()[0].views if view is not None]
    for on in (True, False):
        tracker = Tracker(taped(), [by_hand(0)], replace(CONFIG, camera_refinement=on))
        tracker.push(TrackInput(0, tuple(views)))
        found = tracker._crop(views, clip().poses[0])
        assert all(view is not None and (view.camera_prior is not None) == on for view in found)


def test_equations_that_have_been_taken_move_a_camera_no_further() -> None:
    """But as the pose moves on, which is linear: two steps are their sum."""
    body, pose = true_body(), clip().poses[6]
    appearances: list[Appearance | None] = [Appearance.unseen(body) for _ in range(4)]
    objective = PoseObjective(body, shaken(6, 4 * [SHAKEN], SHAKEN))
    posed, placed = objective.place(pose)
    learn(objective.views, placed, appearances, 1.0)
    normal = objective.normal(posed, placed, appearances, CONFIG.schedule[-1].terms)
    one, two = np.random.default_rng(1).normal(0.0, 0.01, (2, DOF))

    def corrections(after: PoseObjective) -> Array:
        priors = [view.camera_prior for view in after.views if view is not None]
        return np.array([prior.correction for prior in priors if prior is not None])

    at_once = objective.after(normal, one + two)
    np.testing.assert_allclose(
        corrections(objective.after(normal, one).after(normal.taken(), two)), corrections(at_once), atol=1e-12
    )
    assert np.abs(corrections(objective.after(normal, 0.0 * one))).max() > 0.1 * SHAKEN.max()
