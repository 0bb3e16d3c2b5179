"""Pan and zoom of each camera over the frames of a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.calibration.settings import PanZoomConfig
from pzcap.localisation.covariance import systematic
from pzcap.tracking.tracker import Tracked
from pzcap.types import Array, Localisation, PanZoomCamera, PanZoomTrack


def _panzoom_track(history: Sequence[Localisation | None]) -> PanZoomTrack:
    """The track of a camera from its localisation in each frame."""

    def column(value: Callable[[Localisation], float]) -> Array:
        return np.array([value(found) if found else 0.0 for found in history])

    return PanZoomTrack(
        pan_rad=column(lambda found: found.pan_rad),
        tilt_rad=column(lambda found: found.tilt_rad),
        focal_px=column(lambda found: found.focal_px),
        covariance=np.stack([found.covariance if found else np.zeros((2, 2)) for found in history]),
        inliers=column(lambda found: len(found.frame_points_px)).astype(np.int64),
        valid=column(lambda found: found.valid).astype(np.bool_),
    )


def panzoom_tracks(
    calibrated: Sequence[CalibratedCamera | None], located: Sequence[tuple[Localisation | None, ...]]
) -> tuple[PanZoomTrack | None, ...]:
    """Pan and zoom of each camera over the frames; None where it was not calibrated."""
    histories = zip(*located, strict=True) if located else ((),) * len(calibrated)
    return tuple(_panzoom_track(history) if one else None for one, history in zip(calibrated, histories, strict=True))


def refined(
    track: PanZoomTrack, head: PanZoomCamera, number: int, poses: Sequence[Tracked], config: PanZoomConfig
) -> PanZoomTrack:
    """The ``track`` of camera ``number`` with what the body has corrected of it."""
    pan_rad, focal_px, covariance = track.pan_rad.copy(), track.focal_px.copy(), track.covariance.copy()
    shared = systematic(config, head, track.pan_rad, track.focal_px)
    for pose in poses:
        correction = pose.corrections[number] if pose.corrections else None
        if correction is not None:
            pan_rad[pose.frame] += correction.step[0]
            focal_px[pose.frame] *= np.exp(correction.step[1])
            covariance[pose.frame] = shared[pose.frame] + correction.covariance
    return replace(track, pan_rad=pan_rad, focal_px=focal_px, covariance=covariance)
