"""The tracker on rendered views: from keyframes a hand has set, with a body that a tape has measured."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap import runtime
from pzcap.body import kinematics
from pzcap.body import skeleton as bodies
from pzcap.body.kinematics import forward, place
from pzcap.body.shape_estimation import ShapeEquations
from pzcap.tracking import interval_solver
from pzcap.tracking.bidirectional_fusion import fuse
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.frame_tracker import FrameTracker, fit_pose
from pzcap.tracking.observation import ViewCrop, crop_view, prepare
from pzcap.tracking.pose_objective import PoseEquations, PoseObjective, px_per_m
from pzcap.tracking.settings import Round, Terms, TrackingConfig
from pzcap.tracking.skin_appearance import Appearance, learn
from pzcap.tracking.skin_colour_model import UNKNOWN, SkinColourModel
from pzcap.tracking.tracked_body import misplaced
from pzcap.tracking.tracker import Tracker, TrackInput, collect
from pzcap.tracking.tuning import VIEW
from pzcap.types import DOF, SEGMENTS, Array, Image, Keyframe, PzcapError, Subject
from tests.scenes.body_scene import HEIGHT, WIDTH
from tests.scenes.tracked import (
    CONFIG,
    FRAMES,
    TERMS,
    as_fields,
    by_hand,
    clip,
    crops,
    errors_m,
    inputs,
    lost,
    observed,
    run,
    step,
    taped,
    track,
    true_body,
    unknown,
    without_score,
)

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once


def test_between_two_keyframes() -> None:
    results = run([by_hand(0), by_hand(FRAMES - 1)], inputs())
    assert [r.frame for r in results] == list(range(FRAMES))
    assert all(r.valid for r in results)
    error = errors_m(results)
    assert error.mean() < 0.020
    assert error.max() < 0.10
    motion = collect(results, [by_hand(0), by_hand(FRAMES - 1)], taped())
    assert motion.keyframes.tolist() == [0, FRAMES - 1]
    np.testing.assert_array_equal(motion.joints_m[3], results[3].joints_m)
    assert motion.body is not None
    np.testing.assert_array_equal(motion.body.offsets_m, taped().offsets_m)


def test_the_body_does_not_jump_to_where_a_hand_has_set_it() -> None:
    """A keyframe is a frame like those before it, of which the hand has told something: all are solved for together."""
    middle, jumps = 6, []
    for seed in range(3):
        results = run([by_hand(frame, seed) for frame in (0, middle, FRAMES - 1)], inputs())
        off = np.array([r.joints_m - clip().joints_m[r.frame] for r in results])
        jumps += [np.linalg.norm(off[key] - off[key - 1], axis=1).mean() for key in (middle, FRAMES - 1)]
    assert np.mean(jumps) < 0.0016


def test_a_body_of_which_the_stature_alone_is_known_is_measured_by_the_images() -> None:
    guessed = bodies.build(Subject({"stature": clip().measurements_m["stature"]}, 0.005))
    results = list(track(guessed, [by_hand(0), by_hand(FRAMES - 1)], inputs(), CONFIG))
    error, sigma = errors_m(results), np.array([r.sigma_m for r in results])
    assert error.mean() < 0.010
    assert np.mean(error > 3.0 * sigma) < 0.005


@pytest.mark.parametrize(("settled_m", "rounds"), [(1.0, 1), (0.0, 3)])
def test_the_body_is_corrected_until_its_joints_stay(
    settled_m: float, rounds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    solved: list[BodyEstimate] = []
    solve = BodyEstimate.solve

    def counted(self: BodyEstimate, equations: ShapeEquations) -> BodyEstimate:
        solved.append(solve(self, equations))
        return solved[-1]

    def at_once(work: Callable[..., Any], *given: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(work(*given))
        return done

    monkeypatch.setattr(runtime, "submit", at_once)
    monkeypatch.setattr(BodyEstimate, "solve", counted)
    monkeypatch.setattr(interval_solver, "SHAPE", interval_solver.SHAPE._replace(settled_m=settled_m))
    ends = [by_hand(0), by_hand(4)]
    list(track(taped(), ends, inputs()[:5], replace(CONFIG, shape_rounds=3)))
    assert len(solved) == rounds


def test_one_keyframe_in_the_middle_serves_both_ways() -> None:
    results = run([by_hand(6)], inputs())
    assert [r.frame for r in results] == list(range(FRAMES))
    assert errors_m(results).mean() < 0.030


@pytest.mark.parametrize("keys", [(0, FRAMES // 2), (3,), (0, 2)])
def test_second_fields_are_tracked_and_frames_are_told(keys: tuple[int, ...]) -> None:
    """The frames of the clip taken for fields in turn: every other one is a frame, and as well known as it was."""
    by_fields = Tracker(taped(), [replace(by_hand(2 * key), frame=key) for key in keys], CONFIG, by_fields=True)
    found = [result for item in as_fields(inputs()) for result in by_fields.push(item)] + by_fields.finish()
    assert [each.frame for each in found] == list(range(FRAMES // 2 + 1))
    off = errors_m([replace(each, frame=2 * each.frame) for each in found])
    whole = errors_m(run([by_hand(2 * key) for key in keys], inputs()))[::2]
    assert off.mean() < 1.1 * whole.mean()


def test_an_expectation_after_a_keyframe_is_of_its_second_field() -> None:
    """The body has been found by then, though the hand was wrong."""
    wrong, camera = by_hand(0), inputs()[0].views[0].camera
    wrong = replace(wrong, pose=replace(wrong.pose, root_position_m=wrong.pose.root_position_m + 0.02))
    tracker = Tracker(taped(), [wrong], CONFIG, by_fields=True)
    before = tracker.expect(0, camera)
    tracker.push(inputs()[0])
    after = tracker.expect(0, camera)
    assert before is not None
    assert after is not None
    assert not np.array_equal(before.covered(HEIGHT, WIDTH), after.covered(HEIGHT, WIDTH))


def test_a_view_less_and_an_instant_that_nobody_saw() -> None:
    items = list(inputs())
    items[4] = TrackInput(4, (None, *items[4].views[1:]))
    items[8] = TrackInput(8, (None, None, None, None))
    results = run([by_hand(0), by_hand(FRAMES - 1)], items)
    assert [r.frame for r in results] == list(range(FRAMES))
    assert not results[8].valid
    seen = errors_m([r for r in results if r.valid])
    assert seen.mean() < 0.025
    assert results[8].sigma_m.mean() > 2 * results[7].sigma_m.mean()


def test_the_same_footage_gives_the_same_motion() -> None:
    first, second = run([by_hand(0)], inputs()[:4]), run([by_hand(0)], inputs()[:4])
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.joints_m, b.joints_m)


def test_results_come_as_soon_as_they_can() -> None:
    tracker = Tracker(taped(), [by_hand(0), by_hand(4)], CONFIG)
    counts = [len(tracker.push(item)) for item in inputs()[:6]]
    assert counts == [1, 0, 0, 0, 0, 5]  # an interval is solved while the next one is followed
    assert tracker.finish() == []


def test_the_colours_of_the_arms_are_known_from_the_first_keyframe_on() -> None:
    told: list[int] = []

    class Watched(SkinColourModel):
        def arms(self, image: Image, silhouette: Image) -> Image:
            found = super().arms(image, silhouette)
            told.append(int(found.max()))
            return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pzcap.tracking.tracker.SkinColourModel", Watched)
        tracker = Tracker(taped(), [by_hand(0)], CONFIG)
    views = [tracker.push(item) and len(told) for item in inputs()[:2]]
    assert max(told[: views[0]]) <= UNKNOWN
    assert min(told[views[0] :]) > 220


def test_what_has_the_colours_of_arms_is_no_sure_hall() -> None:
    """A wall of wood behind an arm that is as brown; what is surely the athlete stays so."""

    class Alike(SkinColourModel):
        def __init__(self, likely: int) -> None:
            self.likely = likely

        def arms(self, image: Image, silhouette: Image) -> Image:
            del image
            return np.full_like(silhouette, self.likely)

    view = inputs()[0].views[0]
    assert view is not None
    crops = [crop_view(taped(), view, clip().poses[0], 0.1, Alike(likely)) for likely in (0, 191, 255)]
    unlike, half, sure = (crop.belief for crop in crops if crop is not None)
    assert unlike.min() < -0.9
    np.testing.assert_allclose(half[unlike < 0.0], 0.5 * unlike[unlike < 0.0], atol=0.01)
    np.testing.assert_allclose(sure, np.maximum(unlike, 0.0), atol=1e-6)


def test_no_keyframe_is_a_clear_error() -> None:
    with pytest.raises(PzcapError, match="no keyframes"):
        list(track(taped(), [], inputs(), CONFIG))


# --------------------------------------------------------------------------------------------------------------
# The parts


def test_joints_that_nothing_shows_come_to_rest_while_the_body_moves_on() -> None:
    """An error in a joint's velocity must not carry a hidden limb away from the trunk that it is held against."""
    body, pose = true_body(), clip().poses[0]
    grey, nobody = np.full((HEIGHT, WIDTH, 3), 128, np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8)
    belief = np.zeros((HEIGHT // 4, WIDTH // 4), np.float32)
    blank = [prepare(grey, nobody, unknown(nobody), belief, shot.camera, (0, 0)) for shot in clip().shots[0]]
    elbow, velocity = SEGMENTS.index("left_forearm"), np.zeros(DOF)
    velocity[[0, np.flatnonzero(elbow == bodies.DOF_SEGMENT)[0]]] = 0.02, 0.1
    unbelieved = replace(CONFIG, spine_sigma_rad=np.inf)  # a spine that is believed to be straight goes there unseen
    tracker = FrameTracker(body, unbelieved, pose, velocity, blank)
    for _ in range(6):
        moved = kinematics.difference(tracker.step(blank).pose, pose)
    assert moved[0] > 0.08
    assert 0.0 < moved[velocity == 0.1][0] < 0.15
    assert np.abs(moved[velocity == 0.0]).max() < 0.02


def test_edges_are_sought_far_away_only_where_predictions_were_off(monkeypatch: pytest.MonkeyPatch) -> None:
    reaches: list[float] = []
    normal = PoseObjective.normal

    def watched(*arguments: Any) -> PoseEquations:
        reaches.append(arguments[-1].reach_px)
        return normal(*arguments)

    monkeypatch.setattr(PoseObjective, "normal", watched)
    widest = {}
    for error_m in (0.005, 0.05):
        tracker = FrameTracker(true_body(), CONFIG, clip().poses[4], np.zeros(DOF), crops(4))
        tracker.prediction_error_m = error_m
        reaches.clear()
        tracker.step(crops(5))
        widest[error_m] = max(reaches)
    assert widest[0.005] < widest[0.05] == CONFIG.schedule[0].terms.reach_px


@pytest.mark.parametrize("schedule", [(), CONFIG.schedule[:1]])
def test_a_schedule_that_may_leave_a_step_without_a_round_is_refused(schedule: tuple[Round, ...]) -> None:
    with pytest.raises(PzcapError, match="surprise_m"):
        TrackingConfig(schedule=schedule)


def test_while_nobody_sees_the_body_a_prediction_grows_unsure() -> None:
    tracker = FrameTracker(true_body(), CONFIG, clip().poses[4], np.zeros(DOF), crops(4))
    sigmas = [tracker.prediction_error_m]
    for _ in range(3):
        assert not tracker.step([None] * len(crops(4))).seen
        sigmas.append(tracker.prediction_error_m)
    assert (np.diff(sigmas) > 0.0).all()


def test_contour_gradient_pulls_a_displaced_body_back() -> None:
    """The silhouettes' normal equations undo a shift: their step points home and has its length."""
    body, pose = true_body(), clip().poses[5]
    objective = observed(5, body)
    terms = Terms(0, 6.0, 1.0, 12.0, 1.0, 0.0, 0.15)
    shift = np.zeros(DOF)
    shift[:3] = [0.012, -0.010, 0.008]
    moved = kinematics.retract(pose, shift)
    normal = objective.normal(*objective.place(moved), [None] * 4, terms)
    step = np.linalg.solve(normal.hessian + 30.0 * np.eye(DOF), normal.gradient)
    start = objective.normal(*objective.place(pose), [None] * 4, terms)
    rest = np.linalg.solve(start.hessian + 30.0 * np.eye(DOF), start.gradient)
    np.testing.assert_allclose((step - rest)[:3], -shift[:3], atol=0.006)


def test_brightness_gradient_is_the_derivative_of_its_cost() -> None:
    """For residuals far below the robust scale, the gradient is that of half the sum of squares."""
    body, pose = true_body(), clip().poses[2]
    objective = observed(2, body)
    appearances: list[Appearance | None] = [Appearance.unseen(body) for _ in range(4)]
    learn(objective.views, objective.place(pose)[1], appearances, 1.0)
    # free shading would hide part of the cost in the nuisances: forbid it here
    terms = Terms(1, 5.0, 1.0, 1e4, 0.0, 1.0, 1e-9)
    placed = objective.place(pose)[1]
    at = kinematics.retract(pose, 2e-3 * np.random.default_rng(0).normal(size=DOF))

    def cost(dof: int, step: float) -> float:
        moved = lost(at, dof, step)
        return float(objective.normal(objective.posed(moved), placed, appearances, terms).brightness[:, 0].sum()) / 2

    numeric = np.array([(cost(k, 5e-4) - cost(k, -5e-4)) / 1e-3 for k in range(DOF)])
    analytic = -objective.normal(objective.posed(at), placed, appearances, terms).gradient
    similarity = numeric @ analytic / np.linalg.norm(numeric) / np.linalg.norm(analytic)
    assert similarity > 0.97
    # the kernel takes the slope over two pixels, which is a little gentler than between two
    assert np.linalg.norm(numeric) == pytest.approx(np.linalg.norm(analytic), rel=0.5)


@pytest.mark.parametrize("times", [0.5, 1.0, 2.0, 4.0])
def test_brightness_pulls_back_from_as_far_however_large_the_body_is_seen(times: float) -> None:
    """A prediction is off by metres: what is a pixel of the coarse level in one view is four in a longer lens."""
    body, pose = true_body(), clip().poses[5]
    views: list[ViewCrop | None] = []
    for shot in clip().shots[5]:
        zoom = VIEW.usual_px_per_m * times / px_per_m(shot.camera, pose.root_position_m)
        size = int(zoom * WIDTH), int(zoom * HEIGHT)
        camera = replace(
            shot.camera, focal_px=zoom * shot.camera.focal_px, principal_px=zoom * shot.camera.principal_px,
            width=size[0], height=size[1],
        )  # fmt: skip
        larger, nobody = np.asarray(cv2.resize(shot.image, size), np.uint8), np.zeros(size[::-1], np.uint8)
        belief = np.zeros((size[1] // 4, size[0] // 4), np.float32)
        views.append(prepare(larger, nobody, unknown(nobody), belief, camera, (0, 0)))
    objective = PoseObjective(body, views)
    appearances: list[Appearance | None] = [Appearance.unseen(body) for _ in views]
    learn(objective.views, objective.place(pose)[1], appearances, 1.0)
    shift = np.zeros(DOF)
    shift[:3] = 0.04, -0.03, 0.02
    stiff = np.diag(np.r_[np.full(6, 1e-3), np.full(DOF - 6, 1e6)])
    schedule = [Round(replace(TERMS, level=level, contour_weight=0.0), 4) for level in (2, 1)]
    fit = fit_pose(objective, kinematics.retract(pose, shift), stiff, appearances, CONFIG, schedule)
    np.testing.assert_allclose(kinematics.joints(body, fit.posed.pose), kinematics.joints(body, pose), atol=0.005)


def test_shading_alone_moves_nothing() -> None:
    """A light that changes a limb's gain and gradient must not be taken for motion, by what is known of the motion: a
    hand of few pixels turns for nothing."""
    body, pose = true_body(), clip().poses[2]
    objective = observed(2, body)
    appearances: list[Appearance | None] = [Appearance.unseen(body) for _ in range(4)]
    learn(objective.views, objective.place(pose)[1], appearances, 1.0)
    _, normals = place(objective.body, forward(objective.body, pose))
    for appearance in appearances:
        assert appearance is not None
        appearance.value *= (1.0 + 0.08 + 0.1 * normals[:, 0] - 0.05 * normals[:, 2]).astype(np.float32)
    placed = objective.place(pose)[1]
    steps = []
    for sigma in (0.3, 1e-6):
        terms = Terms(0, 5.0, 1.0, 60.0, 0.0, 1.0, sigma)
        normal = objective.normal(objective.posed(pose), placed, appearances, terms)
        steps.append(np.sqrt(normal.gradient @ np.linalg.solve(normal.hessian + np.eye(DOF), normal.gradient)))
    free, forbidden = steps  # in sigmas
    assert free < 0.35 * forbidden
    assert free < 0.5


def test_each_limb_is_taken_from_the_pass_that_kept_it() -> None:
    body, poses = true_body(), clip().poses
    arm = int(np.flatnonzero(bodies.DOF_SEGMENT == 4)[1])
    leg = int(np.flatnonzero(bodies.DOF_SEGMENT == 13)[1])
    ahead = [step(lost(pose, arm, 0.9) if k == 3 else pose) for k, pose in enumerate(poses[1:-1])]
    back = [step(lost(pose, leg, 0.8) if k == 3 else pose) for k, pose in enumerate(poses[1:-1])]
    merged, apart, doubt = fuse(body, poses[0], ahead, back, poses[-1], without_score)
    for found, true in zip(merged, poses[1:-1], strict=True):
        np.testing.assert_allclose(kinematics.joints(body, found), kinematics.joints(body, true), atol=0.001)
    assert apart[3, [5, 6, 14, 15]].min() > 0.05
    np.testing.assert_allclose(doubt[3], np.sqrt(0.5) * apart[3])
    assert doubt[2].max() == apart[2].max() == 0.0


@pytest.mark.parametrize("right", [0, 1])
def test_where_neither_pass_leaps_the_one_that_the_images_bear_out_is_taken(right: int) -> None:
    body, poses = true_body(), clip().poses
    arm = int(np.flatnonzero(bodies.DOF_SEGMENT == 4)[1])
    true = [step(pose) for pose in poses[1:-1]]
    strays = np.sin(np.pi * np.arange(1, len(true) + 1) / (len(true) + 1))
    away = [step(lost(pose, arm, 0.6 * far)) for pose, far in zip(poses[1:-1], strays, strict=True)]

    def score(one: int, _frame: int) -> Array:
        return np.full(4, 0.1 if one == right else 0.0)

    passes = (true, away) if right == 0 else (away, true)
    merged = fuse(body, poses[0], *passes, poses[-1], score).poses
    for found, expected in zip(merged, poses[1:-1], strict=True):
        np.testing.assert_allclose(kinematics.joints(body, found), kinematics.joints(body, expected), atol=0.03)


def test_a_joint_whose_outlines_miss_the_silhouettes_is_said_to_be_misplaced() -> None:
    """Both passes may agree on what is wrong: then the images alone can tell, and the claimed sigma has to."""
    body, objective = true_body(), observed(6, true_body())
    terms, arm = CONFIG.schedule[-1].terms, np.flatnonzero(bodies.DOF_SEGMENT == 4)
    true = clip().poses[6]
    wrong = lost(lost(true, int(arm[1]), 0.8), int(arm[0]), 0.8)
    odds = {}
    for name, pose in (("true", true), ("wrong", wrong)):
        normal = objective.normal(*objective.place(pose), [None] * 4, terms)
        odds[name] = misplaced(normal.contour)
    off = np.linalg.norm(kinematics.joints(body, wrong) - kinematics.joints(body, true), axis=1)
    assert off.max() > 0.3
    assert odds["true"].max() < 0.01
    assert odds["wrong"][off > 0.15].min() > 0.3
    assert (odds["wrong"][off == 0.0] < 0.05).mean() > 0.7  # a shoulder is not where its arm is


@settings(max_examples=50)
@given(st.floats(0.0, 4.0), st.integers(3, 200), st.floats(0.0, 1.0))
def test_the_worse_an_outline_fits_the_likelier_it_is_misplaced(off_px: float, sought: int, missed: float) -> None:
    def odds(off_px: float, missed: float) -> float:
        found = sought * (1.0 - missed)
        return float(misplaced(np.tile([off_px**2 * found, found, sought], (len(SEGMENTS), 1)))[0])

    assert 0.0 < odds(off_px, missed) <= odds(off_px + 0.5, missed) < 1.0
    assert odds(off_px, missed) <= odds(off_px, min(missed + 0.1, 1.0))


def test_where_passes_agree_confidence_weighs_them() -> None:
    body, pose = true_body(), clip().poses[6]
    ahead, back = step(pose), step(lost(pose, 3, 0.04))
    back.variance[:] = 3.0
    (merged,), apart, doubt = fuse(body, pose, [ahead], [back], pose, without_score)
    assert not apart.any()
    assert not doubt.any()
    np.testing.assert_allclose(kinematics.difference(merged, pose)[3], 0.01, atol=1e-9)


def test_a_stretch_that_no_keyframe_ends_is_given_up_in_time() -> None:
    tracker = Tracker(taped(), [by_hand(0), Keyframe(100, clip().poses[0])], replace(CONFIG, longest_stretch=4))
    counts = [len(tracker.push(item)) for item in inputs()[:6]]
    assert counts == [1, 0, 0, 0, 0, 0]
    assert [r.frame for r in tracker.finish()] == [1, 2, 3, 4, 5]
