"""Frame-to-frame tracking of the body in one direction of time.

A step predicts the pose with the velocity so far and fits it, coarse to fine, by Gauss-Newton to the images
(`pzcap.tracking.pose_objective`). Where they say little, as of a forearm that is held against the trunk, joints are
expected to come to rest, and no arm to enter the trunk (`pzcap.tracking.body_constraints`): if a joint were expected to
keep its velocity, a small error of it would grow with every frame until the limb is lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import expit

from pzcap.body.kinematics import difference, forward, retract
from pzcap.body.skeleton import DOF_SEGMENT, Body
from pzcap.solver.gauss_newton import SolveReport
from pzcap.tracking.body_constraints import constraints
from pzcap.tracking.limbs import mismatch
from pzcap.tracking.observation import Views, divided
from pzcap.tracking.pixel_time import rates_between
from pzcap.tracking.pose_objective import PosedBody, PoseEquations, PoseObjective, misfit_px2
from pzcap.tracking.settings import Round, TrackingConfig
from pzcap.tracking.skin_appearance import SomeAppearances, learn, mean_appearances
from pzcap.tracking.tuning import BRIGHTNESS, FRAME, PREDICTION_SIGMA
from pzcap.types import DOF, SEGMENTS, Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """The pose of an instant, and how well the images determine it."""

    pose: Pose
    hessian: Array  # (43, 43) information
    contour: Array  # (16, 3) fit to the silhouettes, as `pzcap.tracking.pose_objective.PoseEquations` has it
    seen: bool  # by any view at all


@dataclass(frozen=True, slots=True, eq=False)
class FrameEstimate(PoseEstimate):
    """One direction's estimate of one instant. The information is that of the images alone."""

    velocity: Array  # (43,) tangent, from an instant to the next
    views: Views  # as they were taken
    lost: float  # probability that the whole body is elsewhere
    variance: Array  # (16,) relative, of each segment


NO_CONTOUR: Final = np.zeros((len(SEGMENTS), 3))  # the contour of a body that no view shows


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """A pose fitted to the images of one instant."""

    posed: PosedBody
    objective: PoseObjective  # its cameras corrected along with the pose
    normal: PoseEquations  # of the last iteration
    report: SolveReport


class FrameTracker:
    """Tracks the body from a keyframe, an instant every ``period`` frame periods: forward in time, or backward where
    that is negative."""

    def __init__(
        self, body: Body, config: TrackingConfig, pose: Pose, velocity: Array, views: Views, period: float = 1.0
    ) -> None:
        self.body, self.config, self._period = body, config, period
        self.pose, self.velocity, self.age = pose, velocity, 0
        self.prediction_error_m = FRAME.error_m  # of the joints, lately
        self.lost = 0.0  # probability that the whole body is elsewhere
        self._velocity_known = velocity != 0.0  # of each degree of freedom
        self._persistence = np.where(DOF_SEGMENT > 0, FRAME.joint_persistence, 1.0)  # the body as a whole moves on
        placed = PoseObjective(body, views, self.rates(pose)).place(pose)[1]
        self.appearances = mean_appearances(body, [views], [placed])
        # the adaptive appearance drifts with a limb that is lost; the reference is of frames beside the keyframe alone
        self.reference = [each.copy() for each in self.appearances]

    @property
    def astray(self) -> bool:
        """True where the body is rather lost than not."""
        return self.lost > 0.5

    def predict(self) -> Pose:
        """The pose of the next frame."""
        return retract(self.pose, self.velocity)

    def rates(self, pose: Pose) -> Array:
        """Rates (16, 12) of the segments, forward in time, if they go on through a ``pose`` as they did so far."""
        came_from = forward(self.body, retract(pose, -self.velocity))
        return rates_between(came_from, forward(self.body, pose), self._period)

    def step(self, views: Views) -> FrameEstimate:
        """Move on by one instant."""
        config, predicted = self.config, self.predict()
        self.age += 1
        if all(view is None for view in views):  # nothing was seen: coast, slow down, and be less sure with every frame
            self.pose, self.velocity = predicted, 0.9 * self.velocity
            self.prediction_error_m = math.hypot(self.prediction_error_m, FRAME.error_m)
            no_information, variance = np.zeros((DOF, DOF)), np.full(len(SEGMENTS), 1e3)
            return FrameEstimate(
                predicted, no_information, NO_CONTOUR, False, self.velocity, views, self.lost, variance
            )
        views = [
            None if view is None else divided(self.body, view, predicted, self.prediction_error_m) for view in views
        ]
        sigma = PREDICTION_SIGMA * np.where(self._velocity_known, 1.0, FRAME.start_widening)
        expected = retract(self.pose, self._persistence * self.velocity)
        schedule = [each for each in config.schedule if self.prediction_error_m >= each.surprise_m]
        fit = fit_pose(
            PoseObjective(self.body, views, self.rates(predicted)), predicted, np.diag(1.0 / sigma**2),
            self.appearances, config, schedule, expected,
        )  # fmt: skip
        pose, placed = fit.posed.pose, fit.objective.visibility(fit.posed)
        self.lost = probably_lost(mismatch(views, placed))
        learn(views, placed, self.appearances, FRAME.appearance_rate, BRIGHTNESS.kept)
        if self.age <= FRAME.beside_keyframe:
            learn(views, placed, self.reference, 1.0 / (self.age + 1))
        gain = np.where(self._velocity_known, config.velocity_gain, 1.0)
        velocity = self.velocity + gain * (difference(pose, self.pose) - self.velocity)
        # keypoints pull from far away: such a step is no motion
        leapt = np.abs(difference(pose, predicted)) > FRAME.leap_sigmas * sigma
        self._velocity_known = ~(leapt & fit.objective.detected)
        self.velocity = np.where(self._velocity_known, velocity, 0.0)
        off = fit.posed.frames[:, :3, 3] - forward(self.body, predicted)[:, :3, 3]
        error_m = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        self.prediction_error_m += FRAME.error_gain * (error_m - self.prediction_error_m)
        self.pose = pose
        # a segment drifts away from its keyframe with age, and one that misses the silhouette is wrong
        variance = 0.1 * self.age + misfit_px2(fit.normal.contour, 25.0) ** 2 + self.lost * FRAME.lost_variance
        return FrameEstimate(
            pose, fit.normal.hessian, fit.normal.contour, True, self.velocity, views, self.lost, variance
        )


def probably_lost(unlike: float) -> float:
    """Probability that the body as a whole is elsewhere, from its `limbs.mismatch` with the silhouettes."""
    return float(expit(FRAME.mismatch_slope * (unlike - FRAME.mismatch)))


def fit_pose(
    objective: PoseObjective, start: Pose, prior: Array, appearances: SomeAppearances,
    config: TrackingConfig, schedule: Sequence[Round], expected: Pose | None = None,
) -> PoseFit:  # fmt: skip
    """Gauss-Newton from ``start``, coarse to fine, the cameras of the views corrected along with the pose. Beside the
    images the pose ``expected``, else the start, counts with the information matrix ``prior`` (43, 43)."""
    posed, expected = objective.posed(start), expected or start
    normal: PoseEquations | None = None
    steps, converged = 0, False
    for each in schedule:
        placed = objective.visibility(posed)
        stiff = np.ones(DOF)
        stiff[6:] = each.stiffness
        information = prior * stiff[:, None] * stiff
        for _ in range(each.iterations):
            normal = objective.normal(posed, placed, appearances, each.terms)
            stiffness, pull = constraints(
                objective.body, posed.pose, config.limit_sigma_rad, self_collision=each.solid and config.self_collision,
                spine_sigma_rad=config.spine_sigma_rad,
            )  # fmt: skip
            hessian = normal.hessian + information + stiffness
            gradient = normal.gradient + information @ difference(expected, posed.pose) + pull
            step = np.clip(np.linalg.solve(hessian, gradient), -0.35, 0.35)
            objective = objective.after(normal, step)
            posed = objective.posed(retract(posed.pose, step))
            steps, converged = steps + 1, bool(np.abs(step).max() < config.step_tolerance)
            if converged:
                break
    assert normal is not None, "the last round is always made"
    return PoseFit(posed, objective, normal, SolveReport(converged, steps, normal.cost))
