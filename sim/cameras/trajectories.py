"""Trajectories from a CSV file: pan, tilt and focal length of every camera over time."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TextIO

import numpy as np
from scipy.interpolate import PchipInterpolator

from pzcap.io.files import checked
from pzcap.types import Array, PzcapError
from sim.cameras.operator import Trajectory
from sim.cameras.optics import Rig

_CLOCKS: Final = ("time_s", "frame")
_REQUIRED: Final = ("camera", "pan_deg", "focal_px")
_COLUMNS: Final = (*_REQUIRED, *_CLOCKS, "tilt_deg")
_LARGEST_STEP_DEG: Final = 180.0
_ROUNDING: Final = 1e-3  # share of a focal length


@dataclass(frozen=True, slots=True)
class _Row:
    line: int
    time_s: float
    pan_deg: float
    raised_deg: float
    focal_px: float


def read_trajectories(path: Path, rigs: Mapping[str, Rig], frame_rate: float, end_s: float) -> list[Trajectory]:
    """Read the trajectory of each rig, by the camera's name, from time 0 to ``end_s``.

    It is interpolated without overshoot between the rows, and constant before the first and after the last.
    Raises PzcapError, with the line, where the table does not say what it should.
    """
    rows, tilts = _read(path, rigs, frame_rate)
    trajectories = []
    for name, rig in rigs.items():
        own = rows[name]
        if not own or own[0].time_s > 0.5 / frame_rate or own[-1].time_s < end_s - 0.5 / frame_rate:
            covered = f"{own[0].time_s:.3f} to {own[-1].time_s:.3f} s" if own else "nothing"
            raise PzcapError(f"{path}: camera {name} has {covered}; it films from 0 to {end_s:.3f} s")
        values = np.array([(row.time_s, row.pan_deg, row.raised_deg, row.focal_px) for row in own])
        trajectories.append(_trajectory(values, rig, tilts))
    return trajectories


def _trajectory(values: Array, rig: Rig, tilts: bool) -> Trajectory:
    """Trajectory through rows (N, 4) of time (s), pan, tilt (degrees) and focal length (px)."""
    still = values[[0, *range(len(values)), -1]]
    still[[0, -1], 0] += (-1.0, 1.0)
    pan, raised = (PchipInterpolator(still[:, 0], np.deg2rad(still[:, k])) for k in (1, 2))
    focal_px = np.clip(still[:, 3], *_lens_px(rig))
    return Trajectory(pan, PchipInterpolator(still[:, 0], np.log(focal_px)), raised if tilts else None)


def _lens_px(rig: Rig) -> tuple[float, float]:
    low, high = rig.config.zoom_min, rig.config.zoom_max
    return rig.reference_focal_px * low, rig.reference_focal_px * high


def _read(path: Path, rigs: Mapping[str, Rig], frame_rate: float) -> tuple[dict[str, list[_Row]], bool]:
    """The rows of each camera, and whether the table has the tilt."""
    rows: dict[str, list[_Row]] = {name: [] for name in rigs}
    try:
        with checked(path).open(encoding="utf-8-sig", newline="") as file:
            table = _cells(file)
            columns = _columns(path, *next(table, (1, [])))
            for line, cells in table:
                where = f"{path}: line {line}"
                if len(cells) != len(columns):
                    raise PzcapError(f"{where}: {len(cells)} values where {len(columns)} belong")
                _add(rows, dict(zip(columns, cells, strict=True)), rigs, frame_rate, where, line)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a table of text"
        raise PzcapError(f"{path}: cannot read the trajectories: {reason}") from error
    return rows, "tilt_deg" in columns


def _cells(file: TextIO) -> Iterator[tuple[int, list[str]]]:
    """The lines that hold something, with their numbers; lines that begin with # are remarks.

    What separates the cells is told by the first: a comma, a tab, or a semicolon, as spreadsheets write it where the
    comma stands before decimals. Cells that are empty at the end of a line belong to no column.
    """
    separator = ""
    for number, line in enumerate(file, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        separator = separator or next((sign for sign in ";\t" if sign in line), ",")
        cells = [cell.strip() for row in csv.reader([line], delimiter=separator) for cell in row]
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            yield number, [cell if separator == "," else cell.replace(",", ".") for cell in cells]


def _columns(path: Path, line: int, columns: list[str]) -> list[str]:
    clocks = [name for name in columns if name in _CLOCKS]
    if len(clocks) != 1 or not set(_REQUIRED) < set(columns) <= set(_COLUMNS) or len(set(columns)) < len(columns):
        raise PzcapError(
            f"{path}: line {line}: the columns must be camera, time_s or frame, pan_deg, focal_px, and tilt_deg if the "
            f"cameras tilt; they are {', '.join(columns) or 'missing'}"
        )
    return columns


def _add(
    rows: dict[str, list[_Row]],
    cells: dict[str, str],
    rigs: Mapping[str, Rig],
    frame_rate: float,
    where: str,
    line: int,
) -> None:
    """Check a row and append it to its camera's."""
    name = cells.pop("camera")
    name = name if name in rigs else name.removesuffix(".0")  # a spreadsheet's number
    if name not in rigs:
        raise PzcapError(f"{where}: there is no camera '{name}'; there are {', '.join(rigs)}")
    value = {column: _number(cell, column, where) for column, cell in cells.items()}
    time_s = value["time_s"] if "time_s" in value else value["frame"] / frame_rate
    row = _Row(line, time_s, value["pan_deg"], value.get("tilt_deg", 0.0), value["focal_px"])
    low, high = _lens_px(rigs[name])
    if not low * (1 - _ROUNDING) <= row.focal_px <= high * (1 + _ROUNDING):
        raise PzcapError(f"{where}: focal_px is {row.focal_px:g}; the lens goes from {low:g} to {high:g}")
    if rows[name]:
        before = rows[name][-1]
        if row.time_s <= before.time_s:
            raise PzcapError(f"{where}: camera {name} goes back in time, or stands still, since line {before.line}")
        if abs(row.pan_deg - before.pan_deg) > _LARGEST_STEP_DEG:
            raise PzcapError(
                f"{where}: pan_deg jumps by {row.pan_deg - before.pan_deg:g} since line {before.line}; let it go on "
                "beyond 180 degrees"
            )
    rows[name].append(row)


def _number(cell: str, column: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError as error:
        raise PzcapError(f"{where}: {column} is '{cell}', which is no number") from error
    if not math.isfinite(value):
        raise PzcapError(f"{where}: {column} is '{cell}'; it must be finite")
    return value
