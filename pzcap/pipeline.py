"""Footage in, cameras and motion out: the paper's method section, a line a stage.

`stages` runs the whole; `reconstruct` runs it for whoever wants the result alone. The stages are functions, for whoever
replaces one to compare it: `pzcap.camera_set.calibrate_cameras`, `pzcap.views.ViewLocaliser` and `segment_views`,
`pzcap.starting_poses.body_tracker`, and `follow`, the one loop over the frames; `pzcap.assembly` is what comes of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

from pzcap import runtime
from pzcap.assembly import Gathered
from pzcap.calibration.blame import focal_in_doubt, lens_moved
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrate_camera, calibrate_cameras, taken_over
from pzcap.events import (
    BodyTracked,
    CameraCalibrated,
    CamerasReady,
    Event,
    Finished,
    FrameLocalised,
    FrameSegmented,
    Progress,
)
from pzcap.io.capture import FrameSets, frame_sets
from pzcap.localisation.localise import Localiser
from pzcap.plausibility import check_upright, object_of_other_shape, open_circle
from pzcap.progress import Report, no_report
from pzcap.runtime import give_back, keep_heap_small, one_thread_each
from pzcap.segmentation.foreground import ForegroundConfig
from pzcap.starting_poses import body_to_track, body_tracker, track_input
from pzcap.tracking.interval_solver import warm_up
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.tracker import Tracked, Tracker
from pzcap.types import Capture, PzcapError, Reconstruction
from pzcap.views import Localise, Segment, ViewLocaliser, segment_views
from pzcap.without_object import in_metres, of_open_size, place_cameras

TIDY_EVERY: Final = 8  # frame sets after which free memory is given back to the system


@dataclass(frozen=True, slots=True)
class Config:
    """Settings of the reconstruction."""

    panzoom: PanZoomConfig = field(default_factory=PanZoomConfig)
    """Calibration, and pan and zoom of each frame."""
    foreground: ForegroundConfig = field(default_factory=ForegroundConfig)
    """Silhouettes."""
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    """The body."""
    threads: int = 2
    """Views that are worked on side by side; BLAS and OpenCV have one thread each."""

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise PzcapError(f"threads is {self.threads}; give 1 or more")


@dataclass(frozen=True, slots=True)
class Method:
    """The functions that find a camera and its frames. `pzcap.extras` has others than `EXACT`."""

    name: str
    calibrate: Callable[..., CalibratedCamera]  # of a Footage, a PanZoomConfig and a Report
    localiser: Callable[..., Any]  # of a panorama, a PanZoomCamera and a PanZoomConfig; it has `localise`


EXACT: Final = Method("exact", calibrate_camera, Localiser)


def reconstruct(
    capture: Capture, config: Config, report: Report = no_report,
    cameras: Reconstruction | None = None,
) -> Reconstruction:  # fmt: skip
    """Run every stage that ``capture`` has the material for. See `stages` for ``cameras``.

    ``report(stage, done, total)`` hears of the progress; a total of 0 is not known yet.
    """
    return finished(stages(capture, config, cameras), report)


def finished(events: Iterator[Event], report: Report) -> Reconstruction:
    """The reconstruction that ``events`` end with."""
    for event in events:
        match event:
            case Progress(stage, done, total):
                report(stage, done, total)
            case Finished(reconstruction):
                return reconstruction
    raise AssertionError("stages end with Finished")


def stages(
    capture: Capture, config: Config, cameras: Reconstruction | None = None, method: Method = EXACT
) -> Iterator[Event]:
    """Run every stage that ``capture`` has the material for, and yield each result as it comes.

    ``cameras`` is of another take by the same cameras: those that it knows are not calibrated again.

    What is missing (a camera's sweep, the subject, the keyframes) costs the stages that need it and nothing else;
    the reconstruction's ``notes`` say what and why. Memory does not grow with the length of the video, but for the
    result itself. Raises PzcapError where a file is there and is not what it should be.
    """
    if config.panzoom.method != method.name:
        raise PzcapError(f"method '{config.panzoom.method}' is not the core's; call pzcap.extras.reconstruct for it")
    notes: list[str] = []
    keep_heap_small()
    with one_thread_each(), ThreadPoolExecutor(config.threads) as pool:
        sets = frame_sets(capture)
        body = body_to_track(capture, sets, config.tracking, notes)
        known = taken_over(capture, cameras, method.name, notes) if cameras else ()

        started = time.perf_counter()
        calibrated = yield from _calibrated(capture, config, method, pool, notes, known)
        if body:
            runtime.submit(warm_up)  # not before: cameras being calibrated take most of the memory that there is
        localise_by = partial(
            ViewLocaliser, config=config.panzoom, pool=pool, frame_rate=capture.frame_rate, localiser=method.localiser,
            ahead=sets,
        )  # fmt: skip
        segment_by = partial(_segmenter, config, pool)
        localise, placed = localise_by(calibrated), None
        if capture.calibration_object is None and not any(known) and any(calibrated):
            placed = yield from place_cameras(calibrated, capture, sets, localise, segment_by, config.tracking)
            calibrated = placed.cameras
            notes += placed.notes
            body = None if body is None else of_open_size(placed.body, placed.scale_sigma)
            if sets.keyframes:
                sets.keyframes = ()
                notes.append("keyframes.json is not used: without a calibration object nobody knows its world")
            localise = localise_by(calibrated)
        if method is EXACT:  # no other tells read-outs
            yield from localise.learn_readouts(sets)
        segment = segment_by(calibrated)
        yield CamerasReady(time.perf_counter() - started)

        tracker = None
        if body is not None:
            tracker = yield from body_tracker(body, capture, sets, localise, segment, config.tracking, notes)
        gathered = Gathered(capture, sets, segment, tracker, body)
        for event in follow(sets, localise, segment, tracker):
            gathered.take(event)
            yield event
        tracks = gathered.tracks(calibrated)
        notes += gathered.never_located(tracks, localise, known)
        notes += gathered.recorded(tracks)
    notes += gathered.contradictions(tracks)
    found = gathered.reconstruction(calibrated, tracks, localise.with_readout(), config.panzoom, notes)
    yield Finished(found if placed is None else in_metres(found, placed))


def _calibrated(
    capture: Capture, config: Config, method: Method, pool: ThreadPoolExecutor, notes: list[str],
    known: Sequence[CalibratedCamera | None],
) -> Generator[Event, None, Sequence[CalibratedCamera | None]]:  # fmt: skip
    """Stages 2 and 3: all cameras calibrated, but those that are ``known``."""
    calibrated: list[CalibratedCamera | None] = [None] * len(capture.cameras)
    one = partial(method.calibrate, config=config.panzoom)
    for event in calibrate_cameras(capture, one, pool, notes, known):
        if isinstance(event, CameraCalibrated):
            calibrated[event.index] = event.calibrated
        yield event
    for files, camera in zip(capture.cameras, calibrated, strict=True):  # not as they come: notes stay in order
        if camera is not None and method is EXACT:
            contradicted = object_of_other_shape(files.name, camera) or focal_in_doubt(files.name, camera)
            gap = open_circle(files.name, camera) if capture.full_turn else None
            notes += filter(None, [gap, contradicted or lens_moved(files.name, camera)])
    check_upright(calibrated)
    return calibrated


def _segmenter(config: Config, pool: ThreadPoolExecutor, cameras: Sequence[CalibratedCamera | None]) -> Segment:
    """Stage 5 by these ``cameras``."""
    return partial(segment_views, cameras, config.foreground, config.panzoom, pool)


# --------------------------------------------------------------------------------------------------------------
# The loop over the frames


def follow(
    sets: FrameSets, localise: Localise, segment: Segment, tracker: Tracker | None
) -> Iterator[FrameLocalised | FrameSegmented | BodyTracked | Progress]:
    """Stages 4 to 6, frame set by frame set. ``tracker``, where there is one, also says where it expects the body."""
    for frames in sets:
        seen = localise(frames, tracker)
        yield seen
        segmented = segment(seen, tracker)
        yield segmented
        if tracker:
            yield _timed(partial(tracker.push, track_input(segmented)))
            if tracker.by_fields and seen.second_fields is not None:
                yield _timed(partial(_track_between, seen.second_fields, segment, tracker))
        if frames.index % TIDY_EVERY == 0:
            give_back()
        yield Progress("motion", frames.index + 1, len(sets))
    if tracker:
        yield _timed(tracker.finish)


def _track_between(seen: FrameLocalised, segment: Segment, tracker: Tracker) -> list[Tracked]:
    """Stages 5 and 6 of second fields, which halve the way from one pose to the next."""
    return tracker.push(replace(track_input(segment(seen, tracker)), second_field=True))


def _timed(track: Callable[[], list[Tracked]]) -> BodyTracked:
    started = time.perf_counter()
    poses = tuple(track())
    return BodyTracked(poses, time.perf_counter() - started)
