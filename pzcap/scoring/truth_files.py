"""The truth as it is handed out, version 1: ``truth.json``, ``cameras.csv``, ``joints.csv``, ``frames.csv`` and
``points.csv``. ``cameras.csv`` and ``joints.csv`` are what a perfect method would write. docs/benchmark.md has the
rest."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from pzcap.io.files import write_json
from pzcap.scoring import files
from pzcap.scoring.records import Series, TrueCamera, TrueCapture
from pzcap.scoring.tables import counts, field, read_header, read_table, texts, write_table
from pzcap.types import Array, Mask, PzcapError

FORMAT: Final = "pzcap-truth"
VERSION: Final = 1
HEADER: Final = "truth.json"
FRAMES: Final = "frames.csv"
POINTS: Final = "points.csv"
KEYS: Final = ("name", "image_size", "frame_rate", "cameras", "timecodes", "pan_axes", "keyframes")
BOUND: Final = ("bound_pan", "bound_logf")
_OF_SIMULATOR: Final = "truth.npz"
_FLAGS: Final = ("inverted", "airborne")


def write_truth(truth: TrueCapture, folder: Path) -> None:
    """Write ``truth`` into ``folder``, made where it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    tracks = {name: camera.track for name, camera in zip(truth.camera_names, truth.cameras, strict=True)}
    extra = [_beside(camera, int(f)) for camera in truth.cameras for f in np.flatnonzero(camera.track.valid)]
    rows = ([*row, *more] for row, more in zip(files.camera_rows(tracks), extra, strict=True))
    columns = ("camera", *files.CAMERA_COLUMNS, "recorded", *BOUND)
    write_table(folder / files.CAMERAS, columns, rows)
    files.write_joints(folder / files.BODY, truth.joints_m, np.ones(truth.joints_m.shape[:2], bool), None)
    frames = zip(truth.inverted.tolist(), truth.airborne.tolist(), strict=True)
    write_table(folder / FRAMES, ("frame", *_FLAGS), ([at, *flags] for at, flags in enumerate(frames)))
    points = (
        [name, *point]
        for name, camera in zip(truth.camera_names, truth.cameras, strict=True)
        for point in camera.scene_points_m
    )
    write_table(folder / POINTS, ("camera", *files.POSITION), points)
    header: dict[str, Any] = {
        "format": FORMAT, "version": VERSION, "name": truth.name, "image_size": list(truth.image_size),
        "frame_rate": truth.frame_rate, "cameras": list(truth.camera_names), "timecodes": list(truth.timecodes),
        "pan_axes": {n: c.pan_axis.tolist() for n, c in zip(truth.camera_names, truth.cameras, strict=True)},
        "keyframes": [int(frame) for frame in np.flatnonzero(truth.keyframe)],
    }  # fmt: skip
    write_json(folder / HEADER, header)


def _beside(camera: TrueCamera, frame: int) -> list[object]:
    bounds = (camera.pan_bound_rad, camera.focal_bound)
    return [
        bool(camera.recorded[frame]),
        *(b.values[frame] if b is not None and b.valid[frame] else None for b in bounds),
    ]


def read_truth(folder: Path) -> TrueCapture:
    """Read what `write_truth` wrote. Raises PzcapError, in one line, where it is not one."""
    path = folder / HEADER
    if (folder / _OF_SIMULATOR).is_file() and not (folder / FRAMES).is_file():
        raise PzcapError(
            f"{folder}: this is the simulator's own truth; python -m experiments.plain_truth CAPTURE FOLDER writes one "
            "that can be scored against"
        )
    header = read_header(path, FORMAT, VERSION, KEYS, KEYS)
    names = field(path, header, "cameras", texts, "a list of names")
    timecodes = field(path, header, "timecodes", texts, "a list of timecodes")
    size = field(path, header, "image_size", lambda value: counts(value) and len(value) == 2, "[width, height]")
    axes = {name: np.array(axis, np.float64) for name, axis in _mapping(path, header["pan_axes"]).items()}
    if set(axes) != set(names) or any(axis.shape != (3,) for axis in axes.values()):
        raise PzcapError(f"{path}: pan_axes do not fit the cameras; the truth is damaged, fetch it again")
    count = len(timecodes)
    tracks = files.read_cameras(folder / files.CAMERAS, names, count, ("recorded", *BOUND))
    beside = _read_beside(folder / files.CAMERAS, names, count)
    points: dict[str, list[list[float]]] = {name: [] for name in names}
    for row in read_table(folder / POINTS, ("camera", *files.POSITION), ())[1]:
        points.setdefault(row.cells["camera"], []).append(row.numbers(files.POSITION))
    flags = np.zeros((len(_FLAGS), count), bool)
    for row in read_table(folder / FRAMES, ("frame", *_FLAGS), ())[1]:
        flags[:, row.whole("frame")] = [row.flag(name) for name in _FLAGS]
    keyframe = np.zeros(count, bool)
    keyframe[header["keyframes"]] = True
    joints, given, _ = files.read_joints(folder / files.BODY, count)
    if not given.all() or not all(track.valid.all() for track in tracks):
        raise PzcapError(f"{folder}: some frames are missing; the truth is damaged, fetch it again")
    return TrueCapture(
        name=header["name"],
        image_size=(size[0], size[1]),
        frame_rate=header["frame_rate"],
        timecodes=tuple(timecodes),
        camera_names=tuple(names),
        cameras=tuple(
            TrueCamera(track, beside[name][0], axes[name], np.array(points[name]).reshape(-1, 3), *beside[name][1])
            for name, track in zip(names, tracks, strict=True)
        ),
        joints_m=joints,
        inverted=flags[0],
        airborne=flags[1],
        keyframe=keyframe,
    )


def _mapping(path: Path, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise PzcapError(f"{path}: pan_axes is no object; the truth is damaged, fetch it again")
    return value


def _read_beside(
    path: Path, names: list[str], count: int
) -> dict[str, tuple[Mask, tuple[Series | None, Series | None]]]:
    """Of each camera which frames were recorded (F,), and its bounds where it has any."""
    recorded = {name: np.zeros(count, bool) for name in names}
    bounds: dict[str, Array] = {name: np.full((len(BOUND), count), np.nan) for name in names}
    for row in read_table(path, (), (*("camera", *files.CAMERA_COLUMNS), "recorded", *BOUND))[1]:
        name, frame = row.cells["camera"], row.whole("frame")
        recorded[name][frame] = row.flag("recorded")
        for at, column in enumerate(BOUND):
            if not row.blank([column]):
                bounds[name][at, frame] = row.number(column)
    found: dict[str, tuple[Mask, tuple[Series | None, Series | None]]] = {}
    for name in names:
        series = [
            Series(np.nan_to_num(row), np.isfinite(row)) if np.isfinite(row).any() else None for row in bounds[name]
        ]
        found[name] = recorded[name], (series[0], series[1])
    return found
