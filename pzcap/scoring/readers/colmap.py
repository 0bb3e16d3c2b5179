"""COLMAP's text format: ``cameras.txt`` and ``images.txt``, an image a camera and frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.io.files import checked
from pzcap.scoring.readers.conventions import SQUARE
from pzcap.scoring.readers.instants import Instant, tracks, view_of
from pzcap.scoring.records import CameraTrack
from pzcap.types import Array, PzcapError

MODELS: Final[dict[str, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}
HALF_PX: Final = 0.5  # COLMAP counts pixels from the corner of the first one


def read_colmap(folder: Path, names: Sequence[str], frames: int) -> tuple[CameraTrack | None, ...]:
    """The tracks of the cameras ``names``; images are called CAMERA/FRAME.png or CAMERA_FRAME.png."""
    lenses = {}
    for line, words in _lines(folder / "cameras.txt"):
        where = f"{folder / 'cameras.txt'} line {line}"
        if len(words) < 4 or words[1] not in MODELS:
            raise PzcapError(f"{where}: model {' '.join(words[1:2])}; one of {', '.join(MODELS)}")
        values = dict(zip(MODELS[words[1]], _numbers(words[4:], len(MODELS[words[1]]), where), strict=True))
        focal = (values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0)))
        if abs(focal[0] / focal[1] - 1.0) > SQUARE:
            raise PzcapError(f"{where}: fx and fy are {focal[0]:.6g} and {focal[1]:.6g}; pixels are square here")
        principal = np.array([values["cx"], values["cy"]]) - HALF_PX
        distortion = np.array([values.get(name, 0.0) for name in ("k1", "k2", "p1", "p2")])
        lenses[words[0]] = (0.5 * (focal[0] + focal[1]), principal, distortion)
    path = folder / "images.txt"
    found: dict[tuple[str, int], Instant] = {}
    for line, words in list(_lines(path, blank=True))[::2]:  # the second line of each image has its points
        where = f"{path} line {line}"
        if len(words) < 10 or words[8] not in lenses:
            raise PzcapError(f"{where}: no ID QW QX QY QZ TX TY TZ CAMERA_ID NAME with a camera of cameras.txt")
        rotation = _rotation(np.array(_numbers(words[1:5], 4, where))).T  # world to camera in the file
        position = -rotation @ np.array(_numbers(words[5:8], 3, where))
        view = view_of(" ".join(words[9:]), names, where)
        if view in found:
            raise PzcapError(f"{where}: camera {view[0]} has frame {view[1]} twice; give each frame once")
        focal_px, principal, distortion = lenses[words[8]]
        found[view] = Instant(rotation, position, focal_px, principal, distortion)
    return tracks(found, names, frames, path)


def _lines(path: Path, *, blank: bool = False) -> Iterator[tuple[int, list[str]]]:
    """The lines that are no comment, with their number; blank ones where those say something."""
    try:
        text = checked(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise PzcapError(f"{path}: cannot be read ({error}); write the model as text") from error
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.startswith("#") and (blank or line.strip()):
            yield number, line.split()


def _numbers(words: Sequence[str], count: int, where: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise PzcapError(f"{where}: {error}; write numbers") from error
    if len(values) != count or not np.isfinite(values).all():
        raise PzcapError(f"{where}: {len(values)} numbers where {count} finite ones belong")
    return values


def _rotation(wxyz: Array) -> Array:
    """(3, 3) of a quaternion."""
    w, x, y, z = wxyz / np.linalg.norm(wxyz)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
