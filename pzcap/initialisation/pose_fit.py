"""The articulated body fitted to a detector's keypoints, all frames together.

Gauss-Newton on the reprojection of the keypoints in every view, robust, with the limits of the joints, a weak prior for
what keypoints leave open (the bends of the spine, the head, hands and feet) and one on the acceleration
(`pzcap.tracking.temporal_constraints`), which carries what is open, or lost, over from other frames.

What a detector means by a joint is off by so much in all frames alike (`pzcap.body.landmarks`). With poses ``p_t`` and
these offsets ``b`` the normal equations are an arrow,

    H_t = sum J_p' W J_p + prior      C_t = sum J_p' W J_b      D_t = sum J_b' W J_b

and the covariance of a pose is ``H_t^-1 + H_t^-1 C_t B C_t' H_t^-1`` with ``B`` that of the offsets. The second term is
one and the same error in all frames: it makes each pose uncertain, and many poses no surer than one. Bones of known
length, in many postures, show a part of it (`learned_landmarks`); the fit is repeated with what they have shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from pzcap.body.kinematics import forward, joint_angles, joint_jacobians, point_jacobians, retract, screws
from pzcap.body.landmarks import SEGMENT, Landmarks
from pzcap.body.segment_equations import PointResiduals, SegmentSums, accumulate, lift
from pzcap.body.skeleton import DOF_SEGMENT, Body
from pzcap.initialisation.people import Sighting
from pzcap.initialisation.tuning import FIT
from pzcap.tracking import keypoint_residuals
from pzcap.tracking.body_constraints import constraints
from pzcap.tracking.temporal_constraints import smooth_step
from pzcap.tracking.tuning import ACCELERATION_SIGMA, KEYPOINT
from pzcap.types import DOF, SEGMENTS, Array, Pose, without_side

_REST_DEG: Final = {"head": FIT.head_deg, "hand": FIT.hand_deg, "foot": FIT.foot_deg}


def _rest() -> Array:
    """(43,) Information with which head, hands and feet are expected at rest."""
    kinds = [without_side(name) for name in SEGMENTS]
    found = np.array([np.deg2rad(_REST_DEG[kind]) ** -2.0 if kind in _REST_DEG else 0.0 for kind in kinds])[DOF_SEGMENT]
    return np.asarray(found)


REST: Final[Array] = _rest()


@dataclass(frozen=True, slots=True, eq=False)
class FittedPose:
    """A pose fitted to keypoints."""

    pose: Pose
    covariance: Array  # (43, 43) of its tangent
    sigma_m: Array  # (16,) of the joints that follows
    misfit: float  # RMS of the robust residuals, in sigmas
    views: int  # that have the athlete


def fit(body: Body, sightings: Sequence[Sighting], start: Sequence[Pose]) -> list[Pose]:
    """Fit the poses of successive frames, from a ``start`` for each, from loose to tight robust weights.

    A long take is fitted a stretch after the other, each held to the poses before it, and on into the next one for some
    frames that are fitted again there: memory does not grow with the take.
    """
    poses: list[Pose] = []
    for first in range(0, len(start), FIT.stretch):
        part = slice(first, first + FIT.stretch + FIT.beyond)
        found = _fit_stretch(body, sightings[part], start[part], poses[-2:])
        poses += found[: FIT.stretch]
    return poses


def _fit_stretch(
    body: Body, sightings: Sequence[Sighting], start: Sequence[Pose], before: Sequence[Pose]
) -> list[Pose]:
    """Fit the poses of a stretch, the body being held fast in the frames ``before`` it."""
    poses = list(start)
    for scale in FIT.scales:
        for _ in range(FIT.iterations):
            normal = [_normal(body, pose, seen, scale) for pose, seen in zip(poses, sightings, strict=True)]
            hessians, gradients = zip(*normal, strict=True)
            steps = smooth_step(poses, hessians, gradients, FIT.acceleration * ACCELERATION_SIGMA, before, ())
            steps = steps.clip(-FIT.longest_step, FIT.longest_step)
            poses = [retract(pose, step) for pose, step in zip(poses, steps, strict=True)]
            if np.abs(steps).max(initial=0.0) < FIT.tolerance:
                break
    return poses


def _residuals(body: Body, frames: Array, seen: Sighting, scale: float) -> list[PointResiduals]:
    """Residuals of the keypoints in each view of an instant, the segments being at ``frames`` (16, 4, 4)."""
    return [keypoint_residuals.residuals(body.landmarks, frames, *view, scale) for view in seen if view is not None]


def _normal(body: Body, pose: Pose, seen: Sighting, scale: float) -> tuple[Array, Array]:
    """Normal equations (43, 43) and (43,) of one pose by itself."""
    frames = forward(body, pose)
    centre = np.ascontiguousarray(frames[0, :3, 3])
    sums = SegmentSums.zero(centre)
    for rows, keypoint in _residuals(body, frames, seen, scale):
        accumulate(rows, SEGMENT[keypoint], sums)
    hessian, gradient = lift(sums, screws(frames, centre))
    stiffness, pull = _prior(body, pose, FIT.damping)
    return hessian + stiffness, gradient + pull


def _prior(body: Body, pose: Pose, open_to: float) -> tuple[Array, Array]:
    """Normal equations (43, 43) and (43,) of the body's constraints and of joints at rest, with the information
    ``open_to`` on every degree of freedom."""
    stiffness, pull = constraints(body, pose, FIT.limit_rad, self_collision=False, spine_sigma_rad=FIT.spine_rad)
    return stiffness + np.diag(REST + open_to), pull - REST * joint_angles(pose)


class _Arrow(NamedTuple):
    """Normal equations of a pose and of what the detector means, from one instant's keypoints."""

    pose: Array  # (43, 43) H, the priors included
    cross: Array  # (43, K, 3) C
    offsets: Array  # (K, 3, 3) D: keypoints have nothing to do with each other
    pose_gradient: Array  # (43,)
    offset_gradient: Array  # (K, 3)
    misfit: float  # RMS of the robust residuals, in sigmas


def _arrow(body: Body, pose: Pose, seen: Sighting) -> _Arrow:
    """Linearise the keypoints of an instant about a fitted ``pose``, as if it was known what the detector means."""
    frames, count = forward(body, pose), len(SEGMENT)
    hessian, gradient = _prior(body, pose, FIT.open)
    cross, corner, beside = np.zeros((count, 3, DOF)), np.zeros((count, 3, 3)), np.zeros((count, 3))
    squares, rows_in_all = 0.0, 0
    views = [view for view in seen if view is not None]
    for (_, person), (rows, keypoint) in zip(views, _residuals(body, frames, seen, FIT.scales[-1]), strict=True):
        own = keypoint_residuals.noise_share(body.landmarks, person)[keypoint] * rows[:, 0]
        by_pose = np.einsum("ni,nid->nd", rows[:, 2:5], point_jacobians(frames, SEGMENT[keypoint], rows[:, 5:]))
        local = np.einsum("ni,nij->nj", rows[:, 2:5], frames[SEGMENT[keypoint], :3, :3])
        hessian = hessian + (by_pose.T * own) @ by_pose
        gradient = gradient + (by_pose.T * own) @ rows[:, 1]
        weighted = own[:, None] * local
        np.add.at(cross, keypoint, weighted[:, :, None] * by_pose[:, None])
        np.add.at(corner, keypoint, weighted[:, :, None] * local[:, None])
        np.add.at(beside, keypoint, weighted * rows[:, 1:2])
        squares, rows_in_all = squares + float(rows[:, 0] @ rows[:, 1] ** 2), rows_in_all + len(rows)
    misfit = float(np.sqrt(squares / max(rows_in_all, 1)))
    return _Arrow(hessian, cross.transpose(2, 0, 1), corner, gradient, beside, misfit)


def learned_landmarks(usual: Landmarks, body: Body, poses: Sequence[Pose], sightings: Sequence[Sighting]) -> Landmarks:
    """Landmarks as this detector means them on this body, from poses fitted with those of the ``body``; ``usual`` are
    those of any detector. The poses are eliminated:

        (B^-1 + sum D_t - C_t' H_t^-1 C_t) b = sum d_t - C_t' H_t^-1 g_t

    so that an offset which a change of all poses would explain as well stays as open as it was.
    """
    count = len(SEGMENT)
    prior = np.repeat(usual.sigma_m**-2.0, 3)
    information, vector = np.diag(prior), -prior * (body.landmarks.points_m - usual.points_m).ravel()
    for pose, seen in list(zip(poses, sightings, strict=True))[:: FIT.stride]:
        arrow = _arrow(body, pose, seen)
        cross = arrow.cross.reshape(DOF, -1)
        eliminated = np.linalg.solve(arrow.pose, np.column_stack([cross, arrow.pose_gradient]))
        own = -cross.T @ eliminated[:, :-1]
        for k in range(count):
            own[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += arrow.offsets[k]
        information += own / FIT.doubt
        vector += (arrow.offset_gradient.ravel() - cross.T @ eliminated[:, -1]) / FIT.doubt
    step = np.linalg.solve(information, vector).reshape(count, 3)
    variance = np.diag(np.linalg.inv(information)).reshape(count, 3).mean(axis=1)
    sigma = np.minimum(np.hypot(np.sqrt(variance), KEYPOINT.posture_m), usual.sigma_m)
    return Landmarks(body.landmarks.points_m + step, sigma)


def known(body: Body, pose: Pose, seen: Sighting) -> FittedPose:
    """A fitted pose with its covariance, what the detector means by each keypoint being known as `Landmarks` has it."""
    arrow = _arrow(body, pose, seen)
    alone = np.linalg.inv(arrow.pose)
    shared = alone @ arrow.cross.reshape(DOF, -1)
    covariance = alone + (shared * np.repeat(body.landmarks.sigma_m**2, 3)) @ shared.T
    jacobians = joint_jacobians(forward(body, pose))
    variance = np.einsum("jad,de,jae->j", jacobians, covariance, jacobians)
    return FittedPose(pose, covariance, np.sqrt(variance), arrow.misfit, sum(view is not None for view in seen))
