"""Stages 2-3: the cameras of a capture calibrated side by side before the motion; or taken over from another take by
the same cameras, which have not been moved since."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from pzcap.calibration import lateral_colour, reference_camera
from pzcap.calibration.blame import lens_moved, sweep_is_foreign
from pzcap.calibration.calibrate import CalibratedCamera, Footage, calibrate
from pzcap.calibration.other_dictionaries import find_other
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.stitching import SweptFrames, ZoomedFrames
from pzcap.events import CameraCalibrated, Progress
from pzcap.io.capture import read_image
from pzcap.io.video import VideoReader
from pzcap.localisation.covariance import systematic
from pzcap.localisation.duplicate_frames import covariance_of, extrapolated
from pzcap.localisation.fields import BothFields, by_both_fields
from pzcap.localisation.localise import count_from_reference
from pzcap.localisation.sweep_readout import Remaining, Still, evenly_lit, in_sweep, in_zoom_run, put_right, still_of
from pzcap.localisation.tuning import READOUT
from pzcap.progress import Report, no_report
from pzcap.runtime import give_back
from pzcap.tracking.tracker import Tracked
from pzcap.types import (
    Array,
    CameraFiles,
    Capture,
    Localisation,
    PanZoomCamera,
    PanZoomTrack,
    PzcapError,
    Reconstruction,
)


def calibrated_of(found: Reconstruction) -> tuple[CalibratedCamera | None, ...]:
    """The cameras of a reconstruction as they were calibrated; None for one that was not."""
    parts = zip(found.references, found.panoramas, found.cameras, strict=True)
    return tuple(
        None if reference is None or panorama is None or head is None else CalibratedCamera(reference, panorama, head)
        for reference, panorama, head in parts
    )


def taken_over(
    capture: Capture, earlier: Reconstruction, method: str, notes: list[str]
) -> tuple[CalibratedCamera | None, ...]:
    """The cameras of ``capture`` as ``earlier``, by the same cameras at the same places, has them; None for one that it
    does not know, or could not calibrate.

    Cameras are told by their names; which are known is added to ``notes``. Raises PzcapError if it knows none of them,
    or was made by another method.
    """
    if earlier.method != method:
        raise PzcapError(
            f"'{earlier.capture_name}' was calibrated with method={earlier.method}, not {method}; give the same method"
        )
    known = dict(zip(earlier.camera_names, calibrated_of(earlier), strict=True))
    found = tuple(known.get(files.name) for files in capture.cameras)
    if not any(found):
        raise PzcapError(
            f"'{earlier.capture_name}' has no calibrated camera of the names in {capture.folder}: "
            f"{', '.join(files.name for files in capture.cameras)}; it is another setup"
        )
    for files, prepared in zip(capture.cameras, found, strict=True):
        if prepared is not None and files.motion is not None:
            reader, lens = VideoReader(files.motion), prepared.camera.lens
            if (reader.width, reader.height) != (lens.width, lens.height):
                raise PzcapError(
                    f"{files.motion}: {reader.width}x{reader.height} pixels, where camera {files.name} had "
                    f"{lens.width}x{lens.height} when it was calibrated; film as then, or calibrate it anew"
                )
    names = [files.name for files, prepared in zip(capture.cameras, found, strict=True) if prepared is not None]
    notes.append(f"calibrated at the take before, '{earlier.capture_name}': camera {', '.join(names)}")
    return found


def calibrate_camera(footage: Footage, config: PanZoomConfig, report: Report = no_report) -> CalibratedCamera:
    """Calibrate one camera, and count its pans from the reference image. Raises PzcapError as `calibrate` does."""
    found, _ = calibrate_rolling(footage, config, report)
    focal_px = found.reference.camera.focal_px
    panorama = count_from_reference(found.panorama, found.camera, footage.reference_image, focal_px)
    return replace(found, panorama=panorama)


def calibrate_rolling(
    footage: Footage, config: PanZoomConfig, report: Report = no_report
) -> tuple[CalibratedCamera, SweptFrames]:
    """Calibrate one camera as `calibrate` does, the colours of its frames aligned; if its shutter rolls, again by
    frames of the sweep that are put right in place and light (`pzcap.localisation.sweep_readout`)."""
    colours = lateral_colour.measure(footage.sweep)
    if colours.any():
        footage = lateral_colour.aligned(footage, colours)
    found, swept, zoomed, bands = calibrate(footage, config, report)
    even, readout = evenly_lit(footage, bands, swept.kept, zoomed.numbers), 0.0
    upright = even
    for _ in range(READOUT.sweep_rounds):
        still, rolls = still_of(footage, found, zoomed), readout != 0.0
        more = _remaining(still, upright, found, swept, zoomed, rolls)
        if more.matters:
            readout += more.share
        elif not bands.size:
            break
        upright = put_right(even, readout, found, swept, zoomed) if readout else even
        found, swept, zoomed, bands = calibrate(upright, config, report)
        even = evenly_lit(even, bands, swept.kept, zoomed.numbers)  # what frames out of place had hidden
    readout_s, sigma_s = readout * footage.sweep_period_s, more.sigma * footage.sweep_period_s  # sigma 0: not known
    lens = replace(found.camera.lens, lateral_colour=colours)
    return replace(found, camera=replace(found.camera, lens=lens, readout_s=readout_s, readout_sigma_s=sigma_s)), swept


def _remaining(
    still: Still | None, upright: Footage, found: CalibratedCamera, swept: SweptFrames, zoomed: ZoomedFrames,
    rolls: bool,
) -> Remaining:  # fmt: skip
    """Read-out that is left in ``upright``, footage put right by what is known of it: by a ``still`` picture and, if
    the shutter ``rolls`` or that shows it to, by the zoom run. Pictures of interlaced zoom runs are sheared by
    themselves, by what a millisecond and a half would."""
    if still is None:
        return Remaining(0.0, 0.0)
    seen = in_sweep(still, found, swept)
    if upright.by_fields or upright.zoom is None or not (rolls or seen.matters):
        return seen
    other = in_zoom_run(upright.zoom, found, zoomed)
    return seen if other is None else seen.with_other(other)


class _GivenUpError(Exception):
    """Nobody waits for what a thread calibrates."""


def calibrate_cameras(
    capture: Capture, calibrate_one: Callable[..., CalibratedCamera], pool: ThreadPoolExecutor, notes: list[str],
    ready: Sequence[CalibratedCamera | None] = (),
) -> Iterator[Progress | CameraCalibrated]:  # fmt: skip
    """Calibrate by ``calibrate_one(footage, report=report)`` the cameras but those that are ``ready``, as many at a
    time as ``pool`` has threads; what is missing is added to ``notes``.

    Raises PzcapError where a file is there and is not what it should be. Cameras that are being calibrated then, or
    when the caller is interrupted, are given up at their next report: leaving the ``pool`` would wait for them.
    """
    ready = ready or (None,) * len(capture.cameras)
    _find_object(capture, [files for files, known in zip(capture.cameras, ready, strict=True) if known is None])
    news: queue.SimpleQueue[Progress | CameraCalibrated | Future[None]] = queue.SimpleQueue()
    given_up = threading.Event()

    def job(index: int, files: CameraFiles) -> None:
        def report(stage: str, done: int, total: int) -> None:
            if given_up.is_set():
                raise _GivenUpError
            news.put(Progress(f"camera {files.name}: {stage}", done, total))

        started = time.perf_counter()
        footage = footage_of(capture, files)
        try:
            calibrated = calibrate_one(footage, report=report)
        except PzcapError as error:
            _check_sweep(files, footage)
            raise PzcapError(f"camera {files.name}: {error}") from error
        if lens_moved(files.name, calibrated):  # two cameras of one kind differ by little more
            _check_sweep(files, footage)
        news.put(CameraCalibrated(index, calibrated, time.perf_counter() - started))
        give_back()

    jobs: list[Future[None]] = []
    try:
        for index, (files, known) in enumerate(zip(capture.cameras, ready, strict=True)):
            missing = _missing(capture, files)
            if known is None and missing:
                notes.append(f"camera {files.name} is not calibrated: {missing}")
                yield CameraCalibrated(index, None, 0.0)
                continue
            if files.motion is None:
                notes.append(f"camera {files.name} recorded no motion: the body is tracked in the other views")
            if known is not None:
                yield CameraCalibrated(index, known, 0.0)
                continue
            if files.zoom is None:
                notes.append(
                    f"camera {files.name} has no zoom run: distortion and principal point are taken as constant"
                )
            jobs.append(pool.submit(job, index, files))
            jobs[-1].add_done_callback(news.put)
        running = len(jobs)
        while running:
            event = news.get()
            if isinstance(event, Future):
                running -= 1
                if error := event.exception():
                    raise error
            else:
                yield event
    finally:
        given_up.set()
        for each in jobs:
            each.cancel()


def _check_sweep(files: CameraFiles, footage: Footage) -> None:
    """Look for the cause of a calibration that failed, or does not agree. Raises PzcapError where the sweep is another
    camera's."""
    try:
        foreign = sweep_is_foreign(footage, PanZoomConfig())
    except PzcapError:  # the reference image is wrong itself
        return
    if foreign:
        raise PzcapError(
            f"camera {files.name}: {files.sweep}: shows nothing of what the reference image and the zoom run show, "
            "which agree; it is another camera's, or was shot elsewhere"
        )


def _missing(capture: Capture, files: CameraFiles) -> str | None:
    """The first file that a camera cannot be calibrated without and the capture does not hold."""
    if capture.calibration_object is None:
        lacking = what_is_lacking(capture)
        if lacking:
            return f"the capture holds no calibration object, and without one {lacking}"
        return None if files.sweep else "it has no pan sweep"
    needed = {"it has no reference image": files.reference, "it has no pan sweep": files.sweep}
    return next((text for text, file in needed.items() if file is None), None)


def what_is_lacking(capture: Capture) -> str | None:
    """The first thing that a capture without a calibration object needs and has not; None: it has all."""
    seen = sum(1 for files in capture.cameras if files.keypoints and files.motion and files.sweep)
    if not capture.full_turn:
        return "a sweep has to go all the way round, or nothing tells the focal length"
    if seen < 2:
        return (
            "a detector's keypoints of two cameras or more have to tell how these stand "
            "(pzcap keypoints FOLDER --by mediapipe)"
        )
    if not capture.lengths and (capture.subject is None or "stature" not in capture.subject.measurements_m):
        return "the athlete's stature (subject.json) or lengths.json (pzcap lengths) has to tell how long a metre is"
    return None


def _find_object(capture: Capture, cameras: Sequence[CameraFiles]) -> None:
    """Raise PzcapError, before minutes are spent on the sweeps, if a reference image does not show the object."""
    for files in cameras:
        if capture.calibration_object is None or files.reference is None:
            continue
        image = read_image(files.reference)
        try:
            reference_camera.detect(image, capture.calibration_object)
        except PzcapError as error:
            said = capture.calibration_object.dictionary
            if other := find_other(image, said):
                raise PzcapError(
                    f"camera {files.name}: {files.reference}: {other[1]} markers are of {other[0]}, where object.json "
                    f"says {said}; correct it there"
                ) from error
            raise PzcapError(f"camera {files.name}: {files.reference}: {error}") from error


def footage_of(capture: Capture, files: CameraFiles) -> Footage:
    """The footage of one camera in the empty hall. Raises PzcapError where an image or video cannot be opened."""
    assert files.sweep is not None
    zoom, sweep = None if files.zoom is None else VideoReader(files.zoom), VideoReader(files.sweep)
    if capture.calibration_object is None:
        _, image = next(iter(sweep))  # pan is counted from there
    else:
        assert files.reference is not None
        image = read_image(files.reference)
    period_s = float(1 / sweep.frame_rate)
    by_fields = sweep.interlaced or (zoom is not None and zoom.interlaced)
    zoomed = None if zoom is None else BothFields(zoom)
    return Footage(image, capture.calibration_object, sweep, zoomed, capture.full_turn, period_s, by_fields)


# --------------------------------------------------------------------------------------------------------------
# Pan and zoom of each camera over the frames of a recording


def _panzoom_track(history: Sequence[Localisation | None]) -> PanZoomTrack:
    """The track of a camera from its localisation in each frame."""

    def column(value: Callable[[Localisation], float]) -> Array:
        return np.array([value(found) if found else 0.0 for found in history])

    return PanZoomTrack(
        pan_rad=column(lambda found: found.pan_rad),
        tilt_rad=column(lambda found: found.tilt_rad),
        roll_rad=column(lambda found: found.roll_rad),
        focal_px=column(lambda found: found.focal_px),
        covariance=np.stack([found.covariance if found else np.zeros((2, 2)) for found in history]),
        inliers=column(lambda found: len(found.frame_points_px)).astype(np.int64),
        valid=column(lambda found: found.valid).astype(np.bool_),
        shear=np.array([found.shear if found else np.zeros(2) for found in history]).reshape(-1, 2),
        readout=column(lambda found: found.readout),
    )


def panzoom_tracks(
    calibrated: Sequence[CalibratedCamera | None], located: Sequence[tuple[Localisation | None, ...]]
) -> tuple[PanZoomTrack | None, ...]:
    """Pan and zoom of each camera over the frames, of interlaced ones by both fields, carried on where a picture is
    shown twice; None where it was not calibrated."""
    histories = zip(*located, strict=True) if located else ((),) * len(calibrated)
    return tuple(
        _panzoom_track([found and extrapolated(found) for found in by_both_fields(history)]) if one else None
        for one, history in zip(calibrated, histories, strict=True)
    )


def refined(
    track: PanZoomTrack, head: PanZoomCamera, number: int, poses: Sequence[Tracked], missed: Array,
    config: PanZoomConfig,
) -> PanZoomTrack:  # fmt: skip
    """The ``track`` of camera ``number``, whose pictures ``missed`` (F, 2), with what the body has corrected of it."""
    pan_rad, focal_px, covariance = track.pan_rad.copy(), track.focal_px.copy(), track.covariance.copy()
    shared = systematic(config, head, track.pan_rad, track.focal_px) + covariance_of(missed)
    for pose in poses:
        correction = pose.corrections[number] if pose.corrections else None
        if correction is not None:
            pan_rad[pose.frame] += correction.step[0]
            focal_px[pose.frame] *= np.exp(correction.step[1])
            covariance[pose.frame] = shared[pose.frame] + correction.covariance
    return replace(track, pan_rad=pan_rad, focal_px=focal_px, covariance=covariance)
