"""C3D, by ezc3d, which is needed for nothing else: `pip install ezc3d`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pzcap.io.files import checked
from pzcap.scoring.readers.conventions import Z_UP, Conventions, body, metres
from pzcap.scoring.readers.times import Asked, Points
from pzcap.scoring.records import BodyTrack
from pzcap.types import PzcapError


def read_c3d(path: Path, asked: Asked, said: Conventions) -> BodyTrack:
    """The points of a C3D file. One with a negative residual, or NaN, is not given."""
    try:
        import ezc3d
    except ImportError as error:
        raise PzcapError(f"{path}: C3D is read by ezc3d; pip install ezc3d") from error
    try:
        file = ezc3d.c3d(str(checked(path)))
    except (OSError, RuntimeError, ValueError) as error:
        raise PzcapError(f"{path}: is no C3D file ({error}); write it again") from error
    points = file["data"]["points"]  # (4, N, T)
    residuals = file["data"]["meta_points"]["residuals"][0]
    places = np.where(residuals[None] < 0.0, np.nan, points[:3]).transpose(2, 1, 0)
    parameters = file["parameters"]["POINT"]
    unit = said.unit or "".join(parameters["UNITS"]["value"][:1])
    first, rate = file["header"]["points"]["first_frame"], [float(value) for value in parameters["RATE"]["value"][:1]]
    numbers = np.arange(len(places)) + int(first)
    points = Points(parameters["LABELS"]["value"], metres(unit, path) * places, _rate(rate), numbers)
    return body(path, points, asked, said, Z_UP)


def _rate(values: list[float]) -> float | None:
    """Frames a second, None where the file does not say."""
    return values[0] if values and values[0] > 0.0 else None
