"""Pictures of an entry's worst frames, and a recording of its worst capture: what the figures look like."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from experiments.report.pictures import draw_dots, draw_strips
from pzcap.io.capture import frame_sets, read_capture
from pzcap.scoring.projection import inside, project
from pzcap.scoring.records import CameraTrack, Results, TrueCapture, matched
from pzcap.scoring.score import score
from pzcap.types import PARENTS, Array, Camera, Image, Mask
from pzcap.viewer import columns
from pzcap.viewer.drawing import CAMERA_COLOURS, TRUTH_COLOUR, Colour

FOUND_COLOUR: Final[Colour] = (255, 120, 40)
MAGNIFIED: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
ARROW_PX: Final = 25.0
"""Errors are drawn so much larger that the median arrow is about this long."""
POINTS: Final = 120
CROP: Final = 1.5  # of the body's size
HEIGHT: Final = 380  # of a picture of the body, px, at least
QUALITY: Final = 82
BONES: Final = tuple((child, parent) for child, parent in enumerate(PARENTS) if parent >= 0)


def frame_image(capture: Path, camera: str, frame: int) -> Image | None:
    """The view of one camera in one frame set."""
    footage = read_capture(capture)
    index = [files.name for files in footage.cameras].index(camera)
    for views in frame_sets(footage):
        if views.index == frame:
            return views.images[index]
    return None


def picture(image: Image, results: Results, truth: TrueCapture, camera: str, frame: int, *, body: bool) -> Image:
    """A view with what is true in white and what was found in orange; of cameras the errors, magnified."""
    shown = image.copy()
    frames, _ = matched(results, truth)
    at = int(np.flatnonzero(frames == frame)[0])
    true = truth.cameras[truth.camera_names.index(camera)]
    if body and results.body is not None:
        return _body(shown, true.track, truth.joints_m[frame], results.body.joints_m[at], results.body.valid[at], frame)
    track = results.cameras[results.camera_names.index(camera)]
    if track is None or track.poses is None or true.track.poses is None or results.own_world:
        return shown
    points = true.scene_points_m
    seen, visible = project(true.track.poses, float(true.track.focal_px[frame]), frame, points)
    found, there = project(track.poses, float(track.focal_px[at]), at, points)
    which = np.flatnonzero(visible & there & inside(seen, truth.image_size))
    which = which[:: max(1, len(which) // POINTS)]
    if not len(which):
        return shown
    apart = found[which] - seen[which]
    middle = max(float(np.median(np.linalg.norm(apart, axis=1))), 1e-9)
    factor = min(MAGNIFIED, key=lambda f: abs(np.log(f * middle / ARROW_PX)))
    draw_strips(
        shown, [np.array([p, p + factor * d]) for p, d in zip(seen[which], apart, strict=True)], FOUND_COLOUR, 2
    )
    draw_dots(shown, seen[which], TRUTH_COLOUR, 2.0)
    _write(shown, f"errors x {factor}")
    return shown


def _body(image: Image, camera: CameraTrack, true_m: Array, found_m: Array, given: Mask, frame: int) -> Image:
    assert camera.poses is not None
    focal = float(camera.focal_px[frame])
    true, seen = project(camera.poses, focal, frame, true_m)
    found, visible = project(camera.poses, focal, frame, found_m)
    middle = true.mean(axis=0)
    half = max(40.0, 0.5 * CROP * float(np.ptp(true, axis=0).max()))
    height, width = image.shape[:2]
    x0, x1 = (int(np.clip(v, 0, width)) for v in (middle[0] - half, middle[0] + half))
    y0, y1 = (int(np.clip(v, 0, height)) for v in (middle[1] - half, middle[1] + half))
    if min(x1 - x0, y1 - y0) < 40:  # the athlete is out of this view
        x0, y0, x1, y1 = 0, 0, width, height
    scale = max(1.0, HEIGHT / (y1 - y0))
    shown = np.asarray(
        cv2.resize(image[y0:y1, x0:x1], None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8
    )
    for pixels, known, colour in ((true, seen, TRUTH_COLOUR), (found, visible & given, FOUND_COLOUR)):
        here = scale * (pixels - [x0, y0] + 0.5) - 0.5
        bones = [here[[near, far]] for near, far in BONES if known[near] and known[far]]
        draw_strips(shown, [bone for bone in bones if np.abs(bone).max() < 1e4], colour, 2)
    return shown


def _write(image: Image, text: str) -> None:
    for colour, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(
            image, text, (8, image.shape[0] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, thickness, cv2.LINE_AA
        )


def save_picture(path: Path, image: Image) -> None:
    """Write a JPEG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]))


def record(path: Path, results: Results, truth: TrueCapture, label: str, means: Mapping[str, Any]) -> None:
    """Write a recording for the Rerun viewer: cameras and joints, true and found, and the errors over time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rec = rr.RecordingStream("pzcap-board", recording_id=str(uuid.uuid4()))
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    rec.save(path)
    rec.send_recording_name(columns.plain(f"{label}, {truth.name}"))
    rec.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    errors = score(results, truth)
    frames = errors.truth_frames
    for number, name in enumerate(results.camera_names):
        true, track = truth.cameras[truth.camera_names.index(name)], results.cameras[number]
        colour = CAMERA_COLOURS[number % len(CAMERA_COLOURS)]
        focal = float(np.median(true.track.focal_px))
        everywhere = np.ones(len(frames), bool)
        columns.send_cameras(rec, "/truth", name, _cameras(true.track, truth, frames, everywhere), focal, TRUTH_COLOUR)
        if track is not None and track.poses is not None and not results.own_world:
            at = np.arange(len(frames), dtype=np.int64)
            columns.send_cameras(rec, "/world", name, _cameras(track, truth, at, track.valid), focal, colour)
        one, part = errors.cameras[number], columns.path_part(name)
        for kind, series, scale, unit in (
            ("pan", one.pan_rad, np.degrees(1.0), "deg"), ("focal", one.focal, 100.0, "%"),
            ("reprojection", one.reprojection_px, 1.0, "px"), ("rotation", one.common_rad, np.degrees(1.0), "deg"),
        ):  # fmt: skip
            if series is not None:
                label_of = f"{kind} {columns.plain(name)} [{unit}]"
                columns.send_series(rec, f"/error/{kind}/{part}", scale * series.values, series.valid, colour, label_of)
    _send_bones(rec, "/truth/body", truth.joints_m[frames], np.ones((len(frames), len(PARENTS)), bool), TRUTH_COLOUR)
    if results.body is not None and errors.body is not None:
        _send_bones(rec, "/world/body", results.body.joints_m, results.body.valid, FOUND_COLOUR)
        mean = 1000.0 * errors.body.joints_m.mean(axis=1)
        columns.send_series(rec, "/error/mpjpe", mean, errors.body.scored, FOUND_COLOUR, "MPJPE [mm]")
    rows = "".join(f"| {key} | {value:.6g} |\n" for key, value in means.items() if value is not None)
    rec.log(
        "/summary", rr.TextDocument(f"| metric | mean |\n|---|---|\n{rows}", media_type="text/markdown"), static=True
    )
    rec.disconnect()


def _cameras(track: CameraTrack, truth: TrueCapture, at: NDArray[np.int64], valid: Mask) -> list[Camera | None]:
    poses = track.poses
    assert poses is not None
    found: list[Camera | None] = []
    for frame, known in zip(at.tolist(), valid.tolist(), strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = poses.rotation[frame], poses.position_m[frame]
        bent = poses.distortion[frame].tolist()
        camera = Camera(*truth.image_size, pose, float(track.focal_px[frame]), poses.principal_px[frame], *bent)
        found.append(camera if known else None)
    return found


def _send_bones(rec: rr.RecordingStream, path: str, joints_m: Array, valid: Mask, colour: Colour) -> None:
    for frame in range(len(joints_m)):
        rec.set_time(columns.TIMELINE, sequence=frame)
        bones: Sequence[Array] = [joints_m[frame][[a, b]] for a, b in BONES if valid[frame, a] and valid[frame, b]]
        rec.log(path, rr.LineStrips3D(bones, colors=colour, radii=0.008))
    rec.reset_time()
