"""TRC, the table of marker positions of OpenSim and Pose2Sim."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pzcap.io.files import checked
from pzcap.scoring.readers.conventions import Y_UP, Conventions, body, metres
from pzcap.scoring.readers.times import Asked, Points
from pzcap.scoring.records import BodyTrack
from pzcap.types import PzcapError


def read_trc(path: Path, asked: Asked, said: Conventions) -> BodyTrack:
    """The joints of a TRC file. A blank cell, or NaN, is a joint that is not given."""
    try:
        lines = [line.rstrip("\r") for line in checked(path).read_text(encoding="utf-8-sig").split("\n")]
    except (OSError, UnicodeDecodeError) as error:
        raise PzcapError(f"{path}: cannot be read ({error}); write it again") from error
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise PzcapError(f"{path}: is no TRC file; its first word is PathFileType")
    mark = "\t" if "\t" in lines[2] else None  # between tabs a cell may be blank
    header = dict(zip(lines[1].split(mark), (cell.strip() for cell in lines[2].split(mark)), strict=False))
    names = [name.strip() for name in lines[3].split("\t")[2:] if name.strip()]
    rows: list[list[float]] = []
    numbers: list[int] = []
    for number, line in enumerate(lines[5:], start=6):
        if not line.strip():
            continue  # customary between the names and the numbers; further down a frame without an answer
        if "\t" not in line:
            raise PzcapError(f"{path} line {number}: one cell, '{line[:40]}'; write tabs between numbers")
        first, *cells = line.split("\t")
        del cells[:1]  # the time
        cells += [""] * (3 * len(names) - len(cells))
        if any(cell.strip() for cell in cells[3 * len(names) :]):
            raise PzcapError(
                f"{path} line {number}: {len(cells)} coordinates where line 4 names {len(names)} joints, three "
                "coordinates each; name every joint, tabs between"
            )
        try:
            numbers.append(int(float(first)))
            rows.append([float(cell) if cell.strip() else np.nan for cell in cells[: 3 * len(names)]])
        except (ValueError, OverflowError) as error:
            hint = "points in numbers, not commas" if "," in line else "numbers, tabs between"
            raise PzcapError(f"{path} line {number}: {error}; write {hint}") from error
    scale = metres(said.unit or header.get("Units", ""), path)
    places = scale * np.array(rows).reshape(len(rows), len(names), 3)
    rate = _rate(path, header.get("DataRate", ""))
    return body(path, Points(names, places, rate, np.array(numbers)), asked, said, Y_UP)


def _rate(path: Path, text: str) -> float | None:
    """Frames a second, None where the file does not say."""
    try:
        value = float(text.replace(",", ".") or 0.0)
    except ValueError as error:
        raise PzcapError(f"{path}: DataRate is '{text}'; write the frames a second") from error
    return value if value > 0.0 else None
