"""A body that is lost as a whole: noticed, not taken for somebody else, and left to whoever knows better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.body import kinematics
from pzcap.segmentation import foreground
from pzcap.segmentation.expected import Expected
from pzcap.tracking.frame_tracker import FrameTracker, probably_lost
from pzcap.tracking.limbs import mismatch
from pzcap.tracking.observation import anywhere, crop_view, divided, expect
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.skin_colour_model import SkinColourModel
from pzcap.tracking.tracker import ViewInput
from pzcap.tracking.tuning import FRAME
from pzcap.types import Array, Image, Pose
from tests.scenes.tracked import CONFIG, clip, crops, lost, taped, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
FRAME_NUMBER = 6


def elsewhere() -> Pose:
    """The pose half a metre aside."""
    return lost(clip().poses[FRAME_NUMBER], 0, 0.5)


def test_a_body_beside_its_silhouettes_is_lost_and_one_on_them_is_not() -> None:
    views = crops(FRAME_NUMBER)
    here, there = (
        PoseObjective(true_body(), views).place(pose)[1] for pose in (clip().poses[FRAME_NUMBER], elsewhere())
    )
    assert probably_lost(mismatch(views, here)) < 0.05
    assert probably_lost(mismatch(views, there)) > 0.95


def evidence_on_athlete(view: int, expected: Expected | None) -> tuple[float, Image]:
    """Share of the athlete's pixels that a cut-out leaves for her, and where it has somebody else."""
    shot = clip().shots[FRAME_NUMBER][view]
    assert expected is not None
    left, top, right, bottom = expected.window
    part = np.s_[top:bottom, left:right]
    known = np.ones(shot.mask[part].shape, bool)
    settings = foreground.ForegroundConfig()
    found = foreground.subtract(shot.image[part], shot.empty[part], known, shot.camera, 0.0, settings, expected)
    hers = shot.mask[part][::2, ::2]
    return float(np.mean(found.evidence[hers] > 0.0)), found.others


def test_who_is_lost_is_not_taken_for_somebody_else() -> None:
    camera = clip().shots[FRAME_NUMBER][1].camera  # which sees the half metre from the side
    wrong = expect(taped(), elsewhere(), 0.03, camera, FRAME.lost_margin)
    open_ = anywhere(taped(), elsewhere(), camera, FRAME.lost_margin)
    (misled, somebody), (kept, nobody) = (evidence_on_athlete(1, each) for each in (wrong, open_))
    assert somebody.any()
    assert not nobody.any()
    assert misled < 0.5  # the test can fail: an expectation that is wrong takes the athlete away
    assert kept > 0.8


def undivided(evidence: Array) -> ViewInput:
    """A view in which the athlete was lost, with the ``evidence`` (h, w) of half pixels."""
    shot = clip().shots[FRAME_NUMBER][0]
    probability = np.repeat(np.repeat((255 * (evidence > 0)).astype(np.uint8), 2, axis=0), 2, axis=1)
    found = foreground.Silhouette(probability, shot.empty, evidence.astype(np.float32), True)
    found = replace(found, others=np.zeros(evidence.shape, np.uint8))
    return ViewInput(shot.image, shot.camera, found)


def test_whoever_knows_better_tells_the_others_from_her() -> None:
    pose = clip().poses[FRAME_NUMBER]
    hers = clip().shots[FRAME_NUMBER][0].mask[::2, ::2]
    columns = np.flatnonzero(hers.any(axis=0))
    aside = int(np.ptp(columns)) + 12  # half pixels
    somebody = np.roll(hers, aside if columns[-1] + aside < hers.shape[1] else -aside, axis=1)
    view = undivided(np.where(hers | somebody, 4.0, -4.0))
    crop = crop_view(taped(), view, pose, FRAME.lost_margin, SkinColourModel(), lost=True)
    assert crop is not None
    told = divided(taped(), crop, pose, 0.02)
    top, left = crop.top // 2, crop.left // 2
    height, width = told.others.shape
    part = np.s_[top : top + height, left : left + width]
    assert np.mean(told.others[somebody[part]]) > 0.8
    assert np.mean(told.others[hers[part]]) < 0.1
    assert crop.belief.max() == 1.0
    assert np.sum(told.belief > 0.5) < 0.7 * np.sum(crop.belief > 0.5)
    usual = crop_view(taped(), view, pose, FRAME.lost_margin, SkinColourModel())
    assert usual is not None
    assert divided(taped(), usual, pose, 0.02) is usual  # it was cut out by somebody who knew


def test_a_pass_that_is_astray_says_so_and_has_little_say() -> None:
    views, start = crops(FRAME_NUMBER), clip().poses[FRAME_NUMBER]
    tracker = FrameTracker(taped(), CONFIG, start, np.zeros(43), views)
    sure = tracker.step(views)
    assert not tracker.astray
    tracker.pose = lost(start, 0, 1.5)
    unsure = tracker.step(views)
    assert tracker.astray
    assert np.all(unsure.variance > 100 * sure.variance)
    assert np.linalg.norm(kinematics.joints(taped(), sure.pose) - clip().joints_m[FRAME_NUMBER], axis=1).max() < 0.1
