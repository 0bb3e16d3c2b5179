"""Two estimates made one: what both say of a hand is kept, however they bend the trunk; and no limb leaps away."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.body import kinematics
from pzcap.body.kinematics import joints
from pzcap.body.skeleton import DOF_SEGMENT, LIMBS
from pzcap.tracking.bidirectional_fusion import Fused, choose, fuse
from pzcap.types import DOF, JOINTS, SEGMENTS, Array, Pose
from tests.scenes.tracked import clip, lost, step, true_body, without_score

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
ARM = 0
WRIST = JOINTS.index("left_wrist")
ANY_M: Array = np.full((11, len(SEGMENTS)), 0.02)


def turned(pose: Pose, segment: str, about: int, angle_rad: float) -> Pose:
    """A segment turned about one of its own axes."""
    delta = np.zeros(DOF)
    delta[np.flatnonzero(SEGMENTS.index(segment) == DOF_SEGMENT)[about] + (3 if segment == "pelvis" else 0)] = angle_rad
    return kinematics.retract(pose, delta)


@settings(deadline=None)
@given(
    angle=st.floats(-0.6, 0.6), trust=st.lists(st.floats(0.05, 20.0), min_size=len(SEGMENTS), max_size=len(SEGMENTS))
)
def test_a_trunk_that_is_bent_otherwise_throws_no_arm_away(angle: float, trust: list[float]) -> None:
    """One pass has the pelvis turned about the spine, and the lumbar back: from there up both say the same."""
    body, pose = true_body(), clip().poses[4]
    # the lumbar stands on the pelvis's z axis and is not turned against it, so that this moves nothing above
    upright = Pose(pose.root_position_m, pose.rotations.copy())
    upright.rotations[SEGMENTS.index("lumbar")] = 1.0, 0.0, 0.0, 0.0
    other = turned(turned(upright, "pelvis", 2, angle), "lumbar", 2, -angle)
    above = [JOINTS.index(name) for name in JOINTS if "hip" not in name and "knee" not in name and "ankle" not in name]
    np.testing.assert_allclose(joints(body, upright)[above], joints(body, other)[above], atol=1e-9)
    ahead, back = step(upright), step(other)
    back.variance[:] = trust
    (merged,) = fuse(body, upright, [ahead], [back], other, without_score).poses
    np.testing.assert_allclose(joints(body, merged)[above], joints(body, upright)[above], atol=1e-6)


@settings(deadline=None, max_examples=20)
@given(lead_m2=st.floats(0.0, 0.2), more_m2=st.floats(0.0, 0.1))
def test_the_less_the_pass_that_was_chosen_leads_the_more_a_limb_is_in_doubt(lead_m2: float, more_m2: float) -> None:
    """Each is as likely right where nothing tells the two apart; and one that leads by far leaves no doubt."""
    body, away = true_body(), paths(0.6 * np.sin(np.pi * np.arange(1, 12) / 12))
    first, *true, last = clip().poses
    passes = [step(pose) for pose in true], [step(pose) for pose in away]

    def fused(lead_m2: float) -> Fused:
        return fuse(body, first, *passes, last, lambda one, _: np.full(len(LIMBS), lead_m2 * (one == 0)))

    less, more = fused(lead_m2), fused(lead_m2 + more_m2)
    assert (more.doubt_m <= less.doubt_m + 1e-12).all()
    assert (less.doubt_m <= np.sqrt(0.5) * less.apart_m + 1e-12).all()
    np.testing.assert_allclose(fused(0.0).doubt_m, np.sqrt(0.5) * less.apart_m)
    assert fused(0.3).doubt_m.max() < 1e-3 * less.apart_m.max()


def paths(far_rad: Array) -> list[Pose]:
    """The clip's inner frames, an arm turned away by so much in each."""
    shoulder = int(np.flatnonzero(SEGMENTS.index("left_upper_arm") == DOF_SEGMENT)[1])
    return [lost(pose, shoulder, float(far)) for pose, far in zip(clip().poses[1:-1], far_rad, strict=True)]


def gains(m2: float) -> Array:
    gain = np.zeros((11, len(LIMBS)))
    gain[:, ARM] = m2
    return gain


def test_a_limb_that_leaps_away_for_a_frame_is_left_where_it_was() -> None:
    body, there = true_body(), paths(np.zeros(11))
    away = paths(np.where(np.arange(11) == 5, 0.8, 0.0))
    found = choose(body, clip().poses[0], there, away, ANY_M, gains(0.02))
    np.testing.assert_array_equal([joints(body, pose) for pose in found], [joints(body, pose) for pose in there])


@pytest.mark.parametrize("last", [5, 10])
def test_a_limb_that_had_leapt_away_is_taken_back(last: int) -> None:
    """Also at the end, where no frame tells what comes after."""
    body, there = true_body(), paths(np.zeros(11))
    frames = np.arange(11)
    away = paths(np.where((frames > last - 2) & (frames <= last), 0.8, 0.0))
    found = choose(body, clip().poses[0], away, there, ANY_M, gains(0.02))
    np.testing.assert_allclose([joints(body, pose) for pose in found], [joints(body, pose) for pose in there])
    nowhere = choose(body, clip().poses[0], away, there, np.full_like(ANY_M, np.inf), gains(0.02))
    assert np.linalg.norm(joints(body, nowhere[last])[WRIST] - joints(body, there[last])[WRIST]) > 0.2


def test_what_is_worth_no_more_is_left() -> None:
    body, there = true_body(), paths(np.zeros(11))
    aside = paths(0.5 * np.sin(np.pi * np.arange(1, 12) / 12))
    for gain, expected in ((-0.02, there), (0.02, aside)):
        found = choose(body, clip().poses[0], there, aside, ANY_M, gains(gain))
        np.testing.assert_allclose(joints(body, found[5]), joints(body, expected[5]), atol=1e-9)
