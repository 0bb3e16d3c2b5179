"""The pipeline with all extras: what the configuration asks of them, and notes on the keyframes.

What is in `pzcap.pipeline` runs without them; this is what the experiments call.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from typing import Final

import numpy as np

from pzcap import pipeline
from pzcap.body import skeleton
from pzcap.calibration.calibrate import CalibratedCamera, Footage
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrate_rolling
from pzcap.events import Event, Finished
from pzcap.extras import keyframe_diagnostics, rts_smoother
from pzcap.extras.leave_half_out import super_resolved
from pzcap.extras.paper.method import PAPER, without_floor
from pzcap.extras.superresolved_alignment import SuperresolvedAligner
from pzcap.io.capture import frame_sets
from pzcap.localisation.covariance import systematic
from pzcap.localisation.localise import Localiser, count_from_reference
from pzcap.plausibility import blames_object
from pzcap.progress import Report, no_report
from pzcap.types import Capture, PanZoomCamera, PanZoomTrack, Reconstruction


def calibrate_finer(footage: Footage, config: PanZoomConfig, report: Report = no_report) -> CalibratedCamera:
    """Calibrate one camera as `pzcap.camera_set.calibrate_camera` does, its panorama super-resolved."""
    found, swept = calibrate_rolling(footage, config, report)
    panorama = super_resolved(found.panorama, found.camera, swept, report)
    image, focal_px = footage.reference_image, found.reference.camera.focal_px
    counted = count_from_reference(panorama, found.camera, image, focal_px, SuperresolvedAligner)
    # the bundle adjustment's errors of the pans are no longer in it
    camera = replace(found.camera, shared_covariance=np.zeros((0, 0, 2, 2)), shared_zooms=np.zeros(0))
    return replace(found, panorama=counted, camera=camera)


SUPER_RESOLVING: Final = pipeline.Method("exact", calibrate_finer, partial(Localiser, aligner=SuperresolvedAligner))


@dataclass(frozen=True, slots=True)
class Config(pipeline.Config):
    """Settings of the reconstruction, and of what is made of its result."""

    smooth: rts_smoother.SmoothConfig = field(default_factory=rts_smoother.SmoothConfig)
    """Smoothing of the finished camera tracks."""


def method_of(config: Config) -> tuple[pipeline.Method, Config]:
    """The method that ``config`` asks for, and the configuration as that method takes it."""
    if config.panzoom.method == PAPER.name:
        return PAPER, replace(config, panzoom=without_floor(config.panzoom))
    return (SUPER_RESOLVING if config.panzoom.sweep.super_resolve else pipeline.EXACT), config


def reconstruct(
    capture: Capture, config: Config, report: Report = no_report, cameras: Reconstruction | None = None
) -> Reconstruction:
    """Run `stages`, and give back what they end with; as `pzcap.pipeline.reconstruct`."""
    return pipeline.finished(stages(capture, config, cameras), report)


def stages(capture: Capture, config: Config, cameras: Reconstruction | None = None) -> Iterator[Event]:
    """Run `pzcap.pipeline.stages` by the method that ``config`` names; smooth the tracks, and add notes on the
    keyframes."""
    method, taken = method_of(config)
    for event in pipeline.stages(capture, taken, cameras, method):
        yield Finished(completed(event.reconstruction, capture, taken)) if isinstance(event, Finished) else event


def completed(found: Reconstruction, capture: Capture, config: Config) -> Reconstruction:
    """The result of the core with its tracks smoothed, where the config says so, and notes on the keyframes."""
    notes = found.notes
    if found.motion is not None and capture.subject is not None and not blames_object(notes):
        keyframes, body = frame_sets(capture).keyframes, skeleton.build(capture.subject)
        detected = any(camera.keypoints is not None for camera in capture.cameras)
        notes += keyframe_diagnostics.notes(found.motion, keyframes, body, found.timecodes, detected)
    tracks = smoothed(found.tracks, found.cameras, found.frame_rate, config)
    return replace(found, tracks=tracks, notes=notes)


def smoothed(
    tracks: tuple[PanZoomTrack | None, ...],
    cameras: tuple[PanZoomCamera | None, ...],
    frame_rate: Fraction,
    config: Config,
) -> tuple[PanZoomTrack | None, ...]:
    """The finished tracks, smoothed where the config says so.

    A smoother looks ahead, and the pipeline runs forward: silhouettes and body were found with the cameras as each
    frame alone gave them, whatever is done here.
    """
    if not config.smooth.enabled:
        return tracks
    return tuple(
        None
        if track is None or camera is None
        # systematic error, which the covariances hold, is not smoothed away
        else rts_smoother.smooth(
            track, frame_rate, config.smooth, systematic(config.panzoom, camera, track.pan_rad, track.focal_px)
        )
        for track, camera in zip(tracks, cameras, strict=True)
    )
