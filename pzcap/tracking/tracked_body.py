"""The body at an instant, as it goes into the results: how sure its joints are, and how surely it is there at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pzcap.body.kinematics import forward, joint_jacobians
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.camera_refinement import Correction, MarginalisedCamera
from pzcap.tracking.frame_tracker import NO_CONTOUR, PoseEstimate, probably_lost
from pzcap.tracking.interval import Tracked
from pzcap.tracking.limbs import mismatch
from pzcap.tracking.observation import ViewCrop
from pzcap.tracking.pose_objective import PoseObjective, misfit_px2
from pzcap.tracking.tuning import INTERVAL, PREDICTION_SIGMA
from pzcap.types import PARENTS, Array, Keyframe, Pose


def tracked(
    estimate: BodyEstimate, frame: int, found: PoseEstimate, doubt_m: Array | float = 0.0,
    cameras: Sequence[tuple[ViewCrop | None, MarginalisedCamera | None]] = (), lost: float = 0.0,
) -> Tracked:  # fmt: skip
    """The body at an instant. ``doubt_m`` (16,) is the deviation of a joint that may be in several places: those of two
    estimates that do not agree, or of postures that score nearly as much.
    ``cameras``, where they were corrected, is each view with the camera as it is now, and the marginalised one;
    ``lost`` the probability that the whole body is elsewhere."""
    frames = forward(estimate.body, found.pose)
    information = found.hessian + np.diag(1.0 / PREDICTION_SIGMA**2)
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    jacobians = joint_jacobians(frames)
    variance = np.einsum("jad,de,jae->j", jacobians, covariance, jacobians)
    unsure = misplaced(found.contour) + lost
    variance += estimate.known.joint_variance_m2 + np.asarray(doubt_m) ** 2 + unsure * INTERVAL.misplaced_m**2
    corrections = tuple(
        None if view is None or view.camera_prior is None or camera is None
        else Correction(view.camera_prior.correction, camera.covariance_with(covariance))
        for view, camera in cameras
    )  # fmt: skip
    sigma = np.sqrt(variance)
    return Tracked(frame, found.pose, frames[:, :3, 3], sigma, found.seen, estimate.known, corrections, lost)


def trusted(key: Keyframe, found: PoseEstimate) -> PoseEstimate:
    """The pose ``found`` of a keyframe. A hand knows where the limbs are: what the images do not bear out is a
    contradiction (`pzcap.extras.keyframe_diagnostics`), and adds nothing to the sigmas. A detector may be wrong."""
    return replace(found, contour=NO_CONTOUR, seen=True) if not key.found else found


def misplaced(contour: Array) -> Array:
    """Probability (16,) that a joint is not where it was found, from how well the contours of the two segments that
    meet there fit the silhouettes: ``contour`` (16, 3) as `pzcap.tracking.pose_objective.PoseEquations` has it. How
    it was fitted stands in docs/method.md."""
    misfit_px = np.sqrt(misfit_px2(contour + contour[np.maximum(PARENTS, 0)], 1.0))
    return np.asarray(1.0 / (1.0 + np.exp(INTERVAL.misplaced_px - misfit_px) ** INTERVAL.misplaced_slope))


def lost(objective: PoseObjective, pose: Pose) -> float:
    """Probability that the body as a whole is not at ``pose``."""
    return probably_lost(mismatch(objective.views, objective.place(pose)[1]))
