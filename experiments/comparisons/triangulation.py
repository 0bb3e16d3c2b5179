"""The body from a detector's keypoints alone, as one would do it without this library's tracker.

Each keypoint of each frame for itself: its rays, one a view, meet in a point; views that do not agree are left out.
Then each keypoint's way is filtered. It is what Pose2Sim and anipose do, here with cameras that pan and zoom.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np
from scipy.signal import butter, sosfiltfilt

from pzcap.body.anthropometry import measured
from pzcap.geometry import camera as geometry
from pzcap.initialisation import triangulation
from pzcap.io.capture import frame_sets
from pzcap.io.detections import KEYPOINTS
from pzcap.types import (
    JOINTS,
    LUMBAR_FRACTION,
    THORAX_FRACTION,
    Array,
    Camera,
    Capture,
    Motion,
    PzcapError,
    Reconstruction,
    Subject,
)

LEAST_CONFIDENCE: Final = 0.2
AGREE_M: Final = 0.15
"""A ray that passes by further off is of something else."""
CUTOFF_HZ: Final = 6.0
"""Of the Butterworth filter of order four, forward and backward; Pose2Sim's default."""
_TRIPOD: Final = {f"{side}_{name}" for side in ("left", "right") for name in ("shoulder", "hip")}


def triangulate(capture: Capture, reconstruction: Reconstruction) -> Motion:
    """`triangulated`, by the cameras that were found."""
    return triangulated(capture, partial(cameras_at, reconstruction))


def triangulated(capture: Capture, cameras: Callable[[int], Sequence[Camera | None]]) -> Motion:
    """The joints, from the capture's keypoints and the ``cameras`` of each frame; its rotations are none.

    Raises PzcapError where the capture has no keypoints, or a joint is never seen by two cameras.
    """
    sets = frame_sets(capture)
    if not sets.people(0):
        raise PzcapError(f"{capture.folder}: no camera has keypoints; name them in capture.json (docs/capture.md)")
    if capture.subject is None:
        raise PzcapError(f"{capture.folder}: there is no subject.json; write it (docs/capture.md)")
    points, off = np.empty((len(sets), len(KEYPOINTS), 3)), np.empty((len(sets), len(KEYPOINTS)))
    for frame in range(len(sets)):
        views = [
            (camera, max(people, key=lambda person: person[:, 2].sum()))
            for camera, people in zip(cameras(frame), sets.people(frame), strict=True)
            if camera is not None and len(people)
        ]
        points[frame], off[frame] = meet(views)
    at = {name: KEYPOINTS.index(name) for name in (*_TRIPOD, *(set(JOINTS) & set(KEYPOINTS)))}
    found = {name: smooth(points[:, k], off[:, k], float(capture.frame_rate), name) for name, k in at.items()}
    joints = all_joints(found, capture.subject)
    identity = np.zeros((*joints.shape[:2], 4))
    identity[..., 0] = 1.0
    sigma = np.full(joints.shape[:2], np.sqrt(np.mean(off[np.isfinite(off)] ** 2)))
    keyframes = np.array([key.frame for key in sets.keyframes], np.int64)  # not used, and not scored, as with others
    return Motion(joints[:, JOINTS.index("pelvis")], identity, joints, sigma, keyframes, np.ones(len(sets), bool))


def all_joints(found: Mapping[str, Array], subject: Subject) -> Array:
    """All joints (F, 16, 3), from the places (F, 3) of those of the limbs.

    The trunk's, which no detector finds, are put where they are in somebody who stands upright.
    """
    hips, shoulders = ((found[f"left_{name}"] + found[f"right_{name}"]) / 2 for name in ("hip", "shoulder"))
    up = shoulders - hips
    neck = shoulders + up / np.linalg.norm(up, axis=1, keepdims=True) * measured(subject).value("shoulder_drop")
    trunk = {"pelvis": hips, "neck": neck, "lumbar": hips + LUMBAR_FRACTION * (neck - hips)}
    trunk["thorax"] = hips + THORAX_FRACTION * (neck - hips)
    return np.stack([{**found, **trunk}[name] for name in JOINTS], axis=1)


def cameras_at(reconstruction: Reconstruction, frame: int) -> list[Camera | None]:
    """The cameras of one instant; None where one is lost."""
    return [
        None if camera is None or track is None or not track.valid[frame] else geometry.of_track(camera, track, frame)
        for camera, track in zip(reconstruction.cameras, reconstruction.tracks, strict=True)
    ]


def meet(views: list[tuple[Camera, Array]]) -> tuple[Array, Array]:
    """Triangulate the keypoints of one person, (K, 3) a view: places (K, 3) in the world, and by how much (K,) their
    rays miss these on average, metres; infinity where no two views agree."""
    if len(views) < 2:
        count = len(views[0][1]) if views else len(KEYPOINTS)
        return np.zeros((count, 3)), np.full(count, np.inf)
    met = triangulation.triangulate(triangulation.rays_of(views, LEAST_CONFIDENCE), AGREE_M)
    off = np.full(len(met.found), np.inf)
    off[met.found] = np.sum(met.agreeing * met.misses_m, axis=0)[met.found] / met.agreeing.sum(axis=0)[met.found]
    return met.points_m, off


def smooth(points: Array, off: Array, frame_rate: float, name: str) -> Array:
    """The way (F, 3) of a keypoint, gaps bridged where ``off`` (F,) is infinite, filtered."""
    known = np.flatnonzero(np.isfinite(off))
    if not len(known):
        raise PzcapError(f"keypoints: {name} is never seen by two cameras that agree; run another detector")
    whole = np.column_stack([np.interp(np.arange(len(off)), known, points[known, axis]) for axis in range(3)])
    if len(whole) < 16 or frame_rate <= 2 * CUTOFF_HZ:
        return whole
    filtered = sosfiltfilt(butter(2, CUTOFF_HZ, fs=frame_rate, output="sos"), whole, axis=0)
    return np.asarray(filtered)
