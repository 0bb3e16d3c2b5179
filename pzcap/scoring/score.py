"""Errors of a method's results against the truth, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap.scoring.body_errors import BodyErrors, body_errors
from pzcap.scoring.camera_errors import CameraErrors, aligned_centres, camera_errors, own_world_errors
from pzcap.scoring.records import Results, TrueCapture, matched, within


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors of a method's results on one capture."""

    truth_frames: NDArray[np.int64]  # (F,) index into the truth of each frame
    cameras: tuple[CameraErrors, ...]  # (C,) of the results
    body: BodyErrors | None
    lost: int | None  # recorded views of these cameras without a valid estimate; None: it is about the body alone
    views: int  # recorded views of all cameras of the truth: those that could have been answered
    answered: int  # of them with a valid estimate
    joints: int  # joints in all frames of the truth but the keyframes
    answered_joints: int  # of them with an estimate


def score(results: Results, truth: TrueCapture) -> Errors:
    """Compare ``results`` with ``truth``. Nothing is aligned, but where a name says so; what is missing is counted and
    costs no accuracy.

    Raises PzcapError if the truth is of another capture.
    """
    frames, known = matched(results, truth)
    lost, answered, cameras = 0, 0, []
    for name, track in zip(results.camera_names, results.cameras, strict=True):
        true = truth.cameras[truth.camera_names.index(name)]
        recorded = true.recorded[frames] & known  # dropped frames do not count
        if track is None:
            cameras.append(CameraErrors())
        elif results.own_world:
            cameras.append(own_world_errors(within(track, recorded), true, frames))
        else:
            cameras.append(camera_errors(within(track, recorded), true, frames, known, truth.image_size))
        found = np.zeros(len(frames), bool) if track is None else track.valid
        lost += int(np.sum(recorded & ~found))
        answered += int(np.sum(recorded & found))
    body = None if results.body is None else body_errors(results.body, truth, frames, known)
    if body is not None and body.similarity is not None:
        for number, (name, track) in enumerate(zip(results.camera_names, results.cameras, strict=True)):
            true = truth.cameras[truth.camera_names.index(name)]
            if track is not None and not results.own_world:
                aligned = aligned_centres(within(track, true.recorded[frames] & known), true, frames, body.similarity)
                cameras[number] = replace(cameras[number], aligned_centre_m=aligned)
    posed = [] if body is None else frames[body.keyframe & known].tolist()
    hidden = len({*posed, *np.flatnonzero(truth.keyframe).tolist()})
    return Errors(
        truth_frames=frames, cameras=tuple(cameras), body=body,
        lost=lost if body is None or any(track is not None for track in results.cameras) else None,
        views=int(sum(true.recorded.sum() for true in truth.cameras)), answered=answered,
        joints=(len(truth.timecodes) - hidden) * truth.joints_m.shape[1],
        answered_joints=0 if body is None else int(body.scored_joints.sum()),
    )  # fmt: skip
