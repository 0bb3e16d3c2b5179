"""Walls covered with pictures of the user's own."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from pzcap.io.capture import read_image
from pzcap.types import PzcapError
from sim.hall.scenery import WALLS
from sim.hall.textures import Canvas

_ENDINGS: Final = (".png", ".jpg", ".jpeg")


def wall_pictures(folder: str) -> dict[str, Path]:
    """The picture of each wall that has one in this folder; none if no folder is named.

    Raises PzcapError if there is no picture in it, one of no wall, or two of one.
    """
    if not folder:
        return {}
    try:
        pictures = sorted(path for path in Path(folder).iterdir() if path.suffix.lower() in _ENDINGS)
    except OSError as error:
        raise PzcapError(f"{folder}: cannot read the pictures of the walls: {error.strerror}") from error
    found: dict[str, Path] = {}
    for path in pictures:
        if path.stem not in WALLS or path.stem in found:
            raise PzcapError(f"{path}: one picture a wall, named as it is: {', '.join(WALLS)}, as PNG or JPEG")
        found[path.stem] = path
    if not found:
        raise PzcapError(f"{folder}: no picture of a wall is in it; name them {', '.join(WALLS)}, as PNG or JPEG")
    return found


def cover(picture: Path, lower: Canvas, upper: Canvas) -> None:
    """Replace what is painted on the two parts of a wall, which stand one on the other, by a picture.

    It is scaled, its proportions kept, until it covers the wall; what juts out on two sides is cut off.
    """
    image = read_image(picture)[..., ::-1]
    columns, rows = lower.image.shape[1], lower.image.shape[0] + round(upper.height_m * lower.px_per_m)
    scale = max(columns / image.shape[1], rows / image.shape[0])
    height, width = (max(1, round(side / scale)) for side in (rows, columns))
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    part = np.ascontiguousarray(image[top : top + height, left : left + width])
    shown = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    split = rows - lower.image.shape[0]
    lower.image[:] = shown[split:]
    upper.image[:] = cv2.resize(shown[:split], upper.image.shape[1::-1], interpolation=cv2.INTER_AREA)
