"""2D keypoints of any detector: the files that OpenPose, COCO's tools and AlphaPose write, read into one structure.

docs/capture.md says which files are meant. Whatever the detector, a person is (26, 3): column, row and confidence of
each of `KEYPOINTS`, the confidence 0 where the detector does not know the keypoint or has not found it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.io.manifest import Json, load_json
from pzcap.types import Array, PzcapError

KEYPOINTS: Final[tuple[str, ...]] = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "head_top", "neck", "mid_hip",
    "left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe", "left_heel", "right_heel",
)  # fmt: skip
"""All that is known of any detector, in the order of Halpe's 26, which begin with COCO's 17."""

_OPENPOSE_TRUNK: Final = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
)  # fmt: skip
_OPENPOSE_LEGS: Final = ("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle")
_OPENPOSE_FACE: Final = ("right_eye", "left_eye", "right_ear", "left_ear")
BODY_25: Final[tuple[str, ...]] = (
    *_OPENPOSE_TRUNK, "mid_hip", *_OPENPOSE_LEGS, *_OPENPOSE_FACE,
    "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
)  # fmt: skip
COCO_18: Final[tuple[str, ...]] = (*_OPENPOSE_TRUNK, *_OPENPOSE_LEGS, *_OPENPOSE_FACE)

_ROWS: Final[dict[int, list[int]]] = {
    len(names): [KEYPOINTS.index(name) for name in names]
    for names in (KEYPOINTS[:17], COCO_18, BODY_25, KEYPOINTS)  # how many there are says which they are
}

NOBODY: Final[Array] = np.zeros((0, len(KEYPOINTS), 3))
"""The people of a picture that shows none."""


def read_keypoints(path: Path, indices: NDArray[np.int64]) -> dict[int, Array]:
    """The people (P, 26, 3) that a detector found in one camera's motion, by the index of the picture.

    ``path`` is a folder of OpenPose's files or a file of COCO results; ``indices`` (N,) are those of the pictures that
    the video holds, in order. A picture without anybody is not in the result. Raises PzcapError, naming the file, for
    what is none of these, for numbers that are no keypoints, and for a picture that the video does not hold.
    """
    found: dict[int, list[Array]] = {}
    for number, person in _openpose(path) if path.is_dir() else _coco(path):
        if number >= len(indices):
            raise person.error(f"picture {number} (counted from 0), where the video holds {len(indices)}; run it again")
        found.setdefault(int(indices[number]), []).append(_person(person))
    return {index: np.stack(people) for index, people in found.items()}


def _openpose(folder: Path) -> list[tuple[int, Json]]:
    """The people in a folder of files, one a picture: number of the picture, and its numbers."""
    files = sorted(folder.glob("*.json"))
    if not files:
        raise PzcapError(f"{folder}: holds no .json file; run the detector again, or put null in its place")
    people = []
    for file in files:
        number = _number(file.name)
        if number is None:
            raise PzcapError(f"{file}: no number of a picture in its name; keep the names that OpenPose gave")
        people += [(number, person["pose_keypoints_2d"]) for person in load_json(file)["people"].list()]
    return people


def _coco(file: Path) -> list[tuple[int, Json]]:
    """The people in a file of results: number of the picture, and its numbers."""
    people = []
    for person in load_json(file).list():
        name = person["image_id"]
        number = name.value if type(name.value) is int else _number(str(name.value))
        if number is None or number < 0:
            raise name.error("must be the number of a picture, or a name that ends in it")
        people.append((number, person["keypoints"]))
    return people


def _number(name: str) -> int | None:
    """The last number in the name of a picture or of its file."""
    digits = re.findall(r"\d+", Path(name).stem)
    return int(digits[-1]) if digits else None


def _person(numbers: Json) -> Array:
    """(26, 3) from a list of x, y and confidence of each keypoint in turn."""
    values = numbers.array(-1)
    rows = _ROWS.get(len(values) // 3) if len(values) % 3 == 0 else None
    if rows is None:
        known = ", ".join(str(3 * count) for count in _ROWS)
        raise numbers.error(f"holds {len(values)} numbers; people of {known} are known (docs/capture.md)")
    person = np.zeros((len(KEYPOINTS), 3))
    person[rows] = values.reshape(-1, 3)
    person[:, 2] = np.clip(person[:, 2], 0.0, 1.0)
    return person
