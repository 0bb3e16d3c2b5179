"""A limb that was lost is found again by the silhouette that it leaves unexplained."""

from __future__ import annotations

import numpy as np
import pytest

from pzcap.body import skeleton as bodies
from pzcap.limbs.search import LIMBS, LimbSearch
from tests.scenes.tracked import clip, lost, observed, true_body


def swung(limb: int, by: float) -> bodies.Pose:
    about = int(np.flatnonzero(LIMBS[limb][0] == bodies.DOF_SEGMENT)[1])
    return lost(clip().poses[3], about, by)


@pytest.mark.parametrize("limb", range(4))
def test_the_search_brings_a_limb_back(limb: int) -> None:
    body, pose = true_body(), swung(limb, 0.9)
    evidence, search = observed(3, body), LimbSearch(body)
    grounds = evidence.grounds(evidence.visibility(evidence.posed(pose)))
    found = search.search(limb, pose, grounds)
    end = LIMBS[limb][2]
    before, after = (np.linalg.norm(bodies.joints(body, p)[end] - clip().joints_m[3, end]) for p in (pose, found))
    assert before > 0.2
    assert after < 0.5 * before
    more = search.support(found, grounds) - search.support(pose, grounds)
    assert more[limb, 0] > 0.01


def test_a_lost_limb_leaves_foreground_that_nothing_explains() -> None:
    body, pose = true_body(), clip().poses[3]
    evidence, search = observed(3, body), LimbSearch(body)
    usual = search.loose(pose, evidence.grounds(evidence.visibility(evidence.posed(pose))))
    away = swung(0, 0.9)
    loose = search.loose(away, evidence.grounds(evidence.visibility(evidence.posed(away))))
    assert loose[0] > usual[0] + 0.01


def test_a_limb_seen_by_nobody_has_no_support() -> None:
    body, pose = true_body(), clip().poses[3]
    assert not LimbSearch(body).support(pose, [None] * 4).any()
