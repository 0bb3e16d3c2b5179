"""A limb is supported by the silhouettes that show it; where these are not of the body as a whole, it is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.body import kinematics
from pzcap.body.skeleton import DOF_SEGMENT, LIMBS
from pzcap.tracking.limbs import beyond_limits, mismatch, support, turned
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.tracked_body import lost
from pzcap.types import Pose
from tests.scenes.tracked import clip, observed, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once


def differing(objective: PoseObjective, pose: Pose) -> float:
    return mismatch(objective.views, objective.place(pose)[1])


def test_a_limb_seen_by_nobody_has_no_support() -> None:
    body, pose = true_body(), clip().poses[3]
    assert not support(PoseObjective(body, [None] * 4), pose, [None] * 4).any()


def with_somebody(objective: PoseObjective) -> PoseObjective:
    """At the left of each view somebody half as large is taken for the athlete."""
    beside = []
    for view in objective.views:
        assert view is not None
        belief = view.belief.copy()
        belief[40:80, :6] = 1.0
        beside.append(replace(view, belief=belief))
    return PoseObjective(objective.body, beside)


def test_body_and_silhouettes_differ_little_where_it_is_and_much_elsewhere() -> None:
    objective, pose = observed(5, true_body()), clip().poses[5]
    away = Pose(pose.root_position_m + np.array([0.3, 0.3, 0.0]), pose.rotations)
    assert differing(objective, pose) < 0.05
    assert differing(objective, away) > 0.3
    assert lost(objective, pose) < 1e-3
    assert lost(objective, away) > 0.99


def test_somebody_beside_the_athlete_is_no_lost_body() -> None:
    objective, pose = observed(5, true_body()), clip().poses[5]
    away = Pose(pose.root_position_m + np.array([0.3, 0.3, 0.0]), pose.rotations)
    assert lost(with_somebody(objective), pose) < 0.1
    assert lost(with_somebody(objective), away) > 0.99
    unknown = [view and replace(view, belief=np.zeros_like(view.belief)) for view in objective.views]
    assert differing(PoseObjective(objective.body, unknown), away) == 0.0


def test_without_views_nothing_differs() -> None:
    assert mismatch([None] * 4, [None] * 4) == pytest.approx(0.0)


@pytest.mark.parametrize("limb", range(4))
def test_a_ball_joint_beyond_its_limits_costs_what_the_tracker_has_it_cost(limb: int) -> None:
    pose, turns = clip().poses[4], np.random.default_rng(limb).uniform(-1.5, 1.5, (40, 4))
    turns[:, 3] = 0.0
    ball = LIMBS[limb][0] == DOF_SEGMENT
    wanted = [np.sum(kinematics.limit_residuals(turned(limb, pose, turn))[0][ball] ** 2) for turn in turns]
    np.testing.assert_allclose(beyond_limits(limb, pose, turns), wanted, atol=1e-12)
    assert np.any(np.array(wanted) > 0.1) == (limb >= 2)  # a shoulder is free
