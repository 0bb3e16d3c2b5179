"""Footage in, cameras and motion out: the paper's method section, a line a stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Final

import numpy as np

from pzcap.body import skeleton
from pzcap.calibration.calibrate import Prepared, no_report
from pzcap.camera_set import prepare_cameras, taken_over
from pzcap.events import CameraPrepared, Event, Finished, FrameLocalised, FrameSeparated, Progress
from pzcap.extras import keyframe_diagnostics, rts_smoother
from pzcap.geometry.camera import at
from pzcap.io.capture import FrameSets, frame_sets
from pzcap.io.detections import NOBODY
from pzcap.localisation.localise import Localiser, PanZoomConfig, predicted, systematic
from pzcap.runtime import give_back, one_thread_each, set_large_apart
from pzcap.segmentation import foreground
from pzcap.tracking import keyframes
from pzcap.tracking.camera_refinement import camera_prior
from pzcap.tracking.tracker import Tracked, Tracker, TrackingConfig, TrackInput, View
from pzcap.types import (
    Array,
    Camera,
    Capture,
    FrameSet,
    Image,
    Localisation,
    Mask,
    PanZoomCamera,
    PanZoomTrack,
    PzcapError,
    Reconstruction,
    Silhouette,
)

TIDY_EVERY: Final = 30
"""Frame sets after which free memory is given back: what threads leave between what they keep comes to 150 MiB."""


@dataclass(frozen=True, slots=True, eq=False)
class Config:
    panzoom: PanZoomConfig = field(default_factory=PanZoomConfig)
    foreground: foreground.ForegroundConfig = field(default_factory=foreground.ForegroundConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    smooth: rts_smoother.SmoothConfig = field(default_factory=rts_smoother.SmoothConfig)
    threads: int = 2

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise PzcapError(f"threads is {self.threads}; give 1 or more")


def reconstruct(
    capture: Capture,
    config: Config,
    report: Callable[[str, int, int], None] = no_report,
    cameras: Reconstruction | None = None,
) -> Reconstruction:
    """Run every stage that ``capture`` has the material for. See ``stages`` for ``cameras`` and the results on the way.

    ``report(stage, done, total)`` hears of the progress; a total of 0 is not known yet.
    """
    for event in stages(capture, config, cameras):
        match event:
            case Progress(stage, done, total):
                report(stage, done, total)
            case Finished(reconstruction, _):
                return reconstruction
            case _:
                pass
    raise AssertionError("stages() ends with Finished")


def stages(capture: Capture, config: Config, cameras: Reconstruction | None = None) -> Iterator[Event]:
    """Run every stage that ``capture`` has the material for, and yield each result as it comes.

    ``cameras`` is of another take by the same cameras: those that it knows are not calibrated again.

    What is missing (a camera's sweep, the subject, the keyframes) costs the stages that need it and nothing else;
    the reconstruction's ``notes`` say what and why. Memory does not grow with the length of the video, but for the
    result itself. Raises PzcapError where a file is there and is not what it should be.
    """
    seconds = {"prepare": 0.0, "panzoom": 0.0, "foreground": 0.0, "tracking": 0.0}
    notes: list[str] = []
    set_large_apart()
    with one_thread_each(), ThreadPoolExecutor(config.threads) as pool:
        sets = frame_sets(capture)
        tracker = _tracker(capture, sets, config, notes)

        started = time.perf_counter()
        prepared: list[Prepared | None] = [None] * len(capture.cameras)
        ready = taken_over(capture, cameras, config.panzoom.method, notes) if cameras else ()
        for event in prepare_cameras(capture, config.panzoom, pool, notes, ready):
            if isinstance(event, CameraPrepared):
                prepared[event.index] = event.prepared
            yield event
        if tracker:
            tracker.make_ready()  # not before: cameras being prepared take most of the memory that there is
        # one after the other: the features of a panorama take 250 MiB for the half second in which they are found
        localisers = [None if p is None else Localiser(p.panorama, p.camera, config.panzoom) for p in prepared]
        give_back()
        seconds["prepare"] = time.perf_counter() - started

        found: list[list[Localisation | None]] = [[] for _ in capture.cameras]
        poses: list[Tracked] = []
        views = _Views(prepared, localisers, config, pool, seconds)
        for frames in sets:
            seen = views.localise(frames, tracker)
            for history, localisation in zip(found, seen.localisations, strict=True):
                history.append(localisation)
            separated = views.separate(seen, tracker)
            yield from (seen, separated)
            if tracker:
                started = time.perf_counter()
                arrived = tracker.push(_track_input(seen, separated, prepared, config))
                seconds["tracking"] += time.perf_counter() - started
                yield from arrived
                poses += arrived
            if frames.index % TIDY_EVERY == 0:
                give_back()
            yield Progress("motion", frames.index + 1, len(sets))
        if tracker:
            started = time.perf_counter()
            arrived = tracker.finish()
            seconds["tracking"] += time.perf_counter() - started
            yield from arrived
            poses += arrived

    motion = None
    if tracker and capture.subject:
        motion = tracker.motion(poses)
        taped, hand_sigma = skeleton.build(capture.subject), config.tracking.hand_sigma
        notes += keyframe_diagnostics.notes(motion, sets.keyframes, taped, hand_sigma, sets.timecodes)
    heads = tuple(None if p is None else p.camera for p in prepared)
    tracks = tuple(_panzoom_track(history) if p else None for p, history in zip(prepared, found, strict=True))
    notes += [
        f"camera {files.name}: no frame agrees with the take before; it was moved since then, calibrate it anew"
        for files, known, track in zip(capture.cameras, ready, tracks, strict=False)
        if known and files.motion and track and not track.valid.any()
    ]
    yield Finished(
        Reconstruction(
            capture_name=capture.name,
            method=config.panzoom.method,
            frame_rate=capture.frame_rate,
            timecodes=sets.timecodes,
            camera_names=tuple(files.name for files in capture.cameras),
            references=tuple(None if p is None else p.reference for p in prepared),
            cameras=heads,
            panoramas=tuple(None if p is None else p.panorama for p in prepared),
            tracks=smoothed(tracks, heads, capture.frame_rate, config),
            refined=tuple(
                None if track is None or head is None or not poses else _refined(track, head, number, poses, config)
                for number, (track, head) in enumerate(zip(tracks, heads, strict=True))
            ),
            motion=motion,
            notes=tuple(notes),
        ),
        seconds,
    )


# --------------------------------------------------------------------------------------------------------------
# Stages 4-5: each view of an instant for itself


@dataclass(slots=True, eq=False)
class _Views:
    """The four views of an instant, worked on side by side. Remembers where each camera was last seen."""

    prepared: list[Prepared | None]
    localisers: list[Localiser | None]
    config: Config
    pool: ThreadPoolExecutor
    seconds: dict[str, float]  # of each stage, added to
    before: list[Localisation | None] = field(init=False)
    last: list[Localisation | None] = field(init=False)

    def __post_init__(self) -> None:
        self.before = [None] * len(self.prepared)
        self.last = [None] * len(self.prepared)

    def localise(self, frames: FrameSet, tracker: Tracker | None) -> FrameLocalised:
        """``tracker``, where there is one, says where it expects the body."""

        def one(index: int, image: Image | None) -> Localisation | None:
            localiser, prepared = self.localisers[index], self.prepared[index]
            if localiser is None or prepared is None or image is None:
                return None
            head = prepared.camera

            def hidden(prior: Localisation) -> Mask | None:
                camera = at(head, prior.pan_rad, prior.tilt_rad, prior.focal_px)
                expected = None if tracker is None else tracker.expect(frames.index, camera)
                return None if expected is None else expected.covered(camera.height, camera.width)

            prior = predicted(self.before[index], self.last[index])
            localisation = localiser.localise(image, prior, hidden)
            self.before[index] = self.last[index]
            self.last[index] = localisation if localisation.valid else None
            return localisation

        started = time.perf_counter()
        localisations = tuple(self.pool.map(one, range(len(frames.images)), frames.images))
        self.seconds["panzoom"] += time.perf_counter() - started
        return FrameLocalised(frames, localisations)

    def separate(self, seen: FrameLocalised, tracker: Tracker | None) -> FrameSeparated:
        """``tracker``, where there is one, says where it expects the body."""

        def one(index: int) -> tuple[Camera | None, Silhouette | None]:
            image, found, prepared = seen.frames.images[index], seen.localisations[index], self.prepared[index]
            if prepared is None or image is None or found is None or not found.valid:
                return None, None
            camera = at(prepared.camera, found.pan_rad, found.tilt_rad, found.focal_px)
            expected = None if tracker is None else tracker.expect(seen.frames.index, camera)
            settings = self.config.foreground
            return camera, foreground.separate(image, prepared.panorama, prepared.camera, found, settings, expected)

        started = time.perf_counter()
        pairs = list(self.pool.map(one, range(len(seen.frames.images))))
        self.seconds["foreground"] += time.perf_counter() - started
        cameras, silhouettes = (tuple(parts) for parts in zip(*pairs, strict=True))
        return FrameSeparated(seen.frames, cameras, silhouettes)


def _panzoom_track(history: list[Localisation | None]) -> PanZoomTrack:
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


def _refined(
    track: PanZoomTrack, head: PanZoomCamera, number: int, poses: Sequence[Tracked], config: Config
) -> PanZoomTrack:
    """The ``track`` of one camera with what the body has corrected of it."""
    pan_rad, focal_px, covariance = track.pan_rad.copy(), track.focal_px.copy(), track.covariance.copy()
    shared = systematic(config.panzoom, head, track.pan_rad, track.focal_px)
    for pose in poses:
        correction = pose.corrections[number] if pose.corrections else None
        if correction is not None:
            pan_rad[pose.frame] += correction.step[0]
            focal_px[pose.frame] *= np.exp(correction.step[1])
            covariance[pose.frame] = shared[pose.frame] + correction.covariance
    return replace(track, pan_rad=pan_rad, focal_px=focal_px, covariance=covariance)


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
            track,
            frame_rate,
            config.smooth,
            systematic(config.panzoom, camera, track.pan_rad, track.focal_px),
        )
        for track, camera in zip(tracks, cameras, strict=True)
    )


# --------------------------------------------------------------------------------------------------------------
# Stage 6: the body in all views


def _tracker(capture: Capture, sets: FrameSets, config: Config, notes: list[str]) -> Tracker | None:
    if capture.subject is None:
        notes.append("the body is not tracked: the capture holds no tape measurements (subject.json)")
        return None
    if not sets.keyframes:
        notes.append("the body is not tracked: the capture holds no keyframes (keyframes.json)")
        return None
    model = skeleton.build(capture.subject)
    notes += keyframes.check(sets.keyframes, model, len(sets))
    return Tracker(model, sets.keyframes, float(capture.frame_rate), config.tracking)


def _track_input(
    seen: FrameLocalised, separated: FrameSeparated, prepared: Sequence[Prepared | None], config: Config
) -> TrackInput:
    people = seen.frames.keypoints or (NOBODY,) * len(prepared)

    def view(index: int) -> View | None:
        image, camera, silhouette = seen.frames.images[index], separated.cameras[index], separated.silhouettes[index]
        known, found = prepared[index], seen.localisations[index]
        if image is None or camera is None or silhouette is None or known is None or found is None:
            return None
        aim = camera_prior(config.panzoom, known.camera, found)
        return View(image, camera, silhouette, people[index], aim) if silhouette.valid else None

    return TrackInput(seen.frames.index, tuple(view(index) for index in range(len(prepared))))
