"""SoccerNet's camera JSON: ``CAMERA/camera_00012.json``, a file a camera and frame.

Its world has z down: x is ours, y and z are turned. Orientation is Rz(pan) Rx(tilt) Rz(roll), camera to world; tilt 90
looks along the horizon.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from pzcap.io.files import checked
from pzcap.scoring.readers.conventions import SQUARE, about
from pzcap.scoring.readers.instants import Instant, tracks
from pzcap.scoring.records import CameraTrack
from pzcap.types import Array, PzcapError

NAME: Final = re.compile(r"camera_(\d+)\.json")
WORLD: Final = np.diag([1.0, -1.0, -1.0])


def is_soccernet(folder: Path) -> bool:
    """True where a folder in ``folder`` holds such files."""
    return any(NAME.fullmatch(path.name) for path in folder.glob("*/camera_*.json"))


def read_soccernet(folder: Path, names: Sequence[str], frames: int) -> tuple[CameraTrack | None, ...]:
    """The tracks of the cameras ``names``, each of which has a folder."""
    found = {}
    for path in sorted(folder.glob("*/camera_*.json")):
        match = NAME.fullmatch(path.name)
        if match is None:
            continue
        if path.parent.name not in names:
            raise PzcapError(f"{path}: no camera '{path.parent.name}'; there are {', '.join(names)}")
        found[path.parent.name, int(match[1])] = _instant(path)
    return tracks(found, names, frames, folder)


def _instant(path: Path) -> Instant:
    try:
        values = json.loads(checked(path).read_text(encoding="utf-8"))
        pan, tilt, roll = (np.deg2rad(float(values[f"{name}_degrees"])) for name in ("pan", "tilt", "roll"))
        focal = float(values["x_focal_length"]), float(values["y_focal_length"])
        place, principal = _vector(values, "position_meters", 3), _vector(values, "principal_point", 2)
        radial, tangential = _vector(values, "radial_distortion", 6), _vector(values, "tangential_distortion", 2)
        prism = _vector(values, "thin_prism_distortion", 4)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise PzcapError(f"{path}: is no camera of SoccerNet's ({error}); write it again") from error
    if np.any(radial[2:]) or np.any(prism):
        raise PzcapError(f"{path}: has distortion beyond k1, k2 and tangential; write those alone")
    if focal[0] <= 0.0 or abs(focal[0] / focal[1] - 1.0) > SQUARE:
        raise PzcapError(f"{path}: focal lengths {focal[0]:.6g} and {focal[1]:.6g}; they are equal and above 0 here")
    rotation = WORLD @ about(2, pan) @ about(0, tilt) @ about(2, roll)
    distortion = np.array([*radial[:2], *tangential])
    return Instant(rotation, WORLD @ place, 0.5 * (focal[0] + focal[1]), principal, distortion)


def _vector(values: dict[str, Any], name: str, count: int) -> Array:
    vector = np.array(values[name], np.float64)
    if vector.shape != (count,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} are not {count} finite numbers")
    return vector
