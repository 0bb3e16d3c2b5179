"""Markers of another dictionary than object.json says: looked for where those that it names are not found."""

from __future__ import annotations

from typing import Final

import cv2

from pzcap.imaging.colour import grey
from pzcap.types import Image

_SIZES: Final = (50, 100, 250, 1000)
_NESTED: Final = ("DICT_4X4", "DICT_5X5", "DICT_6X6", "DICT_7X7")
"""Families whose smaller dictionaries are the beginnings of the larger ones."""
_SINGLE: Final = (
    "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11",
    "DICT_ARUCO_MIP_36h12",
)  # fmt: skip
_FEWEST: Final = 4  # markers of one dictionary that no pattern of a hall passes for


def find_other(image: Image, dictionary: str) -> tuple[str, int] | None:
    """The dictionary that most markers in ``image`` (H, W[, 3]) are of, and their number, if it is another than
    ``dictionary``; None if no other has some."""
    shown = grey(image)
    found: dict[str, set[int]] = {}
    for name in (*(f"{family}_{_SIZES[-1]}" for family in _NESTED), *_SINGLE):
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)))
        ids = detector.detectMarkers(shown)[1]
        found[name] = set() if ids is None else {int(number) for number in ids.ravel()}
    best = max(found, key=lambda name: len(found[name]))
    if len(found[best]) < _FEWEST:
        return None
    family = best.rpartition("_")[0]
    if family in _NESTED:
        if dictionary.startswith(family):
            return None
        smallest = next(size for size in _SIZES if size > max(found[best]))
        return f"{family}_{smallest}", len(found[best])
    return None if best == dictionary else (best, len(found[best]))
