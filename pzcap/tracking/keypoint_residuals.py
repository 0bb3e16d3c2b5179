"""Keypoint residuals: what the places of a detector's keypoints in a view say about the pose."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.body.landmarks import SEGMENT, Landmarks
from pzcap.tracking import visibility
from pzcap.types import Array, Camera

_DETECTOR_M: Final = 0.015
"""How well a detector that is quite sure finds what it means. On the body, not in the image: whatever the size of a
person, the detector looks at a picture of one size."""
_POSTURE_M: Final = 0.010
"""By how much what a detector means changes with the posture, and with where it looks from."""
_LEAST_CONFIDENCE: Final = 0.05
_NEAR_M: Final = 0.5
"""Keypoints further off than this are somebody else's."""
_LARGEST_SHARE: Final = 0.7
"""Of that, on average over a body, that it may be off and still be the athlete's: some limbs may be lost."""


def in_world(marks: Landmarks, world_T_segment: Array) -> Array:
    """The keypoints (26, 3), the segments being at ``world_T_segment`` (16, 4, 4)."""
    frames = world_T_segment[SEGMENT]
    return np.asarray(np.einsum("kij,kj->ki", frames[:, :3, :3], marks.points_m) + frames[:, :3, 3])


def _seen(world_m: Array, camera: Camera) -> tuple[Array, Array]:
    """Pixels (26, 2) and depth (26,) of keypoints in the world (26, 3)."""
    pixels, depth = np.empty((len(world_m), 2)), np.empty(len(world_m))
    visibility.project(world_m, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, pixels, depth)
    return pixels, depth


def _noise_m(person: Array) -> Array:
    """How well the detector found what it means (26,)."""
    return np.asarray(_DETECTOR_M / np.maximum(person[:, 2], _LEAST_CONFIDENCE))


def _known(depth: Array, person: Array) -> Array:
    """The confidence (26,) in each keypoint of a ``person`` (26, 3); 0 where there is none."""
    return np.where((person[:, 2] >= _LEAST_CONFIDENCE) & (depth > 0.0), person[:, 2], 0.0)


def nearest(world_m: Array, camera: Camera, people: Array) -> Array | None:
    """Who of the ``people`` (P, 26, 3) is nearest to where the keypoints should be; None if nobody is near."""
    pixels, depth = _seen(world_m, camera)
    far_px = _NEAR_M * camera.focal_px / np.maximum(depth, 0.1)
    best, who = _LARGEST_SHARE, None
    for person in people:
        confidence = _known(depth, person)
        apart = np.minimum(np.linalg.norm(person[:, :2] - pixels, axis=1) / far_px, 1.0)
        distance = float(confidence @ apart) / max(float(confidence.sum()), 1e-9) if confidence.any() else 1.0
        if distance < best:
            best, who = distance, person
    return who


@njit(cache=True, nogil=True)
def _rows(
    world: Array, world_T_cam: Array, focal: float, k1: float, pixels: Array, person: Array, known: Array,
    sigma: Array, scale: float, rows: Array, keypoint: NDArray[np.int64],
) -> int:  # fmt: skip
    count = 0
    stand = visibility.stand(world_T_cam)
    for k in range(len(world)):
        if known[k] <= 0.0:
            continue
        squared = (person[k, 0] - pixels[k, 0]) ** 2 + (person[k, 1] - pixels[k, 1]) ** 2
        robust = 1.0 / (1.0 + squared / (scale * sigma[k]) ** 2)
        across, down, depth = visibility.ray(world[k, 0], world[k, 1], world[k, 2], stand)
        for axis in range(2):
            keypoint[count] = k
            rows[count, 0] = robust * robust / sigma[k] ** 2
            rows[count, 1] = person[k, axis] - pixels[k, axis]
            rows[count, 2:5] = visibility.pixel_gradient(across, down, depth, stand, focal, k1, 1.0 - axis, float(axis))
            rows[count, 5:] = world[k]
            count += 1
    return count


def residuals(
    marks: Landmarks, world_T_segment: Array, camera: Camera, person: Array, scale: float
) -> tuple[Array, NDArray[np.int64]]:
    """What a ``person`` (26, 3) says in one view: rows (N, 8) for `pzcap.tracking.residuals.accumulate`, and the
    keypoint of each (N,).

    The residual is the way in pixels from where a keypoint should be to where the detector saw it, a row for each of
    its two parts; both are weighted by Geman-McClure of so many sigmas (``scale``).
    """
    world = in_world(marks, world_T_segment)
    pixels, depth = _seen(world, camera)
    sigma = np.hypot(marks.sigma_m, _noise_m(person)) * camera.focal_px / np.maximum(depth, 0.1)
    rows, keypoint = np.empty((2 * len(world), 8)), np.empty(2 * len(world), np.int64)
    count = _rows(
        world, camera.world_T_cam, camera.focal_px, camera.k1, pixels, person, _known(depth, person), sigma, scale,
        rows, keypoint,
    )  # fmt: skip
    return rows[:count], keypoint[:count]


class LandmarkEstimate:
    """Gathers what one detector means by its keypoints, on one body.

    A detector that sees a hip above the joint makes the trunk short, and a short trunk is a bent one. So what it means
    is found out from poses that a hand has fixed; those that its own keypoints had a part in would bear it out.
    """

    def __init__(self, marks: Landmarks) -> None:
        self._usual = marks
        self._information = np.eye(3) / marks.sigma_m[:, None, None] ** 2
        self._vector = np.zeros(marks.points_m.shape)

    def add(self, world_T_segment: Array, camera: Camera, person: Array) -> None:
        """A view (26, 3) of a body that is known to be at ``world_T_segment``."""
        rows, keypoint = residuals(self._usual, world_T_segment, camera, person, 3.0)
        noise = _noise_m(person)
        # the rows admit that a keypoint lies elsewhere, which is what is asked for here
        own = rows[:, 0] * (np.hypot(self._usual.sigma_m, noise) / noise)[keypoint] ** 2
        local = np.einsum("ni,nij->nj", rows[:, 2:5], world_T_segment[SEGMENT[keypoint], :3, :3])
        np.add.at(self._information, keypoint, own[:, None, None] * local[:, :, None] * local[:, None, :])
        np.add.at(self._vector, keypoint, (own * rows[:, 1])[:, None] * local)

    def solve(self) -> Landmarks:
        """The landmarks as all views so far have them."""
        moved = np.linalg.solve(self._information, self._vector[..., None])[..., 0]
        variance = np.trace(np.linalg.inv(self._information), axis1=1, axis2=2) / 3.0
        sigma = np.minimum(np.hypot(np.sqrt(variance), _POSTURE_M), self._usual.sigma_m)
        return Landmarks(self._usual.points_m + moved, sigma)
