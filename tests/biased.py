"""Estimators for the tests: the small capture's own truth, as a perfect estimator would find it, and worse ones."""

from __future__ import annotations

import numpy as np

from experiments.footage import truth_beside
from pzcap.types import Capture, Motion, PanZoomTrack
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
            focal_px=truth.focal_px[camera],
            covariance=np.tile(np.diag([1e-8, 1e-8]), (len(truth.timecodes), 1, 1)),
            inliers=np.zeros(len(truth.timecodes), np.int64),
            valid=truth.recorded[camera],
        )
        for camera in range(len(truth.camera_names))
    ]


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
