"""The whole check of a capture folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.body import skeleton
from pzcap.camera_set import what_is_lacking
from pzcap.command.check import forecast
from pzcap.command.check.body_check import check_body
from pzcap.command.check.findings import Finding, Level, worst
from pzcap.command.check.forecast import Shutter
from pzcap.command.check.motion_check import (
    Places,
    check_belonging,
    check_light,
    check_ranges,
    check_shutter,
    check_tilt,
    place,
    samples,
)
from pzcap.command.check.page import Pictures, write_page
from pzcap.command.check.reference_check import Reference, check_reference
from pzcap.command.check.sweep_check import Sweep, check_sweep
from pzcap.command.check.zoom_check import ZoomRun, check_zoom
from pzcap.command.progress import ProgressLine
from pzcap.io.capture import frame_sets, read_capture, read_image
from pzcap.io.video import VideoReader
from pzcap.plausibility import contradictory_readings
from pzcap.progress import Report
from pzcap.runtime import one_thread_each
from pzcap.types import CameraFiles, Capture, PzcapError

_SAME_PLACE_M: Final = 0.5
_OBJECT: Final = "no calibration object (object.json): no camera can be placed"


@dataclass(frozen=True, slots=True, eq=False)
class Hall:
    """Recordings of a camera before the motion."""

    reference: Reference | None
    sweep: Sweep | None
    zoom: ZoomRun
    findings: tuple[Finding, ...]
    reference_rad: float = 0.0  # angle of the reference pose on the sweep


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of a camera."""

    places: Places
    shutter: Shutter


def check_folder(folder: Path, page: Path) -> int:
    """Check the capture in ``folder``, write the ``page``, print what was found; the exit status, 1 where something has
    to be shot again."""
    capture = read_capture(folder)
    with ProgressLine() as line:
        checked = check_capture(capture, line.update)
    order = list(Level)
    for finding in sorted(checked.findings, key=lambda each: -order.index(each.level)):
        print(finding.line())
    page.parent.mkdir(parents=True, exist_ok=True)
    write_page(page, f"Check of {capture.name}", checked.findings, checked.pictures)
    print(page)
    return int(worst(checked.findings) is Level.FAIL)


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """Result of a check."""

    findings: list[Finding]
    pictures: dict[str, Pictures]  # of the page, by camera
    forecast: forecast.Forecast


def check_capture(capture: Capture, report: Report) -> Checked:
    """Check a capture. ``report(stage, done, total)`` hears of the progress."""
    halls: dict[str, Hall] = {}
    motions: dict[str, tuple[Motion | None, list[Finding]]] = {}
    total = 2 * len(capture.cameras)
    with one_thread_each(), ThreadPoolExecutor(2) as pool:
        for files, hall in zip(
            capture.cameras, pool.map(lambda files: _empty_hall(capture, files), capture.cameras), strict=True
        ):
            halls[files.name] = hall
            report(f"still, sweep and zoom run of camera {files.name}", len(halls), total)
        for files, motion in zip(
            capture.cameras, pool.map(lambda files: _motion(capture, files, halls), capture.cameras), strict=True
        ):
            motions[files.name] = motion
            report(f"motion of camera {files.name}", len(halls) + len(motions), total)
    findings, pictures = list(_together(capture, halls)), {}
    fit = {name: motion for name, (motion, own) in motions.items() if motion is not None and _fits(own)}
    expected = _forecast(capture, halls, fit)
    findings += forecast.findings(expected)
    fitting = {name: halls[name] for name in fit}
    findings += check_body(
        capture,
        {name: hall.reference for name, hall in fitting.items() if hall.reference is not None},
        {name: hall.sweep for name, hall in fitting.items() if hall.sweep is not None},
        {name: hall.reference_rad for name, hall in fitting.items()},
    )
    for name, hall in halls.items():
        shown, own = motions[name]
        findings += [*hall.findings, *own]
        pictures[name] = Pictures(hall.reference, hall.sweep, None if shown is None else shown.places)
    return Checked(findings, pictures, expected)


def _fits(findings: Sequence[Finding]) -> bool:
    return all(finding.level is not Level.FAIL for finding in findings)


def _forecast(capture: Capture, halls: Mapping[str, Hall], motions: Mapping[str, Motion]) -> forecast.Forecast:
    """Accuracy to expect of the cameras whose files fit each other, and of the body."""
    found: dict[str, forecast.CameraForecast] = {}
    roots = [pose.root_position_m for pose in capture.keyframe_poses.values()]
    for name, motion in motions.items():
        hall, places = halls[name], motion.places
        if hall.sweep is None or not places.found.any():
            continue
        if hall.reference is not None and hall.reference.camera is not None:
            camera = hall.reference.camera.camera
            there = np.mean(roots, axis=0) if roots else hall.reference.camera.points_m.mean(axis=0)
            distance_m = float(np.linalg.norm(there - camera.world_T_cam[:3, 3]))
        elif capture.calibration_object is None and what_is_lacking(capture) is None:
            distance_m = None
        else:
            continue
        focal_px = hall.sweep.focal * places.images[0].shape[1]
        kept = np.flatnonzero(places.found)
        scales = 1.0 / np.array([places.relations[k].scale for k in kept])
        found[name] = forecast.forecast_camera(
            images=[places.images[k] for k in kept], focal_px=focal_px * scales,
            pan_rad=places.angles_rad[kept] - hall.reference_rad, distance_m=distance_m, reference_px=focal_px,
            span_rad=None if capture.full_turn else hall.sweep.span_rad, zoomed=hall.zoom.widest is not None,
            shutter=motion.shutter,
        )  # fmt: skip
    keyframe_s, loose_m = None, 0.0
    if roots and capture.subject is not None:
        with suppress(PzcapError):  # it has been said
            loose_m = float(skeleton.build(capture.subject).loose_m.mean())
            keyframe_s = len(frame_sets(capture)) / float(capture.frame_rate) / max(len(roots) - 1, 1)
    return forecast.Forecast(found, keyframe_s, loose_m)


def _empty_hall(capture: Capture, files: CameraFiles) -> Hall:
    """Reference image, sweep and zoom run of one camera."""
    findings: list[Finding] = []
    reference, sweep, zoom = None, None, ZoomRun(None, None)
    if files.reference is None and capture.calibration_object is not None:
        findings.append(Finding(Level.FAIL, files.name, "reference", "there is none; the camera cannot be placed"))
    elif files.reference is not None:
        reference, found = check_reference(files.name, read_image(files.reference), capture.calibration_object)
        findings += found
    if files.sweep is None:
        findings.append(Finding(Level.FAIL, files.name, "sweep", "there is none; no frame can be located"))
    else:
        focal, image = (None, None) if reference is None else (reference.focal, reference.image)
        sweep, found = check_sweep(files.name, files.sweep, focal, capture.full_turn, image)
        findings += found
    if files.zoom is None:
        text = "there is none; distortion and principal point are less certain over the zoom range"
        findings.append(Finding(Level.WARN, files.name, "zoom", text))
    elif sweep is not None:
        zoom, found = check_zoom(files.name, files.zoom, sweep)
        findings += found
    at = 0.0
    if reference is not None and sweep is not None:
        at = float(place([reference.image], sweep).angles_rad[0])
    return Hall(reference, sweep, zoom, tuple(findings), at)


def _motion(capture: Capture, files: CameraFiles, halls: Mapping[str, Hall]) -> tuple[Motion | None, list[Finding]]:
    """Reference image and motion of one camera against the sweeps of all."""
    hall = halls[files.name]
    sweeps = {name: each.sweep for name, each in halls.items() if each.sweep is not None}
    if hall.sweep is None:
        return None, []
    findings: list[Finding] = []
    if hall.reference is not None:
        places, found = check_belonging(files.name, "reference", [hall.reference.image], sweeps)
        findings += [*found, *check_tilt(files.name, "reference", places, hall.sweep)]
    if files.zoom is not None:
        _, found = check_belonging(files.name, "zoom", samples(files.zoom, 5), sweeps)
        findings += [each for each in found if "swapped" in each.text]  # else `check_zoom` has said what there is
    if files.motion is None:
        return None, [*findings, Finding(Level.WARN, files.name, "motion", "there is none")]
    places, found = check_belonging(files.name, "motion", samples(files.motion), sweeps)
    findings += found
    if found[0].level is not Level.FAIL:
        findings += check_tilt(files.name, "motion", places, hall.sweep)
        findings += check_ranges(files.name, places, hall.sweep, hall.zoom, capture.full_turn)
        findings += check_light(files.name, places, hall.sweep)
    shutter, found = check_shutter(files.name, files.motion)
    return Motion(places, shutter), [*findings, *found]


def _together(capture: Capture, halls: Mapping[str, Hall]) -> Iterator[Finding]:
    """Synchronisation, what the capture lacks, and cameras against each other."""
    try:
        sets = frame_sets(capture)
    except PzcapError as error:
        yield Finding(Level.FAIL, "", "sync", str(error))
    else:
        seconds = len(sets) / float(capture.frame_rate)
        text = f"{len(sets)} frame sets in common, {seconds:.1f} s, {sets.timecodes[0]} to {sets.timecodes[-1]}"
        level = Level.OK if seconds >= 1.0 else Level.WARN
        if capture.sync is not None:
            worst_s = max(clock.sigma_s for clock in capture.sync.values())
            ways = sorted({clock.by for clock in capture.sync.values()})
            text += f"; without timecode, by {' and '.join(ways)} to {1000.0 * worst_s:.0f} ms"
            level = Level.WARN if worst_s * float(capture.frame_rate) > 0.5 else level
        yield Finding(level, "", "sync", text)
        if not sets.keyframes and not any(camera.keypoints for camera in capture.cameras):
            text = "there are none yet, nor keypoints: the body is tracked from either"
            yield Finding(Level.WARN, "", "keyframes", text)
    if capture.calibration_object is None:
        lacking = what_is_lacking(capture)
        yardstick = "the lengths of lengths.json" if capture.lengths else "stature"
        text = f"none: the athlete's keypoints and {yardstick} have to place the cameras, whose heads must be level"
        level = Level.WARN if capture.full_turn else Level.FAIL  # all else that may be lacking is made at home
        yield Finding(level, "", "object", f"{_OBJECT}: {lacking}" if lacking else text)
    if capture.subject is None:
        yield Finding(
            Level.WARN, "", "subject", "no tape measurements (subject.json) yet: measure before the athlete goes"
        )
    else:
        for note in contradictory_readings(capture.subject):
            yield Finding(Level.WARN, "", "subject", note)
    for files in capture.cameras:
        if files.motion is not None:
            reader = VideoReader(files.motion)
            indices = reader.indices
            if not reader.constant_rate:
                text = "its frame rate varies: each frame set gets the picture nearest in time; film at a constant rate"
                yield Finding(Level.WARN, files.name, "motion", text)
            missing = int(indices[-1] - indices[0]) + 1 - len(indices)
            if missing:
                share = missing / (len(indices) + missing)
                text = f"{missing} frames were dropped ({100 * share:.1f} %)"
                yield Finding(Level.FAIL if share > 0.05 else Level.WARN, files.name, "motion", text)
    places = {
        name: hall.reference.camera.camera.world_T_cam[:3, 3]
        for name, hall in halls.items()
        if hall.reference is not None and hall.reference.camera is not None
    }
    for one, other in combinations(places, 2):
        apart = float(np.linalg.norm(places[one] - places[other]))
        if apart < _SAME_PLACE_M:
            text = f"cameras {one} and {other} stand {apart:.2f} m from each other; is one file there twice?"
            yield Finding(Level.FAIL, "", "reference", text)
