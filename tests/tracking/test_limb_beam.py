"""A limb is followed from a frame in which it is known, wherever the tracker has put it meanwhile."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pzcap.body import kinematics
from pzcap.body.skeleton import LIMBS
from pzcap.tracking.appearance import LimbAppearance
from pzcap.tracking.limb_beam import follow_limb
from pzcap.tracking.pixel_time import rates_between
from pzcap.tracking.skin_appearance import shared
from pzcap.tracking.tuning import BEAM
from pzcap.types import Array, Pose
from tests.scenes.tracked import clip, known, observed, swung, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once


@pytest.mark.parametrize("limb", range(4))
@pytest.mark.parametrize("backward", [False, True])
def test_a_limb_is_followed_where_the_tracker_has_lost_it(limb: int, backward: bool) -> None:
    body, looks, rows = true_body(), shared(known()), list(LIMBS[limb][1:])
    limbs, order = LimbAppearance(body), range(9, 1, -1) if backward else range(2, 10)
    before, last, *frames = order
    true, lost = ([each(frame) for frame in frames] for each in (lambda f: clip().poses[f], lambda f: astray(f, limb)))
    contexts = [
        limbs.context(limb, pose, observed(frame, body), looks) for frame, pose in zip(frames, lost, strict=True)
    ]
    beams = follow_limb(limbs, limb, contexts, clip().poses[before], clip().poses[last], -1.0 if backward else 1.0)

    def off_m(pose: Pose, other: Pose) -> Array:
        """(2,) of the limb's joints."""
        return np.linalg.norm((kinematics.joints(body, pose) - kinematics.joints(body, other))[rows], axis=1)

    assert len(beams) == len(frames)
    for beam, here, gone in zip(beams, true, lost, strict=True):
        assert off_m(gone, here).max() > 0.2
        assert min(off_m(each.pose, here).max() for each in beam) < 0.06
        assert len(beam) <= BEAM.looks[-1].width
        for one, other in combinations(beam, 2):
            assert off_m(one.pose, other.pose).max() > BEAM.apart_m
    best = beams[-1][0]
    assert off_m(best.pose, true[-1]).max() < 0.1
    placed = [kinematics.forward(body, clip().poses[frame]) for frame in order[-2:]]
    went = rates_between(*placed, -1.0 if backward else 1.0)[rows, :3]
    assert np.linalg.norm(best.rates[rows, :3] - went, axis=1).max() < 0.1


def astray(frame: int, limb: int) -> Pose:
    return swung(clip().poses[frame], limb, 0.9)
