"""All frames between two keyframes refined together: they come to rest, wherever they began."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.body.kinematics import forward, retract
from pzcap.tracking.batch_refinement import RefinedBatch, refine_batch
from pzcap.tracking.camera_refinement import CAMERA_DOF, CameraPrior
from pzcap.tracking.pixel_time import ClockEquations, ClockEstimate
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.view_sequence import ViewSequence
from pzcap.types import DOF, Array, Pose
from tests.scenes.tracked import CONFIG, clip, crops, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
FRAMES = range(2, 11)
CAMERA_SIGMA = np.array([1e-3, 1e-3])


def start(seed: int) -> list[Pose]:
    """The true poses, one of them off as a pass leaves it after a landing."""
    error = np.zeros((len(FRAMES), DOF))
    error[4] = np.random.default_rng(seed).normal(0.0, 0.04, DOF)
    error[4, :3] *= 0.25
    return [retract(clip().poses[frame], each) for frame, each in zip(FRAMES, error, strict=True)]


def refined(poses: list[Pose], config: TrackingConfig = CONFIG) -> RefinedBatch:
    loose = CameraPrior(np.array([0.0, 0.0, 1.0]), np.diag(CAMERA_SIGMA**-2.0), np.zeros(CAMERA_DOF))
    views = ViewSequence([[view and replace(view, camera_prior=loose) for view in crops(f)] for f in FRAMES], 1.0)
    before = [clip().poses[frame] for frame in (0, 1)]
    return refine_batch(true_body(), poses, views, before, None, None, ClockEstimate.of(4, 0.3), config)


def errors_mm(found: RefinedBatch) -> Array:
    joints = np.array([forward(true_body(), each.pose)[:, :3, 3] for each in found.frames])
    return 1e3 * np.linalg.norm(joints - clip().joints_m[FRAMES.start : FRAMES.stop], axis=2)


def corrections(found: RefinedBatch) -> Array:
    """(F, C, 2) of the cameras, in their standard deviations."""
    priors = [[view.camera_prior for view in each.views if view is not None] for each in found.objectives]
    return np.array([[one.correction for one in row if one is not None] for row in priors]) / CAMERA_SIGMA


def test_a_frame_that_began_off_comes_to_where_the_others_are() -> None:
    begun, right = refined(start(0)), refined(list(clip().poses[FRAMES.start : FRAMES.stop]))
    assert begun.report.converged
    assert abs(errors_mm(begun)[4].mean() - errors_mm(right)[4].mean()) < 1.0
    once = refined(start(0), replace(CONFIG, polishing_sweeps=1))
    assert not once.report.converged
    assert errors_mm(begun)[4].max() < errors_mm(once)[4].max()


def test_frames_at_rest_need_not_be_linearised_again() -> None:
    """Against all frames linearised in every step."""
    begun, every = refined(start(1)), refined(start(1), replace(CONFIG, step_tolerance=0.0))
    assert begun.report.steps < every.report.steps == CONFIG.polishing_sweeps
    apart = [
        np.linalg.norm(forward(true_body(), a.pose)[:, :3, 3] - forward(true_body(), b.pose)[:, :3, 3], axis=1)
        for a, b in zip(begun.frames, every.frames, strict=True)
    ]
    assert 1e3 * np.max(apart) < 2.0
    assert np.abs(corrections(begun)).max() > 0.3  # there is something to correct
    assert np.abs(corrections(begun) - corrections(every)).max() < 0.1


def test_equations_of_a_clock_follow_small_steps() -> None:
    """Of a linear problem exactly: the pull is what residuals that have changed by the steps make."""
    rng = np.random.default_rng(3)
    by_pose, by_clock, residuals = rng.normal(size=(60, DOF)), rng.normal(size=60), rng.normal(size=60)
    step, tick = rng.normal(size=DOF), 0.3
    before = ClockEquations(float(by_clock @ by_clock), float(by_clock @ residuals), by_clock @ by_pose)
    left = residuals - by_pose @ step - tick * by_clock
    assert before.after(step, tick).pull == pytest.approx(by_clock @ left)
