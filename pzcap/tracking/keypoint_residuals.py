"""Residuals of a detector's keypoints in a view, and the estimate of where on the body these lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from pzcap.body.kinematics import world_points
from pzcap.body.landmarks import SEGMENT, Landmarks
from pzcap.body.segment_equations import PointResiduals
from pzcap.geometry.pinhole import Pinhole, pinhole, pixel_gradient, projected, ray
from pzcap.solver.robust import geman_mcclure
from pzcap.tracking.tuning import KEYPOINT
from pzcap.types import Array, Camera


def in_world(landmarks: Landmarks, world_T_segment: Array) -> Array:
    """The keypoints (26, 3), the segments being at ``world_T_segment`` (16, 4, 4)."""
    return world_points(world_T_segment, SEGMENT, landmarks.points_m)


def _noise_m(person: Array) -> Array:
    """Error (26,) of the detector in finding each keypoint."""
    return np.asarray(KEYPOINT.detector_m / np.maximum(person[:, 2], KEYPOINT.least_confidence))


def with_error(confidence: Array, error_m: float) -> Array:
    """The ``confidence`` (26,) in keypoints that are off by a further error, of this standard deviation."""
    return np.asarray(confidence / np.hypot(1.0, confidence * error_m / KEYPOINT.detector_m))


def _confidence(depth: Array, person: Array) -> Array:
    """The confidence (26,) in each keypoint of a ``person`` (26, 3); 0 where there is none."""
    return np.where((person[:, 2] >= KEYPOINT.least_confidence) & (depth > 0.0), person[:, 2], 0.0)


def nearest(world_m: Array, camera: Camera, people: Array) -> Array | None:
    """The one of the ``people`` (P, 26, 3) nearest to where the keypoints should be; None if nobody is near."""
    pixels, depth = projected(world_m, camera)
    far_px = KEYPOINT.near_m * camera.focal_px / np.maximum(depth, 0.1)
    best, found = KEYPOINT.largest_share, None
    for person in people:
        confidence = _confidence(depth, person)
        apart = np.minimum(np.linalg.norm(person[:, :2] - pixels, axis=1) / far_px, 1.0)
        distance = float(confidence @ apart) / max(float(confidence.sum()), 1e-9) if confidence.any() else 1.0
        if distance < best:
            best, found = distance, person
    return found


@njit(cache=True, nogil=True)
def _residuals(
    world: Array, camera: Pinhole, pixels: Array, person: Array, confidence: Array, sigma: Array, scale: float,
    found: PointResiduals,
) -> int:  # fmt: skip
    """Fill in ``found``, two rows a keypoint that has been found, and return how many."""
    rows, keypoint = found
    count = 0
    for k in range(len(world)):
        if confidence[k] <= 0.0:
            continue
        squared = (person[k, 0] - pixels[k, 0]) ** 2 + (person[k, 1] - pixels[k, 1]) ** 2
        robust = geman_mcclure(np.sqrt(squared), scale * sigma[k])
        across, down, depth = ray(world[k, 0], world[k, 1], world[k, 2], camera)
        for axis in range(2):
            keypoint[count] = k
            rows[count, 0] = robust / sigma[k] ** 2
            rows[count, 1] = person[k, axis] - pixels[k, axis]
            rows[count, 2:5] = pixel_gradient(across, down, depth, camera, 1.0 - axis, float(axis))
            rows[count, 5:] = world[k]
            count += 1
    return count


def residuals(
    landmarks: Landmarks, world_T_segment: Array, camera: Camera, person: Array, scale: float
) -> PointResiduals:
    """Residuals of a ``person`` (26, 3) in one view, each owned by a keypoint.

    The residual is the vector in pixels from where a keypoint should be to where the detector saw it, a row for each of
    its two components; both are weighted by Geman-McClure of so many sigmas (``scale``).
    """
    world = in_world(landmarks, world_T_segment)
    pixels, depth = projected(world, camera)
    sigma = np.hypot(landmarks.sigma_m, _noise_m(person)) * camera.focal_px / np.maximum(depth, 0.1)
    found = PointResiduals.empty(2 * len(world))
    confidence = _confidence(depth, person)
    count = _residuals(world, pinhole(camera), pixels, person, confidence, sigma, scale, found)
    return found.first(count)


def agreement(landmarks: Landmarks, segments: Sequence[int], posed: Array, camera: Camera, person: Array) -> Array:
    """Number (K,) of the keypoints of a ``person`` (26, 3) that agree with a limb's postures, its ``segments`` being at
    ``posed`` (K, S, 4, 4). One counts half at a distance of `KeypointTuning.half_agrees` sigmas; those at the joint
    that the limb turns in say nothing of its posture, and do not count."""
    rows = np.flatnonzero(np.isin(SEGMENT, segments[1:]) & (person[:, 2] >= KEYPOINT.least_confidence))
    frames = posed[:, SEGMENT[rows] - segments[0]]
    world = np.einsum("knij,nj->kni", frames[..., :3, :3], landmarks.points_m[rows]) + frames[..., :3, 3]
    pixels, depth = projected(world.reshape(-1, 3), camera)
    apart_px = np.linalg.norm(pixels.reshape(len(posed), len(rows), 2) - person[rows, :2], axis=2)
    apart_m = apart_px * np.maximum(depth.reshape(apart_px.shape), 0.1) / camera.focal_px
    scale_m = KEYPOINT.half_agrees * np.hypot(landmarks.sigma_m, _noise_m(person))[rows]
    return np.asarray(np.sum(1.0 / (1.0 + (apart_m / scale_m) ** 2), axis=1))


def noise_share(landmarks: Landmarks, person: Array) -> Array:
    """Factor (26,) from the weight of a residual to that which it has where a keypoint's place on the body is known."""
    noise = _noise_m(person)
    return np.asarray((np.hypot(landmarks.sigma_m, noise) / noise) ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkEstimate:
    """Estimate of where on one body a detector's keypoints lie.

    A detector that sees a hip above the joint makes the trunk short, and a short trunk is a bent one. So what it means
    is estimated from poses that a hand has fixed; those that its own keypoints had a part in would bear it out.
    """

    prior: Landmarks
    information: Array  # (26, 3, 3) of the offset of each keypoint from the prior, in the frame of its segment
    vector: Array  # (26, 3)

    @staticmethod
    def of(prior: Landmarks) -> LandmarkEstimate:
        """Estimate before any view."""
        return LandmarkEstimate(prior, np.eye(3) / prior.sigma_m[:, None, None] ** 2, np.zeros(prior.points_m.shape))

    def accumulate(self, world_T_segment: Array, camera: Camera, person: Array) -> LandmarkEstimate:
        """The estimate after one more view (26, 3) of a body that is known to be at ``world_T_segment``."""
        rows, keypoint = residuals(self.prior, world_T_segment, camera, person, 3.0)
        # the rows admit that a keypoint lies elsewhere, which is what is asked for here
        own = rows[:, 0] * noise_share(self.prior, person)[keypoint]
        local = np.einsum("ni,nij->nj", rows[:, 2:5], world_T_segment[SEGMENT[keypoint], :3, :3])
        information, vector = self.information.copy(), self.vector.copy()
        np.add.at(information, keypoint, own[:, None, None] * local[:, :, None] * local[:, None, :])
        np.add.at(vector, keypoint, (own * rows[:, 1])[:, None] * local)
        return replace(self, information=information, vector=vector)

    def solve(self) -> Landmarks:
        """The landmarks as all views so far have them."""
        offset = np.linalg.solve(self.information, self.vector[..., None])[..., 0]
        variance = np.trace(np.linalg.inv(self.information), axis1=1, axis2=2) / 3.0
        sigma = np.minimum(np.hypot(np.sqrt(variance), KEYPOINT.posture_m), self.prior.sigma_m)
        return Landmarks(self.prior.points_m + offset, sigma)
