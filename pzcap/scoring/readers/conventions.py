"""Conventions that files of others leave open: axes, unit, names of joints, number of the first frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.scoring import misreadings
from pzcap.scoring.readers.times import Asked, Points, frames_of
from pzcap.scoring.records import BodyTrack
from pzcap.scoring.tables import LARGEST, nearest, read_table
from pzcap.types import JOINTS, Array, PzcapError

METRES: Final = {"m": 1.0, "meters": 1.0, "cm": 0.01, "centimeters": 0.01, "mm": 0.001, "millimeters": 0.001}
Y_UP: Final = "y,z,x"  # the file's x is our y, its y our z, its z our x: y up, as Pose2Sim writes TRC and pzcap BVH
Z_UP: Final = "x,y,z"
SQUARE: Final = 0.01  # share by which the focal lengths across and down a picture may differ: pixels are square here


@dataclass(frozen=True, slots=True)
class Conventions:
    """Conventions of a file by the command line. None: what is customary for its kind."""

    axes: str | None = None  # our axis along each of the file's, such as "x,z,-y"
    unit: str | None = None  # of METRES
    first_frame: int | None = None  # the frame of the capture that the file begins with
    names: Mapping[str, str] = field(default_factory=dict)  # the file's names of joints -> ours; none: they are ours
    rate: float | None = None  # frames a second; None: as the file says, which has to be the capture's


def joint_names(path: Path) -> dict[str, str]:
    """The table of joint names at ``path``: columns ``theirs`` and ``joint``."""
    names: dict[str, str] = {}
    for row in read_table(path, ("theirs", "joint"), ())[1]:
        theirs, joint = row.cells["theirs"], row.cells["joint"]
        if joint not in JOINTS:
            raise row.wrong(f"no joint '{joint}'; {nearest(joint, JOINTS)}")
        if theirs in names or joint in names.values():
            raise row.wrong(f"'{theirs if theirs in names else joint}' is there twice; give each name once")
        names[theirs] = joint
    if not names:
        raise PzcapError(f"{path}: holds no name; write a row a joint, theirs,joint")
    return names


def axes(text: str) -> Array:
    """(3, 3) the file's coordinates to ours, of a text such as "y,z,x" or "x,z,-y"."""
    parts = [part.strip() for part in text.split(",")]
    if sorted(part[part[:1] in ("+", "-") :] for part in parts) != ["x", "y", "z"]:
        raise PzcapError(f"axes {text}: name our axis along each of the file's, such as y,z,x or x,z,-y")
    turn = misreadings.axes(text)
    if np.linalg.det(turn) < 0.0:
        raise PzcapError(f"axes {text}: these are mirrored; turn the sign of one")
    return turn


def metres(unit: str, path: Path) -> float:
    """Metres to a unit of length."""
    name = unit.strip().lower().replace("metre", "meter")
    name += "s" if name.endswith("meter") else ""
    if name not in METRES:
        what = f"its unit '{unit}' is none of m, cm and mm" if name else "names no unit"
        raise PzcapError(f"{path}: {what}; say --unit m, cm or mm")
    return METRES[name]


def body(path: Path, points: Points, asked: Asked, said: Conventions, customary: str) -> BodyTrack:
    """The joints of a file, in the capture's frames.

    Raises PzcapError if no name is known or one of the table is missing, or for frames that are not the capture's.
    """
    table, index = said.names or {name: name for name in JOINTS}, {name: at for at, name in enumerate(points.names)}
    if not any(points.names):
        raise PzcapError(f"{path}: names no joint; write their names in its header")
    if not set(table) & set(index):
        some = ", ".join(list(points.names)[:4])
        raise PzcapError(f"{path}: none of its joints ({some}, ...) is known; map them with --joints TABLE.csv")
    for theirs in said.names:
        if theirs not in index:
            raise PzcapError(f"{path}: no '{theirs}', which the table of joints names; {nearest(theirs, index)}")
    twice = [theirs for theirs in table if list(points.names).count(theirs) > 1]
    if twice:
        raise PzcapError(f"{path}: names '{twice[0]}' twice; give each joint a name of its own")
    rows, frames = frames_of(path, points, asked, said.first_frame, said.rate)
    joints, valid = np.zeros((asked.frames, len(JOINTS), 3)), np.zeros((asked.frames, len(JOINTS)), bool)
    places = np.where(np.abs(points.places_m[rows]) <= LARGEST, points.places_m[rows], np.nan)
    turned = places @ axes(said.axes or customary).T
    for theirs, ours in table.items():
        if theirs in index:
            joint = JOINTS.index(ours)
            place = turned[:, index[theirs]]
            known = np.all(np.isfinite(place), axis=1)
            joints[frames, joint], valid[frames, joint] = np.where(known[:, None], place, 0.0), known
    return BodyTrack(joints, valid, None, np.zeros(asked.frames, bool), said.axes or customary)


def about(axis: int, angle_rad: Array | float) -> Array:
    """(..., 3, 3) rotations by angles (...) about a coordinate axis."""
    one, two = (axis + 1) % 3, (axis + 2) % 3
    turn = np.tile(np.eye(3), (*np.shape(angle_rad), 1, 1))
    turn[..., one, one] = turn[..., two, two] = np.cos(angle_rad)
    turn[..., two, one], turn[..., one, two] = np.sin(angle_rad), -np.sin(angle_rad)
    return turn
