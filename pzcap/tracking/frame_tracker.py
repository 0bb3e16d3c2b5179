"""Frame-to-frame tracking of the body in one direction of time.

A step predicts the pose with the velocity so far and fits it, coarse to fine, by Gauss-Newton to the images
(`pzcap.tracking.pose_objective`). Where they say little, as of a forearm that is held against the trunk, joints are
expected to come to rest, and no arm to enter the trunk (`pzcap.tracking.body_constraints`): if a joint were expected to
keep its velocity, a small error of it would grow with every frame until the limb is lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from pzcap.body.kinematics import difference, forward, retract
from pzcap.body.skeleton import DOF, DOF_SEGMENT, Body
from pzcap.solver.gauss_newton import SolveReport
from pzcap.tracking.body_constraints import constraints
from pzcap.tracking.observation import Views
from pzcap.tracking.pose_objective import PosedBody, PoseEquations, PoseObjective, Terms, misfit_px2
from pzcap.tracking.skin_appearance import Appearance, learn, mean_appearances
from pzcap.tracking.tuning import FRAME
from pzcap.types import SEGMENTS, Array, Pose, PzcapError


@dataclass(frozen=True, slots=True)
class Round:
    """Some iterations with the same residuals."""

    terms: Terms
    """Residuals that count."""
    iterations: int
    """At most."""
    stiffness: float = 1.0
    """Factor of the joints' prior; large: the body moves as a whole."""
    solid: bool = True
    """The trunk keeps arms out; else one that is found again may pass through it."""
    surprise_m: float = 0.0
    """The round is left out where predictions have been nearer than this lately."""


def _schedule() -> tuple[Round, ...]:
    def terms(
        level: int, reach: float, contour_sigma: float, contour_weight: float, brightness_sigma: float,
        keypoint_scale: float,
    ) -> Terms:  # fmt: skip
        return Terms(level, reach, contour_sigma, brightness_sigma, contour_weight, 0.15, 0.15, 0.3, keypoint_scale)

    # the edge that is nearest to a hand is often another limb's: limbs by themselves are led to far edges with caution
    return (
        Round(terms(2, 30.0, 8.0, 0.3, 20.0, 10.0), 5, 5.0, solid=False, surprise_m=0.025),
        Round(terms(2, 20.0, 4.0, 0.15, 20.0, 10.0), 4, solid=False),
        Round(terms(1, 10.0, 2.0, 0.2, 15.0, 5.0), 3),
        Round(terms(0, 5.0, 1.0, 0.3, 12.0, 3.0), 1),
    )


@dataclass(frozen=True, slots=True)
class TrackingConfig:
    """Defaults suit a body of 150-400 pixels at 25-60 frames a second."""

    keyframe_position_sigma_m: float = 0.010
    """Standard deviation of the root as a hand places it in a keyframe."""
    keyframe_rotation_sigma_rad: float = 0.052
    """Standard deviation of each joint as a hand turns it: 3 degrees."""
    appearance_rate: float = 0.15
    """Share of the image that the appearance takes on with each frame."""
    prediction_position_sigma_m: float = 0.03
    """Standard deviation of the predicted root, a frame."""
    prediction_rotation_sigma_rad: float = 0.20
    """Standard deviation of each predicted joint, a frame."""
    velocity_gain: float = 0.8
    """Share of a frame's motion that the velocity takes on."""
    joint_persistence: float = 0.2
    """Share of a joint's velocity that is expected to go on: unseen limbs come to rest."""
    limit_sigma_rad: float = 0.05
    """Standard deviation beyond the limits of the joints, which are wide and soft."""
    cut_out_margin: float = 0.1
    """Margin that is kept of a view around the body, in sizes of the body."""
    step_tolerance: float = 3e-3
    """Metres, radians: a smaller step ends a round."""
    schedule: tuple[Round, ...] = field(default_factory=_schedule)
    """Rounds of a fit, coarse to fine."""
    start_widening: float = 4.0
    """Factor of a prediction's sigma while the velocity is not known."""
    shape_weight: float = 0.024
    """Weight of a frame's contour in the estimate of the body's shape: the next frame errs alike. 0: the body stays as
    the tape has it."""
    shape_texture_weight: float = 0.6
    """Weight of a frame's brightness in that estimate."""
    shape_rounds: int = 2
    """Alternations of correcting the body and the poses, an interval."""
    acceleration_position_sigma_m: float = 0.01
    """Standard deviation of the root's acceleration, a frame squared."""
    acceleration_rotation_sigma_rad: float = 0.05
    """Standard deviation of each joint's acceleration, a frame squared."""
    polishing_sweeps: int = 2
    """Gauss-Newton steps of all frames of an interval together."""
    longest_stretch: int = 200
    """Frames that wait for a keyframe to be tracked backward."""
    longest_lead: int = 120
    """Frames before the first keyframe that are kept to be tracked backward."""
    camera_refinement: bool = True
    """Correct pan and focal length of each view along with the pose, where the background leaves them open."""
    self_collision: bool = True
    """Keep the arms out of the trunk: a hidden forearm could as well be inside it."""
    skin_colours: bool = True
    """Learn the colours of the lower arms at the keyframes, to see an arm before the trunk."""
    contacts: bool = True
    """Tie points at rest on the floor to where they are: a standing foot trembles otherwise."""
    appearance_score: bool = True
    """Judge limbs also by what they look like, where the passes disagree or a limb is lost."""
    reacquisition: bool = True
    """Search between two keyframes for limbs that both passes have lost."""
    shape_refit: bool = True
    """Refit early frames to the body as it is known in the end."""

    def __post_init__(self) -> None:
        if not self.schedule or self.schedule[-1].surprise_m > 0.0:
            raise PzcapError("tracking.schedule has no last round that is always made; give it surprise_m: 0")

    @property
    def hand_sigma(self) -> Array:
        """(43,) Standard deviation of a keyframe's pose in its tangent."""
        return _tangent(self.keyframe_position_sigma_m, self.keyframe_rotation_sigma_rad)

    @property
    def prediction_sigma(self) -> Array:
        """(43,) Standard deviation of a predicted pose in its tangent."""
        return _tangent(self.prediction_position_sigma_m, self.prediction_rotation_sigma_rad)

    @property
    def acceleration_sigma(self) -> Array:
        """(43,) Standard deviation of the acceleration of a pose in its tangent, a frame squared."""
        return _tangent(self.acceleration_position_sigma_m, self.acceleration_rotation_sigma_rad)


def _tangent(position_m: float, rotation_rad: float) -> Array:
    return np.r_[np.full(3, position_m), np.full(DOF - 3, rotation_rad)]


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

    velocity: Array  # (43,) tangent a frame
    variance: Array  # (16,) relative, of each segment


NO_CONTOUR: Final = np.zeros((len(SEGMENTS), 3))
"""The contour of a body that no view shows."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """A pose fitted to the images of one instant."""

    posed: PosedBody
    objective: PoseObjective  # its cameras corrected along with the pose
    normal: PoseEquations  # of the last iteration
    report: SolveReport


class FrameTracker:
    """Tracks the body in one direction of time from a keyframe."""

    def __init__(self, body: Body, config: TrackingConfig, pose: Pose, velocity: Array, views: Views) -> None:
        self.body, self.config = body, config
        self.pose, self.velocity, self.age = pose, velocity, 0
        self.prediction_error_m = config.prediction_position_sigma_m  # of the joints, lately
        self._velocity_known = velocity != 0.0  # of each degree of freedom
        self._persistence = np.where(DOF_SEGMENT > 0, config.joint_persistence, 1.0)  # the body as a whole moves on
        self.appearances = mean_appearances(body, [views], [PoseObjective(body, views).place(pose)[1]])
        # the adaptive appearance drifts with a limb that is lost; the reference is of frames beside the keyframe alone
        self.reference = [each.copy() for each in self.appearances]

    def predict(self) -> Pose:
        """The pose of the next frame."""
        return retract(self.pose, self.velocity)

    def step(self, views: Views) -> FrameEstimate:
        """Move on by one frame."""
        config, predicted = self.config, self.predict()
        self.age += 1
        if all(view is None for view in views):  # nothing was seen: coast, slow down, and be less sure with every frame
            self.pose, self.velocity = predicted, 0.9 * self.velocity
            self.prediction_error_m = math.hypot(self.prediction_error_m, config.prediction_position_sigma_m)
            no_information, variance = np.zeros((DOF, DOF)), np.full(len(SEGMENTS), 1e3)
            return FrameEstimate(predicted, no_information, NO_CONTOUR, False, self.velocity, variance)
        sigma = config.prediction_sigma * np.where(self._velocity_known, 1.0, config.start_widening)
        expected = retract(self.pose, self._persistence * self.velocity)
        schedule = [each for each in config.schedule if self.prediction_error_m >= each.surprise_m]
        fit = fit_pose(
            PoseObjective(self.body, views), predicted, np.diag(1.0 / sigma**2), self.appearances, config, schedule,
            expected,
        )  # fmt: skip
        pose, placed = fit.posed.pose, fit.objective.visibility(fit.posed)
        learn(views, placed, self.appearances, config.appearance_rate)
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
        variance = 0.1 * self.age + misfit_px2(fit.normal.contour, 25.0) ** 2
        return FrameEstimate(pose, fit.normal.hessian, fit.normal.contour, True, self.velocity, variance)


def fit_pose(
    objective: PoseObjective, start: Pose, prior: Array, appearances: Sequence[Appearance | None],
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
                objective.body, posed.pose, config.limit_sigma_rad, self_collision=each.solid and config.self_collision
            )
            hessian = normal.hessian + information + stiffness
            gradient = normal.gradient + information @ difference(expected, posed.pose) + pull
            step = np.clip(np.linalg.solve(hessian, gradient), -0.35, 0.35)
            objective = objective.with_cameras(normal.cameras, step)
            posed = objective.posed(retract(posed.pose, step))
            steps, converged = steps + 1, bool(np.abs(step).max() < config.step_tolerance)
            if converged:
                break
    assert normal is not None, "the last round is always made"
    return PoseFit(posed, objective, normal, SolveReport(converged, steps, normal.cost))
