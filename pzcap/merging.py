"""Two estimates of one instant, from the keyframe before it and from the one after it, made one: drift removed.

Where the two agree they are averaged limb by limb, weighted by confidence, which falls with the distance from the
keyframe (Yamamoto 2005). Where they do not, one of them has lost the limb, and the silhouettes decide which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap import raster
from pzcap.body import DOF, DOF_SEGMENT, Body, difference, forward, place, retract
from pzcap.types import SEGMENTS, Array, Camera, Image, Mask, Pose

LIMBS: Final[tuple[tuple[int, ...], ...]] = ((0, 1, 2, 3), (4, 5, 6), (7, 8, 9), (10, 11, 12), (13, 14, 15))
"""Segments of the trunk with the head, the arms and the legs."""
AGREE_M: Final = 0.05
_SCALE: Final = 2


@dataclass(slots=True, eq=False)
class Cut:
    """A view cut out around the body: what is kept of it until both directions have used it."""

    camera: Camera
    left: int
    top: int
    image: Image  # (h, w, 3)
    background: Image  # (h, w, 3)
    probability: Image  # (h, w)
    colours: NDArray[np.int8]  # (h, w) of `pzcap.foreground.evidence`


def mismatch(body: Body, pose: Pose, cuts: Sequence[Cut | None]) -> float:
    """Area (m2 at the body's distance, mean over the views) where body and silhouette differ: body that stands on no
    silhouette, and silhouette that no body explains."""
    points, _ = place(body, forward(body, pose))
    pixels, depth = np.empty((len(points), 2)), np.empty(len(points))
    areas = []
    for cut in cuts:
        if cut is None:
            continue
        camera = cut.camera
        raster.project(points, camera.world_T_cam, camera.focal_px, camera.principal_px, camera.k1, pixels, depth)
        silhouette = cut.probability[::_SCALE, ::_SCALE]
        z_buffer = np.empty(silhouette.shape, np.float32)
        raster.rasterise(pixels, depth, body.surface.faces, cut.left, cut.top, float(_SCALE), z_buffer)
        differs = np.abs(np.isfinite(z_buffer) - silhouette.astype(np.float32) / 255.0).sum()
        distance = max(float(depth[0]), 0.5)
        areas.append(float(differs) * (_SCALE * distance / camera.focal_px) ** 2)
    return float(np.mean(areas)) if areas else 0.0


def merge(
    body: Body, ahead: Pose, back: Pose, variance_ahead: Array, variance_back: Array, cuts: Sequence[Cut | None]
) -> tuple[Pose, Mask]:
    """One pose from the forward and the backward pass's, whose ``variance`` (16,) is relative.

    Returns also, per segment (16,), whether the two agreed.
    """
    joints_ahead, joints_back = forward(body, ahead)[:, :3, 3], forward(body, back)[:, :3, 3]
    apart = np.linalg.norm(joints_ahead - joints_back, axis=1)
    agree = np.ones(len(SEGMENTS), bool)
    for limb in LIMBS:
        agree[list(limb)] = apart[list(limb)].max() < AGREE_M
    share = variance_ahead / (variance_ahead + variance_back)  # of the backward pass
    if not agree.all():
        share = np.where(agree, share, _choose(body, ahead, back, agree, share, cuts))
    return _mix(ahead, back, share), agree


def _mix(ahead: Pose, back: Pose, share: Array) -> Pose:
    """Each segment's rotation (and the root's position) turned by its ``share`` (16,) from ``ahead`` to ``back``."""
    delta = difference(back, ahead)
    assert len(delta) == DOF
    return retract(ahead, share[DOF_SEGMENT] * delta)


def _choose(body: Body, ahead: Pose, back: Pose, agree: Mask, share: Array, cuts: Sequence[Cut | None]) -> Array:
    """For the limbs on which the passes disagree, 0 (forward) or 1 (backward) as the silhouettes have it (16,)."""
    choices = [np.where(agree, share, 0.0), np.where(agree, share, 1.0)]
    scores = [mismatch(body, _mix(ahead, back, choice), cuts) for choice in choices]
    best = int(np.argmin(scores))
    choice, score = choices[best], scores[best]
    for limb in LIMBS:
        members = list(limb)
        if agree[members].all():
            continue
        other = choice.copy()
        other[members] = 1.0 - choice[members]
        attempt = mismatch(body, _mix(ahead, back, other), cuts)
        if attempt < score:
            choice, score = other, attempt
    return choice


def best_of(body: Body, poses: Sequence[Pose], cuts: Sequence[Cut | None]) -> tuple[Pose, float]:
    """The pose that the silhouettes prefer, each limb taken from whichever candidate it fits best, and its mismatch."""
    pose, score = poses[0], mismatch(body, poses[0], cuts)
    for other in poses[1:]:
        attempt = mismatch(body, other, cuts)
        first, second = (pose, other) if score <= attempt else (other, pose)
        disagree = np.zeros(len(SEGMENTS), bool)
        share = _choose(body, first, second, disagree, np.zeros(len(SEGMENTS)), cuts)
        pose = _mix(first, second, share)
        score = mismatch(body, pose, cuts)
    return pose, score
