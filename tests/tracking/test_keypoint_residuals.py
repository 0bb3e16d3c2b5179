"""A detector's keypoints on the body: where they lie, what they pull at, and whose they are."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.body import kinematics, landmarks
from pzcap.body import skeleton as bodies
from pzcap.body.segment_equations import SegmentSums, accumulate, lift
from pzcap.body.skeleton import LIMBS, Body
from pzcap.geometry.camera import project
from pzcap.io.detections import KEYPOINTS
from pzcap.tracking import keypoint_residuals
from pzcap.tracking.tuning import KEYPOINT
from pzcap.types import DOF, SEGMENTS, Array, Camera, Pose, Subject, without_side
from sim.people.anthropometry import draw_measurements
from tests.scenes.body_scene import POSITIONS, aim, swing


def person() -> Body:
    return bodies.build(Subject(draw_measurements(np.random.default_rng(3)), 0.005))


PAGE = (Path(__file__).parents[2] / "docs" / "capture.md").read_text(encoding="utf-8")
BODY = person()
CAMERA = aim(np.array([-6.0, -5.0, 1.7]), np.array([0.0, 0.2, 0.9]))
AT = {name: KEYPOINTS.index(name) for name in KEYPOINTS}


def marks(pose: Pose, body: Body = BODY) -> Array:
    return keypoint_residuals.in_world(body.landmarks, kinematics.forward(body, pose))


def detected(pose: Pose, camera: Camera = CAMERA, confidence: float = 0.9) -> Array:
    pixels, _ = project(camera, marks(pose))
    return np.column_stack([pixels, np.full(len(pixels), confidence)])


def test_keypoints_lie_where_their_names_say() -> None:
    """Standing upright: joints in the joints, the face in front, toes ahead of heels, left to the left."""
    upright = Pose(np.zeros(3), np.tile([1.0, 0.0, 0.0, 0.0], (16, 1)))
    at = dict(zip(KEYPOINTS, marks(upright), strict=True))
    joints = dict(zip(SEGMENTS, kinematics.joints(BODY, upright), strict=True))
    for name, segment in (("elbow", "forearm"), ("wrist", "hand"), ("knee", "shank"), ("ankle", "foot")):
        np.testing.assert_allclose(at[f"left_{name}"], joints[f"left_{segment}"])
    np.testing.assert_allclose(at["neck"], (at["left_shoulder"] + at["right_shoulder"]) / 2, atol=1e-12)
    np.testing.assert_allclose(at["mid_hip"], (at["left_hip"] + at["right_hip"]) / 2, atol=1e-12)
    assert at["nose"][0] > at["left_eye"][0] > at["left_ear"][0]
    assert at["head_top"][2] > at["left_eye"][2] > at["nose"][2] > at["neck"][2]
    for name in KEYPOINTS:
        if name.startswith("left_"):
            other = at[name.replace("left_", "right_")]
            assert at[name][1] > 0
            np.testing.assert_allclose(other, at[name] * [1, -1, 1], atol=0.005)
    for side in ("left_", "right_"):
        assert at[side + "big_toe"][0] > at[side + "small_toe"][0] > at[side + "ankle"][0] > at[side + "heel"][0]
        assert abs(at[side + "small_toe"][1]) > abs(at[side + "big_toe"][1])
        assert at[side + "heel"][2] < at[side + "ankle"][2]


def test_the_page_says_by_how_much_they_may_be_meant_elsewhere() -> None:
    section = PAGE.split("\n## Keypoints\n")[1].split("\n## ")[0]
    told = {}
    for row in re.findall(r"^\| (.*?) \| .*? \| ([\d, ]+) \|$", section, re.MULTILINE):
        names, sigmas = (part.split(", ") for part in row)
        told |= dict(zip(names, sigmas * (len(names) if len(sigmas) == 1 else 1), strict=True))
    for name, sigma_m in zip(KEYPOINTS, landmarks.SIGMA_M, strict=True):
        plain = without_side(name).replace("_", " ")
        assert float(told.get(plain) or told[plain + "s"]) == pytest.approx(1000 * sigma_m)


def linearised(pose: Pose, seen: Array, scale: float) -> tuple[Array, Array]:
    """Hessian (43, 43) and gradient (43,) of the keypoints at ``pose``."""
    frames = kinematics.forward(BODY, pose)
    centre = np.ascontiguousarray(frames[0, :3, 3])
    sums = SegmentSums.zero(centre)
    rows, keypoint = keypoint_residuals.residuals(BODY.landmarks, frames, CAMERA, seen, scale)
    accumulate(rows, landmarks.SEGMENT[keypoint], sums)
    return lift(sums, kinematics.screws(frames, centre))


@settings(max_examples=20, deadline=None)
@given(time_s=st.floats(0.0, 1.0), seed=st.integers(0, 1000))
def test_gradient_is_the_derivative_of_the_robust_cost(time_s: float, seed: int) -> None:
    """The gradient is that of Geman-McClure's ``s^2 e^2 / 2 (s^2 + e^2)`` of all keypoints, by finite differences."""
    rng = np.random.default_rng(seed)
    pose, scale = swing(time_s), 3.0
    seen = detected(pose)
    seen[:, :2] += rng.normal(0.0, 8.0, (len(seen), 2))
    seen[:, 2] = rng.uniform(0.1, 1.0, len(seen))
    # of where a keypoint lies, not of how far away it is: the sigma is taken at the pose
    depth = project(CAMERA, marks(pose))[1]
    sigma = np.hypot(BODY.landmarks.sigma_m, keypoint_residuals._noise_m(seen)) * CAMERA.focal_px / depth

    def cost(delta: Array) -> float:
        pixels, _ = project(CAMERA, marks(kinematics.retract(pose, delta)))
        squared = np.sum((pixels - seen[:, :2]) ** 2, axis=1) / sigma**2
        return float(np.sum(0.5 * squared / (1.0 + squared / scale**2)))

    step = 1e-6 * np.eye(DOF)
    numeric = np.array([(cost(each) - cost(-each)) / 2e-6 for each in step])
    _, gradient = linearised(pose, seen, scale)
    np.testing.assert_allclose(-gradient, numeric, rtol=1e-4, atol=1e-3 * np.abs(numeric).max())


def test_steps_bring_the_body_to_what_the_view_shows() -> None:
    pose = swing(0.4)
    rng = np.random.default_rng(0)
    found = kinematics.retract(pose, 0.1 * rng.normal(size=DOF))
    for _ in range(10):
        hessian, gradient = linearised(found, detected(pose), 30.0)
        found = kinematics.retract(found, np.linalg.solve(hessian + 1e-2 * np.eye(DOF), gradient))
    np.testing.assert_allclose(detected(found)[:, :2], detected(pose)[:, :2], atol=0.5)


def test_what_the_detector_has_not_found_pulls_at_nothing() -> None:
    pose = swing(0.2)
    seen = detected(kinematics.retract(pose, 0.05 * np.ones(DOF)))
    seen[:, 2] = 0.0
    seen[AT["left_wrist"], 2] = 0.8
    hessian, _ = linearised(pose, seen, 3.0)
    moved = np.flatnonzero(np.diag(hessian) > 0)
    assert set(moved) <= set(np.flatnonzero(bodies.MOVES[:, SEGMENTS.index("left_hand")]))
    assert len(moved)
    seen[:, 2] = 0.0
    assert not linearised(pose, seen, 3.0)[0].any()


@pytest.mark.parametrize("swapped", ["left_knee", "left_wrist"])
def test_a_swapped_limb_hardly_pulls(swapped: str) -> None:
    """Far off in sigmas, a keypoint loses its say."""
    pose = swing(0.3)
    seen = detected(pose)
    here, there = AT[swapped], AT[swapped.replace("left_", "right_")]
    near = np.abs(linearised(kinematics.retract(pose, 0.02 * np.eye(DOF)[1]), seen, 3.0)[1]).max()
    seen[[here, there]] = seen[[there, here]]
    assert np.linalg.norm(seen[here, :2] - seen[there, :2]) > 30.0
    assert np.abs(linearised(pose, seen, 3.0)[1]).max() < 0.25 * near


def test_the_athlete_is_the_nearest() -> None:
    pose = swing(0.5)
    athlete, other = detected(pose), detected(pose)
    other[:, 0] += 60.0
    found = keypoint_residuals.nearest(marks(pose), CAMERA, np.stack([other, athlete]))
    assert found is not None
    np.testing.assert_array_equal(found, athlete)
    other[:, 0] += 200.0
    assert keypoint_residuals.nearest(marks(pose), CAMERA, other[None]) is None
    other[:, 2] = 0.0
    assert keypoint_residuals.nearest(marks(pose), CAMERA, np.stack([other])) is None


def test_what_a_detector_means_is_found_out() -> None:
    """From some poses that are known, seen by four cameras; of a keypoint that it does not have nothing is learnt."""
    rng = np.random.default_rng(1)
    meant = landmarks.Landmarks(
        BODY.landmarks.points_m + rng.normal(0.0, 0.015, BODY.landmarks.points_m.shape), BODY.landmarks.sigma_m
    )
    cameras = [aim(position, np.array([0.0, 0.2, 0.9])) for position in POSITIONS]
    estimate = keypoint_residuals.LandmarkEstimate.of(BODY.landmarks)
    before = np.linalg.norm(meant.points_m - BODY.landmarks.points_m, axis=1)
    for time_s in np.linspace(0.0, 1.0, 20):
        frames = kinematics.forward(BODY, swing(time_s))
        for camera in cameras:
            pixels, _ = project(camera, keypoint_residuals.in_world(meant, frames))
            pixels += rng.normal(0.0, 2.0, pixels.shape)
            confidence = np.where(np.arange(len(pixels)) == AT["head_top"], 0.0, 0.8)
            estimate = estimate.accumulate(frames, camera, np.column_stack([pixels, confidence]))
    found = estimate.solve()
    off = np.linalg.norm(found.points_m - meant.points_m, axis=1)
    seen = np.arange(len(off)) != AT["head_top"]
    assert off[seen].mean() < 0.2 * before[seen].mean()
    assert off[seen].max() < 0.010
    assert found.sigma_m[seen].max() < 0.015
    np.testing.assert_array_equal(found.points_m[~seen], BODY.landmarks.points_m[~seen])
    np.testing.assert_array_equal(found.sigma_m[~seen], BODY.landmarks.sigma_m[~seen])


@given(st.floats(0.0, 0.4), st.floats(0.0, 6.3), st.floats(0.1, 1.0))
def test_a_keypoint_agrees_the_less_the_further_off_it_is(off_m: float, angle: float, confidence: float) -> None:
    """Seen off by so much; a half where that is three sigmas of the keypoint."""
    pose, limb = swing(0.4), LIMBS[0]
    frames, person = kinematics.forward(BODY, pose), detected(pose, confidence=confidence)
    depth = project(CAMERA, marks(pose))[1]
    person[:, :2] += (off_m * CAMERA.focal_px / depth)[:, None] * [np.cos(angle), np.sin(angle)]
    agree = keypoint_residuals.agreement(BODY.landmarks, limb, frames[None, list(limb)], CAMERA, person)
    rows = [AT["left_elbow"], AT["left_wrist"]]
    sigma_m = np.hypot(BODY.landmarks.sigma_m[rows], KEYPOINT.detector_m / confidence)
    np.testing.assert_allclose(agree, [np.sum(1.0 / (1.0 + (off_m / (3.0 * sigma_m)) ** 2))], rtol=1e-6)


def test_keypoints_that_were_not_found_agree_with_nothing() -> None:
    frames, person = kinematics.forward(BODY, swing(0.4)), detected(swing(0.4), confidence=0.0)
    posed = np.stack([frames[list(LIMBS[2])]] * 3)
    np.testing.assert_array_equal(
        keypoint_residuals.agreement(BODY.landmarks, LIMBS[2], posed, CAMERA, person), np.zeros(3)
    )
