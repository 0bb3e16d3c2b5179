"""The body as it is known so far, accumulated from keyframes and from the frames between them.

Contours and texture correct the body's shape (`pzcap.body.shape_estimation`). A keyframe also tells where on the body
the detector's keypoints lie (`pzcap.tracking.keypoint_residuals`), and where in the skin the joints are: a hand knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.body.kinematics import difference, forward
from pzcap.body.segment_equations import PointResiduals
from pzcap.body.shape_basis import LENGTHS
from pzcap.body.shape_estimation import FrameResiduals, Shape, ShapeEquations, ShapeEstimate
from pzcap.body.skeleton import Body
from pzcap.tracking.keyframes import information
from pzcap.tracking.keypoint_residuals import LandmarkEstimate
from pzcap.tracking.observation import Views
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.settings import Terms, TrackingConfig
from pzcap.tracking.skin_appearance import mean_appearances
from pzcap.tracking.tuning import DRAPE, FRAME, SHAPE
from pzcap.types import DOF, SEGMENTS, Array, Keyframe, Pose


@dataclass(frozen=True, slots=True, eq=False)
class BodyEstimate:
    """The body as known so far, and what that has been accumulated from."""

    body: Body
    shape: ShapeEstimate
    known: Shape  # that results are given with
    landmarks: LandmarkEstimate
    by_hand: bool = False  # a keyframe among those so far was set by a hand

    @staticmethod
    def of(body: Body) -> BodyEstimate:
        """Estimate before any image: a tape has measured the body."""
        shape = ShapeEstimate.of(body)
        lengths = shape.basis.sigma_m[:LENGTHS]
        known = Shape(shape.amounts_m, np.full(len(SEGMENTS), 2 * float(np.mean(lengths**2))))
        return BodyEstimate(body, shape, known, LandmarkEstimate.of(body.landmarks))

    def with_keyframe(
        self, key: Keyframe, fitted: Pose, views: Views, rates: Array, config: TrackingConfig
    ) -> BodyEstimate:
        """The estimate after a keyframe, whose pose was ``fitted`` to the images; ``rates`` (16, 12) are those of the
        segments there."""
        shape, landmarks, frames = self.shape, self.landmarks, forward(self.body, fitted)
        by_hand = not key.found
        if config.shape_weight:
            objective = PoseObjective(self.body, views, rates)
            contour = _less_of_cloth(objective.contour(*objective.place(fitted), _terms(config)), self.body, config)
            # what a detector means by a joint is one error of all its keyframes: these say what any frame does
            prior = information(key) if by_hand else _weak(config)
            pull = prior @ difference(key.pose, fitted) if by_hand else np.zeros(DOF)
            shape = shape.commit(shape.accumulate([FrameResiduals(frames, contour, None, prior, pull)]))
        for view in views:
            if by_hand and view is not None and view.person is not None:
                landmarks = landmarks.accumulate(frames, view.camera, view.person)
        body = replace(self.body, landmarks=landmarks.solve())
        return replace(self, body=body, shape=shape, landmarks=landmarks, by_hand=self.by_hand or by_hand)

    def accumulate(
        self, poses: Sequence[Pose], objectives: Sequence[PoseObjective], config: TrackingConfig
    ) -> ShapeEquations:
        """Normal equations of the shape from some frames of an interval, tracked with the ``body``."""
        objectives = [replace(each, body=self.body) for each in objectives]
        frames = [objective.place(pose) for objective, pose in zip(objectives, poses, strict=True)]
        appearances = mean_appearances(self.body, [each.views for each in objectives], [where for _, where in frames])
        prior = _weak(config)
        residuals = []
        for objective, (posed, where) in zip(objectives, frames, strict=True):
            terms = replace(_terms(config), brightness_sigma=SHAPE.brightness_sigma)
            found = objective.texture(posed, where, appearances, terms)
            share = SHAPE.texture_weight
            texture = found._replace(hessians=share * found.hessians, gradients=share * found.gradients)
            texture.hessians[self.body.loose_m > 0.0] = 0.0  # cloth slides
            texture.gradients[self.body.loose_m > 0.0] = 0.0
            contour = _less_of_cloth(objective.contour(posed, where, terms), self.body, config)
            residuals.append(FrameResiduals(posed.frames, contour, texture, prior, np.zeros(DOF)))
        return self.shape.accumulate(residuals)

    def solve(self, equations: ShapeEquations) -> BodyEstimate:
        """The estimate with the body's shape solved for with further ``equations``."""
        shape = self.shape.solve(equations)
        body = replace(shape.body(shape.amounts_m), landmarks=self.body.landmarks)
        return replace(self, body=body, shape=shape)

    def commit(self, equations: ShapeEquations) -> BodyEstimate:
        """The estimate with the ``equations`` of an interval added for good."""
        shape = self.shape.commit(equations)
        doubt = 1.0 if self.by_hand else SHAPE.found_keyframes
        return replace(self, shape=shape, known=Shape(shape.amounts_m, doubt * shape.joint_variance()))


def _less_of_cloth(contour: PointResiduals, body: Body, config: TrackingConfig) -> PointResiduals:
    """The residuals with less weight where a loose piece is displaced by nobody knows how much in each frame."""
    if not body.loose_m.any():
        return contour
    px_per_m = np.linalg.norm(contour.rows[:, 2:5], axis=1)
    sigma_px = config.schedule[-1].terms.contour_sigma_px
    room_px = DRAPE.sigma * body.loose_m[contour.owner] * px_per_m
    rows = contour.rows.copy()
    rows[:, 0] /= 1.0 + (room_px / sigma_px) ** 2
    return contour._replace(rows=rows)


def _weak(config: TrackingConfig) -> Array:
    """Information (43, 43) on the pose of a frame whose images alone are to correct the body."""
    return config.shape_weight / FRAME.start_widening**2 * np.eye(DOF)


def _terms(config: TrackingConfig) -> Terms:
    """Residuals of the last round, whose contours count ``TrackingConfig.shape_weight`` of what they do for a pose."""
    terms = config.schedule[-1].terms
    return replace(terms, contour_weight=config.shape_weight * terms.contour_weight)
