"""Markers of another dictionary than object.json says are named by their own."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pzcap.calibration.other_dictionaries import find_other
from pzcap.types import Image


def printed(dictionary: str, ids: tuple[int, ...]) -> Image:
    """A white picture with a row of markers."""
    image = np.full((120, 30 + 90 * len(ids), 3), 235, np.uint8)
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    for k, number in enumerate(ids):
        image[30:90, 30 + 90 * k : 90 + 90 * k] = cv2.aruco.generateImageMarker(known, number, 60)[..., None]
    return image


@pytest.mark.parametrize(
    ("ids", "dictionary"),
    [
        ((3, 1, 4, 15, 9), "DICT_5X5_50"),
        ((3, 1, 4, 199, 9), "DICT_5X5_250"),
        ((3, 1, 4, 15, 9), "DICT_APRILTAG_36h11"),
        ((3, 1, 4, 15, 9), "DICT_ARUCO_ORIGINAL"),
    ],
)
def test_the_smallest_that_has_them_all(ids: tuple[int, ...], dictionary: str) -> None:
    assert find_other(printed(dictionary, ids), "DICT_4X4_50") == (dictionary, 5)


def test_the_right_one_and_too_few_are_no_other() -> None:
    assert find_other(printed("DICT_4X4_100", (3, 1, 4, 99)), "DICT_4X4_50") is None
    assert find_other(printed("DICT_APRILTAG_36h11", (3, 1, 4, 99)), "DICT_APRILTAG_36h11") is None
    assert find_other(printed("DICT_5X5_50", (3, 1, 4)), "DICT_4X4_50") is None
    assert find_other(np.full((120, 200, 3), 128, np.uint8), "DICT_4X4_50") is None
