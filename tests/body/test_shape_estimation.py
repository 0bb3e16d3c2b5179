"""The body's corrections: what they change, and that contours find them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pzcap.body import skeleton as bodies
from pzcap.body.kinematics import forward
from pzcap.body.segment_equations import PointResiduals, SegmentSums
from pzcap.body.shape_basis import LENGTHS, basis, corrected
from pzcap.body.shape_estimation import FrameResiduals, Postures, ShapeEquations, ShapeEstimate
from pzcap.body.skeleton import Body
from pzcap.body.tuning import SHAPE
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.tuning import HAND_SIGMA
from pzcap.types import DOF, SEGMENTS, Array, Subject
from tests.scenes.tracked import TERMS, clip, crops, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once


def test_a_length_corrects_the_skeleton_and_stretches_the_skin() -> None:
    body = true_body()
    change = basis(body)
    upper_arm = 4  # after trunk, shoulder drop and both widths
    amounts = np.zeros(len(change.sigma_m))
    amounts[upper_arm] = 0.01
    longer = corrected(body, change, amounts)
    moved = longer.offsets_m - body.offsets_m
    np.testing.assert_allclose(moved[[5, 8], 2], -0.01)
    assert np.count_nonzero(moved) == 2
    arm = body.surface.segment == 4
    reach = [shape.surface.points_m[arm, 2].min() for shape in (body, longer)]
    assert 0.009 < reach[0] - reach[1] < 0.013
    assert np.array_equal(longer.surface.points_m[~arm & (body.surface.segment != 7)],
                          body.surface.points_m[~arm & (body.surface.segment != 7)])  # fmt: skip


def test_a_hinge_lies_in_the_middle_of_its_limb() -> None:
    """A shank may be bent and its ankle lie off the middle, but at the knee it is centred, as the thigh is."""
    body = true_body()
    change = basis(body)

    def sigma_across(segment: int, height: float) -> float:
        z = body.surface.points_m[body.surface.segment == segment, 2]
        axis = np.array([[0.0, 0.0, z.min() + height * np.ptp(z)]])
        derivative = change.skin_change(segment, axis, np.array([[1.0, 0.0, 0.0]]))[0]
        return float(np.sqrt(derivative @ change.covariance_m2 @ derivative))

    thigh, shank = SEGMENTS.index("left_thigh"), SEGMENTS.index("left_shank")
    assert max(sigma_across(thigh, 0.0), sigma_across(shank, 1.0)) < 1.01 * SHAPE.centred_sigma_m
    assert min(sigma_across(thigh, 0.5), sigma_across(shank, 0.0)) > 1.5 * SHAPE.centred_sigma_m


def texture_that_lies_off(body: Body) -> FrameResiduals:
    """Residuals of a frame by which the brightness of the left shank's skin lies 2 cm further down the limb."""
    frames, shank = forward(body, clip().poses[4]), SEGMENTS.index("left_shank")
    sums = SegmentSums.zero(np.ascontiguousarray(frames[0, :3, 3]))
    wrench = np.concatenate([frames[shank, :3, 2], np.cross(frames[shank, :3, 3] - sums.centre, frames[shank, :3, 2])])
    sums.hessians[shank] = 1e8 * np.outer(wrench, wrench)
    sums.gradients[shank] = -0.02 * 1e8 * SHAPE.texture_curvature * wrench
    no_contour = PointResiduals(np.zeros((0, 8)), np.zeros(0, np.int64))
    return FrameResiduals(frames, no_contour, sums, 1e8 * np.eye(DOF), np.zeros(DOF))


def test_texture_may_lie_as_far_off_as_the_body_it_was_learned_with() -> None:
    """Of an athlete whose tape is known the texture slides; of one who is guessed it does so as freely."""
    shares = []
    for sigma_m in (0.005, 0.05):
        shape = ShapeEstimate.of(bodies.build(Subject(clip().measurements_m, sigma_m)))
        longer = shape.solve(shape.accumulate([texture_that_lies_off(shape.tape)])).amounts_m[6]
        shares.append(longer / 0.02)
    assert np.all((np.array(shares) > 0.02) & (np.array(shares) < 0.3)), shares
    assert shares[1] < 2.0 * shares[0]


def test_jacobians_are_derivatives_of_the_skin() -> None:
    """Moving the body by a correction moves each contour point as its row says."""
    body, pose = true_body(), clip().poses[4]
    evidence = PoseObjective(body, crops(4))
    contour, shape = evidence.contour(*evidence.place(pose), TERMS), ShapeEstimate.of(body)
    segment, along, points = contour.owner, contour.rows[:, 2:5], contour.rows[:, 5:]
    frames = forward(body, pose)
    jacobian = shape._jacobian(frames, contour)
    by_pose, by_slides, by_shape = np.hsplit(jacobian, [DOF, jacobian.shape[1] - len(shape.amounts_m)])
    change = basis(body)
    local = np.einsum("nji,nj->ni", frames[segment, :3, :3], points - frames[segment, :3, 3])
    for k in range(len(change.sigma_m)):
        amounts = np.zeros(len(change.sigma_m))
        amounts[k] = 1e-3
        there = forward(corrected(body, change, amounts), pose)
        skin = local.copy()
        for s in np.unique(segment):
            here = segment == s
            skin[here] = change.displaced(s, local[here], amounts)
        moved = np.einsum("nij,nj->ni", there[segment, :3, :3], skin) + there[segment, :3, 3]
        expected = np.einsum("ni,ni->n", along, moved - points) / 1e-3
        np.testing.assert_allclose(by_shape[:, k], expected, atol=1e-6 * max(1.0, np.abs(expected).max()))
    assert by_pose.shape == (len(local), DOF)
    assert not by_slides.any()


def test_what_is_learned_narrows_the_joints_sigma() -> None:
    """By each frame, and never to nothing: frames err alike, and the hips are inside."""
    body = true_body()
    shape = ShapeEstimate.of(body)
    variances = []
    for frame in (0, 4, 8):
        evidence, pose = PoseObjective(body, crops(frame)), clip().poses[frame]
        rows = evidence.contour(*evidence.place(pose), TERMS)
        rows.rows[:, 0] *= 0.024
        residuals = FrameResiduals(forward(body, pose), rows, None, 1e-3 * np.eye(DOF), np.zeros(DOF))
        shape = shape.commit(shape.accumulate([residuals]))
        variances.append(shape.joint_variance().mean())
    assert variances[0] > variances[1] > variances[2]
    assert 0.001 < np.sqrt(variances[2]) < 0.02


def test_frames_of_one_posture_leave_the_joints_sigma_as_one_does_and_other_postures_narrow_it() -> None:
    """Contours err alike in all frames of a posture: what a thousand of them agree about is no surer than one is."""
    estimate = ShapeEstimate.of(true_body())
    rng, size = np.random.default_rng(0), len(estimate.amounts_m)

    def variance(number: int, joints: Callable[[], Array]) -> Array:
        after = estimate
        for _ in range(number):
            moved = joints()
            after = after.commit(ShapeEquations(1e4 * np.eye(size), np.zeros(size), moved, Postures.of(moved)))
        first = replace(after.equations, joints=one)  # the same to be judged by
        return replace(after, equations=first).joint_variance()

    one = rng.normal(size=(1, 16, 3, size))
    alone = variance(1, lambda: one)
    np.testing.assert_allclose(variance(100, lambda: one), alone)
    others = variance(100, lambda: rng.normal(size=one.shape))
    assert np.all(others < alone)
    # nor do they tell more than there are, or than postures that differ in all tell at most
    assert np.all(variance(3, lambda: rng.normal(size=one.shape)) > others)
    np.testing.assert_allclose(variance(2000, lambda: rng.normal(size=one.shape)), others, rtol=0.05)


def test_frames_of_one_posture_move_the_body_from_the_tape_as_one_does_and_other_postures_further() -> None:
    """However many frames agree about a length, if all of them have it from the same posture the tape still counts."""
    estimate = ShapeEstimate.of(true_body())
    rng, size, thigh = np.random.default_rng(0), len(estimate.amounts_m), 6
    tape = estimate.basis.sigma_m[thigh] ** -2.0
    longer = np.zeros(size)
    longer[thigh] = 0.01

    def found(number: int, joints: Callable[[], Array]) -> float:
        after = estimate
        for _ in range(number):
            moved, information = joints(), np.diag(np.where(longer > 0.0, tape, 0.0))
            after = after.commit(ShapeEquations(information, information @ longer, moved, Postures.of(moved)))
        nothing = ShapeEquations(np.zeros((size, size)), np.zeros(size), moved[:0], Postures.of(moved[:0]))
        return float(after.solve(nothing).amounts_m[thigh])

    one = rng.normal(size=(1, 16, 3, size))
    alone = found(1, lambda: one)
    assert 0.002 < alone < 0.007
    np.testing.assert_allclose(found(100, lambda: one), alone)
    assert found(30, lambda: rng.normal(size=one.shape)) > 0.009


def test_cloth_is_doubted_for_what_it_is_and_skin_for_less_than_is_assumed_of_people() -> None:
    """People are more alike than the basis assumes, the room under a shirt is not."""
    tape = clip().measurements_m
    tight, loose = (basis(bodies.build(Subject(tape, 0.005, loose_m=worn))).doubt for worn in ({}, {"shirt": 0.04}))
    lengths, clothed = slice(0, LENGTHS), loose > tight
    assert np.array_equal(tight[lengths], loose[lengths])
    np.testing.assert_allclose(tight[LENGTHS:], SHAPE.doubt_of_skin)
    assert clothed.any()
    assert np.array_equal(loose[~clothed], tight[~clothed])  # the legs are bare
    assert np.all(loose[clothed] < 1.0)


def test_texture_moves_with_its_segment() -> None:
    """A segment's twist by pose and corrections is what its joint does, and a slide is the opposite of its own."""
    body, pose = true_body(), clip().poses[4]
    shape, change, frames = ShapeEstimate.of(body), basis(body), forward(body, pose)
    moved = shape._twists(frames)
    centre, knee, thigh_length, changes = frames[0, :3, 3], 11, 6, moved.shape[2] - len(change.sigma_m)
    np.testing.assert_allclose(moved[knee, :3, changes + thigh_length], -frames[10, :3, 2])
    arm = frames[knee, :3, 3] - centre
    slides = moved[knee, :, DOF + 6 * knee : DOF + 6 * knee + 6]
    at_joint = slides[:3] + np.cross(slides[3:], arm, axisa=0).T
    np.testing.assert_allclose(at_joint, np.hstack([-frames[knee, :3, :3], np.zeros((3, 3))]), atol=1e-12)


def amounts_found(measurements_m: dict[str, float]) -> Array:
    """The corrections that true silhouettes at true poses ask for."""
    body = bodies.build(Subject(measurements_m, 0.01))
    shape, residuals = ShapeEstimate.of(body), []
    for frame in range(0, 13, 3):
        evidence, pose = PoseObjective(body, crops(frame)), clip().poses[frame]
        rows = evidence.contour(*evidence.place(pose), TERMS)
        rows.rows[:, 0] *= 0.1
        residuals.append(FrameResiduals(forward(body, pose), rows, None, 1e6 * np.eye(DOF), np.zeros(DOF)))
    return shape.solve(shape.accumulate(residuals)).amounts_m


def test_a_wrong_tape_is_corrected() -> None:
    """Thighs that are taken for two centimetres too short are made longer, by about half of that."""
    thigh = 6
    wrong = dict(clip().measurements_m)
    wrong["thigh"] -= 0.02
    assert 0.008 < amounts_found(wrong)[thigh] < 0.025
    assert abs(amounts_found(clip().measurements_m)[thigh]) < 0.006


def test_shoulders_that_end_too_high_are_brought_down() -> None:
    """Where the upper arms' skin stands two centimetres too far above the joint, the skin is corrected, not the arm."""
    body, arm, forearm = true_body(), SEGMENTS.index("left_upper_arm"), SEGMENTS.index("left_forearm")
    arms = np.isin(body.surface.segment, [arm, SEGMENTS.index("right_upper_arm")])
    points = body.surface.points_m.copy()
    above = arms & (points[:, 2] > 0.0)
    points[above, 2] *= 1.0 + 0.02 / points[above, 2].max()
    wrong = replace(body, surface=body.surface.moved(points))
    shape, hand, residuals = ShapeEstimate.of(wrong), np.diag(1.0 / HAND_SIGMA**2), []
    for frame in range(0, 13, 3):
        evidence, pose = PoseObjective(wrong, crops(frame)), clip().poses[frame]
        rows = evidence.contour(*evidence.place(pose), TERMS)
        rows.rows[:, 0] *= 0.1
        residuals.append(FrameResiduals(forward(wrong, pose), rows, None, hand, np.zeros(DOF)))
    solved = shape.solve(shape.accumulate(residuals))
    found = solved.body(solved.amounts_m)
    assert points[arms, 2].max() - found.surface.points_m[arms, 2].max() > 0.003
    assert abs(found.offsets_m[forearm, 2] - body.offsets_m[forearm, 2]) < 0.001
