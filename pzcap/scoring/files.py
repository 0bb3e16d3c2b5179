"""The format of results, version 1: ``results.json``, ``cameras.csv``, ``joints.csv``. docs/benchmark.md specifies it.

A row is an answer: frames that a method has no answer for have no row, or one with ``valid`` 0. Written and read again,
every number is the same, so that files score as the records in memory do, to the last digit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from pzcap.io.files import write_json
from pzcap.scoring.records import BodyTrack, CameraPoses, CameraTrack, Results
from pzcap.scoring.tables import GUIDE, Row, count, counts, field, nearest, read_header, read_table, texts, write_table
from pzcap.types import JOINTS, Array, Mask, PzcapError

FORMAT: Final = "pzcap-results"
VERSION: Final = 1
HEADER: Final = "results.json"
CAMERAS: Final = "cameras.csv"
BODY: Final = "joints.csv"
KEYS: Final = ("method", "capture", "frames", "timecodes", "image_size", "cameras", "world", "keyframes", "about")
WORLDS: Final = ("capture", "own")

ROTATION: Final = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
POSITION: Final = ("x_m", "y_m", "z_m")
PRINCIPAL: Final = ("cx_px", "cy_px")
DISTORTION: Final = ("k1", "k2", "p1", "p2")
COVARIANCE: Final = ("var_pan", "cov_pan_logf", "var_logf")
POSE: Final = (*ROTATION, *POSITION, *PRINCIPAL)
_ORTHONORMAL: Final = 1e-3


# --------------------------------------------------------------------------------------------------------------
# Reading


def read_results(folder: Path) -> Results:
    """Read a folder of results. Raises PzcapError, in one line, with file and line, where it is not one."""
    path = folder / HEADER
    header = read_header(path, FORMAT, VERSION, KEYS, ("method", "frames"))
    frames = int(field(path, header, "frames", lambda value: count(value) and value > 0, "how many frames there are"))
    names = field(path, header, "cameras", texts, "a list of the cameras' names, each once") or []
    timecodes = field(path, header, "timecodes", texts, "a list of timecodes, each once")
    size = field(path, header, "image_size", lambda v: counts(v) and len(v) == 2, "[width, height] in pixels")
    keyframes = field(path, header, "keyframes", counts, "a list of frames, counted from 0") or []
    for name in ("method", "capture"):
        field(path, header, name, lambda value: isinstance(value, str), "a text")
    world = field(path, header, "world", lambda value: value in WORLDS, "capture, or own") or WORLDS[0]
    if timecodes is not None and len(timecodes) != frames:
        raise PzcapError(f"{path}: {len(timecodes)} timecodes for {frames} frames; give one a frame")
    if any(frame >= frames for frame in keyframes):
        raise PzcapError(f"{path}: keyframe {max(keyframes)} of {frames} frames; frames are counted from 0")
    given = [(folder / name).exists() for name in (CAMERAS, BODY)]
    if not any(given):
        raise PzcapError(f"{folder}: neither {CAMERAS} nor {BODY}; {GUIDE}")
    if given[0] and not names:
        raise PzcapError(f'{path}: no "cameras" beside {CAMERAS}; list the names of those that you were given')
    tracks = read_cameras(folder / CAMERAS, names, frames) if given[0] else (None,) * len(names)
    return Results(
        method=header["method"], capture=header.get("capture", ""), frames=frames,
        timecodes=None if timecodes is None else tuple(timecodes),
        image_size=None if size is None else (size[0], size[1]), camera_names=tuple(names), cameras=tracks,
        body=_read_body(folder / BODY, frames, keyframes) if given[1] else None, own_world=world == "own",
    )  # fmt: skip


def read_cameras(path: Path, names: Sequence[str], frames: int, also: Sequence[str] = ()) -> tuple[CameraTrack, ...]:
    """The tracks of the cameras ``names``; the table may have the columns ``also``, which are others' to read."""
    columns, rows = read_table(
        path, ("camera", "frame", "focal_px"), ("valid", *POSE, *DISTORTION, "pan_rad", *COVARIANCE, *also)
    )
    if "pan_rad" not in columns and not set(POSE) <= set(columns):
        lacking = next(name for name in POSE if name not in columns)
        raise PzcapError(f"{path}: no column '{lacking}'; give the whole pose and lens ({', '.join(POSE)}), or pan_rad")
    if set(POSE) & set(columns) and not set(POSE) <= set(columns):
        lacking = next(name for name in POSE if name not in columns)
        raise PzcapError(f"{path}: no column '{lacking}'; a pose has all of {', '.join(POSE)}")
    if set(COVARIANCE) & set(columns) and not set(COVARIANCE) <= set(columns):
        raise PzcapError(f"{path}: a covariance has all of {', '.join(COVARIANCE)}; add what is missing")
    by_camera: dict[str, dict[int, Row]] = {name: {} for name in names}
    for row, frame in _by_frame(rows, frames):
        name = row.cells["camera"]
        if name not in by_camera:
            raise row.wrong(f"no camera '{name}' in {HEADER}; {nearest(name, names)}")
        if frame in by_camera[name]:
            raise row.wrong(f"camera {name} has frame {frame} twice; give each frame once")
        by_camera[name][frame] = row
    return tuple(_track(by_camera[name], frames, name) for name in names)


def _by_frame(rows: Sequence[Row], frames: int) -> Iterator[tuple[Row, int]]:
    """The rows that are answers, with their frame."""
    numbered = [(row, row.whole("frame")) for row in rows]
    found = [frame for _, frame in numbered]
    if found and max(found) == frames and min(found) >= 1:
        raise PzcapError(f"{rows[0].path}: frames run to {frames} of {frames}; count them from 0, not from 1")
    for row, frame in numbered:
        if not 0 <= frame < frames:
            raise row.wrong(f"frame {row.cells['frame']} of {frames}; frames are counted from 0, as in the capture")
        if row.blank(["valid"]) or row.flag("valid"):
            yield row, frame


def _track(rows: Mapping[int, Row], frames: int, name: str) -> CameraTrack:
    valid, focal = np.zeros(frames, bool), np.ones(frames)
    for frame, row in rows.items():
        focal[frame], valid[frame] = row.number("focal_px"), True
        if focal[frame] <= 0.0:
            raise row.wrong(f"focal_px is {row.cells['focal_px']}; a focal length is above 0, in pixels")
    pose, pan, covariance = (_given(rows, group, name) for group in (POSE, ("pan_rad",), COVARIANCE))
    if rows and not pose and not pan:
        raise next(iter(rows.values())).wrong("neither a pose nor pan_rad; give one of them, or leave the row out")
    return CameraTrack(
        valid, focal, _filled(rows, frames, ("pan_rad",), np.zeros(1))[:, 0] if pan else None,
        _covariances(rows, frames) if covariance else None, _poses(rows, frames) if pose or not rows else None,
    )  # fmt: skip


def _given(rows: Mapping[int, Row], columns: Sequence[str], name: str) -> bool:
    """True where all rows of a camera have these columns filled, False where none has."""
    blank = {row.blank(columns) for row in rows.values()}
    if len(blank) == 2:
        lacking = next(row for row in rows.values() if row.blank(columns))
        raise lacking.wrong(f"{columns[0]} is empty, and is not in other frames of camera {name}; fill in all or none")
    return blank == {False}


def _filled(rows: Mapping[int, Row], frames: int, columns: Sequence[str], default: Array) -> Array:
    """(F, N) numbers of these columns, ``default`` (N,) where there is no row."""
    values = np.tile(default, (frames, 1))
    for frame, row in rows.items():
        values[frame] = row.numbers(columns)
    return values


def _poses(rows: Mapping[int, Row], frames: int) -> CameraPoses:
    rotation = _filled(rows, frames, ROTATION, np.eye(3).ravel()).reshape(-1, 3, 3)
    skew = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    mirrored = np.linalg.det(rotation) < 0.0
    for frame, row in rows.items():
        if skew[frame] > _ORTHONORMAL:
            raise row.wrong(f"r11 to r33 are no rotation (off by {skew[frame]:.2g}); rows of R, camera to world")
        if mirrored[frame]:
            raise row.wrong("r11 to r33 are mirrored (determinant -1); camera and world axes are right-handed")
    distortion = np.zeros((frames, len(DISTORTION)))
    for at, column in enumerate(DISTORTION):
        for frame, row in rows.items():
            distortion[frame, at] = 0.0 if row.blank([column]) else row.number(column)
    return CameraPoses(
        rotation,
        _filled(rows, frames, POSITION, np.zeros(3)),
        _filled(rows, frames, PRINCIPAL, np.zeros(2)),
        distortion,
    )


def _covariances(rows: Mapping[int, Row], frames: int) -> Array:
    pan, cross, focal = _filled(rows, frames, COVARIANCE, np.zeros(3)).T
    for frame, row in rows.items():
        if pan[frame] < 0.0 or focal[frame] < 0.0 or cross[frame] ** 2 > pan[frame] * focal[frame] * (1 + 1e-9):
            raise row.wrong("var_pan, cov_pan_logf, var_logf are no covariance; variances are not negative, and "
                            "cov^2 is not above their product")  # fmt: skip
    return np.stack([pan, cross, cross, focal], axis=-1).reshape(-1, 2, 2)


def _read_body(path: Path, frames: int, keyframes: Sequence[int]) -> BodyTrack:
    joints, valid, sigma = read_joints(path, frames)
    keyframe = np.zeros(frames, bool)
    keyframe[list(keyframes)] = True
    return BodyTrack(joints, valid, sigma, keyframe)


def read_joints(path: Path, frames: int) -> tuple[Array, Mask, Array | None]:
    """Joints (F, 16, 3), which of them are given (F, 16), and their sigma (F, 16) where the table has any."""
    columns, rows = read_table(path, ("frame", "joint", *POSITION), ("valid", "sigma_m"))
    joints, valid = np.zeros((frames, len(JOINTS), 3)), np.zeros((frames, len(JOINTS)), bool)
    sigma = np.zeros((frames, len(JOINTS)))
    index = {name: number for number, name in enumerate(JOINTS)}
    for row, frame in _by_frame(rows, frames):
        name = row.cells["joint"]
        if name not in index:
            raise row.wrong(f"no joint '{name}'; {nearest(name, JOINTS)}")
        at = frame, index[name]
        if valid[at]:
            raise row.wrong(f"frame {frame} has {name} twice; give each joint once a frame")
        joints[at], valid[at] = row.numbers(POSITION), True
        if "sigma_m" in columns:
            sigma[at] = row.number("sigma_m")
            if sigma[at] < 0.0:
                raise row.wrong(f"sigma_m is {row.cells['sigma_m']}; a standard deviation is not negative")
    return joints, valid, sigma if "sigma_m" in columns else None


# --------------------------------------------------------------------------------------------------------------
# Writing


def write_results(results: Results, folder: Path, about: Mapping[str, Any] | None = None) -> None:
    """Write ``results`` into ``folder``, made where it is missing; ``about`` is anything worth knowing beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (HEADER, CAMERAS, BODY):
        (folder / name).unlink(missing_ok=True)
    header: dict[str, Any] = {
        "format": FORMAT, "version": VERSION, "method": results.method, "capture": results.capture,
        "frames": results.frames, "cameras": list(results.camera_names),
    }  # fmt: skip
    if results.timecodes is not None:
        header["timecodes"] = list(results.timecodes)
    if results.image_size is not None:
        header["image_size"] = list(results.image_size)
    if results.body is not None:
        header["keyframes"] = [int(frame) for frame in np.flatnonzero(results.body.keyframe)]
        write_joints(folder / BODY, results.body.joints_m, results.body.valid, results.body.sigma_m)
    if results.own_world:
        header["world"] = WORLDS[1]
    if about is not None:
        header["about"] = dict(about)
    tracks = {
        name: track for name, track in zip(results.camera_names, results.cameras, strict=True) if track is not None
    }
    if tracks or results.body is None:  # a table without a row: asked for, and nothing found
        write_table(folder / CAMERAS, ("camera", *CAMERA_COLUMNS), camera_rows(tracks))
    write_json(folder / HEADER, header)


CAMERA_COLUMNS: Final = ("frame", "focal_px", *POSE, *DISTORTION, "pan_rad", *COVARIANCE)


def camera_rows(tracks: Mapping[str, CameraTrack]) -> Iterator[list[object]]:
    """The rows of ``cameras.csv``, ``camera`` and ``CAMERA_COLUMNS``: a row a valid frame."""
    for name, track in tracks.items():
        for frame in np.flatnonzero(track.valid):
            poses, covariance = track.poses, track.covariance
            row: list[object] = [name, int(frame), track.focal_px[frame]]
            if poses is None:
                row += [None] * (len(POSE) + len(DISTORTION))
            else:
                row += [*poses.rotation[frame].ravel(), *poses.position_m[frame], *poses.principal_px[frame]]
                row += [*poses.distortion[frame]]
            row.append(None if track.pan_rad is None else track.pan_rad[frame])
            row += [None] * 3 if covariance is None else [*covariance[frame].ravel()[[0, 1, 3]]]
            yield row


def write_joints(path: Path, joints_m: Array, valid: Mask, sigma_m: Array | None) -> None:
    """Write ``joints.csv``: a row a joint that is given."""
    places = np.argwhere(valid).tolist()
    columns = ("frame", "joint", *POSITION) if sigma_m is None else ("frame", "joint", *POSITION, "sigma_m")
    write_table(
        path,
        columns,
        (
            [frame, JOINTS[joint], *joints_m[frame, joint], *([] if sigma_m is None else [sigma_m[frame, joint]])]
            for frame, joint in places
        ),
    )
