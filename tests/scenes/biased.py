"""Estimators for the tests: the small capture's own truth, as a perfect estimator would find it; and ours, worsened.

python -m experiments.gate estimator=tests.scenes.biased:pan_off
python -m experiments.gate estimator=tests.scenes.biased:long_arm
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.footage import truth_beside
from pzcap.pipeline import Config, reconstruct
from pzcap.types import Array, Capture, Motion, PanZoomTrack, Reconstruction
from sim.truth import Truth


def truth_of(capture: Capture) -> Truth:
    truth = truth_beside(capture.folder)
    assert truth is not None
    return truth


def perfect_tracks(capture: Capture) -> list[PanZoomTrack | None]:
    truth = truth_of(capture)
    return [
        PanZoomTrack(
            pan_rad=truth.pan_rad[camera],
            tilt_rad=truth.tilt_rad[camera],
            roll_rad=np.zeros(len(truth.timecodes)),
            focal_px=truth.focal_px[camera],
            covariance=np.tile(np.diag([1e-8, 1e-8]), (len(truth.timecodes), 1, 1)),
            inliers=np.zeros(len(truth.timecodes), np.int64),
            valid=truth.recorded[camera],
        )
        for camera in range(len(truth.camera_names))
    ]


def tracks_off(capture: Capture, by_deg: float = 0.0) -> list[PanZoomTrack | None]:
    return [None if t is None else replace(t, pan_rad=t.pan_rad + np.deg2rad(by_deg)) for t in perfect_tracks(capture)]


def perfect_motion(capture: Capture) -> Motion:
    truth = truth_of(capture)
    frames = len(truth.timecodes)
    return Motion(
        root_position_m=truth.root_position_m,
        rotations=truth.rotations,
        joints_m=truth.joints_m,
        sigma_m=np.full((frames, 16), 0.01),
        keyframes=np.array([], np.int64),
        valid=np.ones(frames, bool),
    )


def a_dict(capture: Capture) -> dict[str, str]:
    return {"name": capture.name}


def pan_off(capture: Capture) -> Reconstruction:
    """Ours, every pan off by 0.01 degrees."""
    whole = reconstruct(capture, Config())
    tracks = (None if t is None else replace(t, pan_rad=t.pan_rad + np.deg2rad(0.01)) for t in whole.tracks)
    return replace(whole, tracks=tuple(tracks))


def long_arm(capture: Capture) -> Reconstruction:
    """Ours, the left upper arm 3 % too long."""
    whole = reconstruct(capture, Config())
    assert whole.motion is not None
    return replace(whole, motion=replace(whole.motion, joints_m=lengthened(whole.motion.joints_m)))


def lengthened(joints_m: Array) -> Array:
    """Joints (F, 16, 3), the left upper arm 3 % longer; what hangs on it goes along."""
    longer = joints_m.copy()
    longer[:, 5:7] += 0.03 * (joints_m[:, 5] - joints_m[:, 4])[:, None]
    return longer
