"""Refinement of the cameras along with the pose: errors of each view's pan and focal length, marginalised.

A camera that is panned too far by ``p`` sees every point where it would stand if it had gone back by ``p`` about the
pan axis; one whose log focal length is too great by ``l``, as if all were nearer by ``l`` of its depth. So a camera's
error is a motion of the segments, a twist ``M_s (p, l)`` of each, and its normal equations follow from those of the
segments, ``H_s, g_s``. With the information ``L`` that the background gives,

    C = L + sum_s M_s' H_s M_s      c = sum_s M_s' g_s - L o      B = sum_s T_s' H_s M_s

where ``T_s`` takes a step of the pose to the segment's twist and ``o`` is what the camera has been corrected by so far,
the Schur complement leaves the pose alone: ``H - B C^-1 B'`` and ``g - B C^-1 c``. No motion is inferred from what the
camera's error may explain, and from a step ``d`` of the pose follows that of the camera, ``C^-1 (c - B' d)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from numba import njit

from pzcap.body.segment_equations import SegmentSums
from pzcap.body.skeleton import DOF_SEGMENT
from pzcap.calibration.settings import PanZoomConfig
from pzcap.localisation.covariance import systematic
from pzcap.tracking.tuning import VIEW
from pzcap.types import DOF, PARENTS, Array, Camera, Localisation, PanZoomCamera

CAMERA_DOF: Final = 2  # pan, and log focal length


@dataclass(frozen=True, slots=True, eq=False)
class CameraPrior:
    """Knowledge from the background of a view's pan and log focal length, and what the body has corrected them by."""

    pan_axis: Array  # (3,) unit vector of the world
    information: Array  # (2, 2) of (pan_rad, log focal), of the error of this frame alone
    correction: Array  # (2,) since then
    readout: float = 0.0  # of the view, frame periods


class MarginalisedCamera(NamedTuple):
    """A view's camera, eliminated from the normal equations of a pose."""

    covariance: Array  # (2, 2) C^-1, of pan and log focal if the pose were known
    pull: Array  # (2,) C^-1 c
    give: Array  # (2, 43) C^-1 B'

    def step(self, pose_step: Array) -> Array:
        """Step (2,) of pan and log focal that follows from a step (43,) of the pose."""
        return np.asarray(self.pull - self.give @ pose_step)

    def covariance_with(self, pose: Array) -> Array:
        """Covariance (2, 2) of pan and log focal, the ``pose``'s being (43, 43)."""
        return np.asarray(self.covariance + self.give @ pose @ self.give.T)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Correction of a view's pan and log focal, by body and background together."""

    step: Array  # (2,)
    covariance: Array  # (2, 2) of what comes out


def camera_prior(config: PanZoomConfig, head: PanZoomCamera, found: Localisation) -> CameraPrior:
    """Prior of the camera of a view that the background has ``found``.

    Errors that all frames share are left out: of one frame the body cannot tell them, and would make a wrong depth of
    them.
    """
    shared = systematic(config, head, np.array(found.pan_rad), np.array(found.focal_px))
    alone = found.covariance - shared + VIEW.least_camera_sigma**2 * np.eye(CAMERA_DOF)
    return CameraPrior(
        head.world_T_head[:3, 2], np.asarray(np.linalg.inv(alone), np.float64), np.zeros(CAMERA_DOF), found.readout
    )


def corrected(camera: Camera, prior: CameraPrior, step: Array) -> tuple[Camera, CameraPrior]:
    """The ``camera`` after a ``step`` (2,) of pan and log focal; its lens stays as it is."""
    world_T_cam = camera.world_T_cam.copy()
    world_T_cam[:3, :3] = cv2.Rodrigues(step[0] * prior.pan_axis)[0] @ world_T_cam[:3, :3]
    turned = replace(camera, world_T_cam=world_T_cam, focal_px=camera.focal_px * math.exp(step[1]))
    return turned, replace(prior, correction=prior.correction + step)


@njit(cache=True, nogil=True)
def segment_twists(world_T_cam: Array, pan_axis: Array, frames: Array, centre: Array) -> Array:
    """(16, 6, 2) Twists ``(v, w)`` about the ``centre`` that show the segments, posed as ``frames`` (16, 4, 4), where
    the camera would see them with one unit more of pan, and of log focal. All of a segment is as deep as its joint."""
    found, m = np.zeros((len(frames), 6, CAMERA_DOF)), world_T_cam
    x, y, z = centre[0] - m[0, 3], centre[1] - m[1, 3], centre[2] - m[2, 3]
    a, b, c = pan_axis[0], pan_axis[1], pan_axis[2]
    for s in range(len(frames)):
        found[s, 0, 0], found[s, 1, 0], found[s, 2, 0] = y * c - z * b, z * a - x * c, x * b - y * a
        depth = 0.0
        for i in range(3):
            found[s, 3 + i, 0] = -pan_axis[i]
            depth += (frames[s, i, 3] - m[i, 3]) * m[i, 2]
        for i in range(3):
            found[s, i, 1] = -depth * m[i, 2]
    return found


@njit(cache=True, nogil=True)
def eliminate(
    view: SegmentSums, moves: Array, information: Array, correction: Array, twists: Array, hessian: Array,
    gradient: Array,
) -> MarginalisedCamera:  # fmt: skip
    """Take the camera of one view out of the normal equations of a pose, ``hessian`` (43, 43) and ``gradient`` (43,),
    in place: the Schur complement at the head of this file. ``view`` is the part of these that the view has made of
    each segment; ``moves`` are the segments' twists by the camera (`segment_twists`) and ``twists`` (43, 6) those by
    the pose; ``information`` and ``correction`` are as `CameraPrior` has them."""
    joint, right = information.copy(), -information @ correction
    moved = np.zeros(moves.shape)  # H M, of a segment and all that hang on it
    for s in range(len(moves) - 1, -1, -1):  # parents come before their children
        for k in range(CAMERA_DOF):
            for i in range(6):  # sums, not products of small matrices: these take as long to be called
                own = 0.0
                for j in range(6):
                    own += view.hessians[s, i, j] * moves[s, j, k]
                moved[s, i, k] += own
                right[k] += moves[s, i, k] * view.gradients[s, i]
                for other in range(CAMERA_DOF):
                    joint[other, k] += moves[s, i, other] * own
        if PARENTS[s] >= 0:
            moved[PARENTS[s]] += moved[s]
    cross = np.zeros((DOF, CAMERA_DOF))  # B
    for d in range(DOF):
        for i in range(6):
            for k in range(CAMERA_DOF):
                cross[d, k] += twists[d, i] * moved[DOF_SEGMENT[d], i, k]
    covariance = np.empty_like(joint)
    covariance[:] = np.linalg.inv(joint)
    pull, give = covariance @ right, covariance @ cross.T
    for d in range(DOF):
        for k in range(CAMERA_DOF):
            gradient[d] -= cross[d, k] * pull[k]
            for e in range(DOF):
                hessian[d, e] -= cross[d, k] * give[k, e]
    return MarginalisedCamera(covariance, pull, give)
