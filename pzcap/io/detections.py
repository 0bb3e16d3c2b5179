"""2D keypoints of any detector: the files that OpenPose, COCO's tools, AlphaPose and MMPose write, read into one
structure.

docs/capture.md says which files are meant. Whatever the detector, a person is (26, 3): column, row and confidence of
each of `KEYPOINTS`, the confidence 0 where the detector does not know the keypoint or has not found it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.io import limits
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

ROW: Final = {name: row for row, name in enumerate(KEYPOINTS)}  # row of each keypoint

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

_COCO_FEET: Final = (
    "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
)  # fmt: skip

_ROWS: Final[dict[int, list[int]]] = {
    count: [KEYPOINTS.index(name) for name in names]
    for count, names in (
        (17, KEYPOINTS[:17]), (18, COCO_18), (23, (*KEYPOINTS[:17], *_COCO_FEET)), (25, BODY_25), (26, KEYPOINTS),
        (133, (*KEYPOINTS[:17], *_COCO_FEET)), (136, KEYPOINTS),
    )
}  # fmt: skip
"""Keypoints by how many a person has, in order: COCO's with feet, and with face and hands behind that,
and Halpe's with these. Faces and hands are left out."""

COUNTS: Final = tuple(_ROWS)  # numbers of keypoints that a person may have
NOBODY: Final[Array] = np.zeros((0, len(KEYPOINTS), 3))  # the people of a picture that shows none
_NOWHERE: Final[Array] = np.zeros((0, 2))


@dataclass(frozen=True, slots=True)
class _Found:
    """The people that a detector found in one picture."""

    number: int  # of the picture, as the detector counted
    people: tuple[Json, ...]
    scores: tuple[Json | None, ...]  # confidences, where they do not stand among the numbers
    where: Json
    whole: bool = True  # nobody else is found in an entry further on


def read_keypoints(
    path: Path, indices: NDArray[np.int64], size: tuple[int, int], first: int | None = None
) -> dict[int, Array]:
    """The people (P, 26, 3) that a detector found in one camera's motion, by the index of the picture.

    ``path`` is a folder of OpenPose's files or a file of results of COCO or MMPose; ``indices`` (N,) are those of the
    pictures that the video holds, in order; ``size`` are their width and height; ``first`` is the number of the first,
    None where the numbers tell it. A picture without anybody is not in the result. Raises PzcapError, naming the file,
    for what is none of these, for numbers that are no keypoints or of other pictures, and where it cannot be told
    whether pictures are counted from 0 or from 1.
    """
    pictures = _openpose(path) if path.is_dir() else _results(path)
    _check_numbers(path, pictures)
    first = _first(path, pictures, len(indices)) if first is None else first
    found: dict[int, list[Array]] = {}
    for picture in pictures:
        number = picture.number - first
        if not 0 <= number < len(indices):
            if number == len(indices) and picture.number == max(each.number for each in pictures):
                continue  # detectors that trust the header's count read the last picture once more
            raise picture.where.error(
                f"picture {picture.number} (counted from {first}), where the video holds {len(indices)}; "
                "run it again on this video"
            )
        for numbers, scores in zip(picture.people, picture.scores, strict=True):
            found.setdefault(int(indices[number]), []).append(_person(numbers, scores))
    people = {index: np.stack(each) for index, each in found.items()}
    _check_units(path, people, size)
    return people


def _check_numbers(path: Path, pictures: Sequence[_Found]) -> None:
    """Raise PzcapError where two entries that each hold a whole picture have the same number: of two videos, or copied
    twice."""
    seen: dict[int, Json] = {}
    for picture in pictures:
        if picture.whole and picture.number in seen:
            one, other = seen[picture.number], picture.where
            both = f"{one.path.name} and {other.path.name}" if path.is_dir() else f"{one.where} and {other.where}"
            raise PzcapError(
                f"{path}: {both} are both of picture {picture.number}; keep the one of this camera's motion"
            )
        seen[picture.number] = picture.where


def _first(path: Path, pictures: Sequence[_Found], count: int) -> int:
    """The number of the first picture: 0 or 1. Raises PzcapError where both are possible."""
    numbers = {picture.number for picture in pictures}
    if 0 in numbers or not any(picture.people for picture in pictures):
        return 0
    if count in numbers:
        return 1
    raise PzcapError(
        f"{path}: pictures {min(numbers)} to {max(numbers)} of {count} are in it, counted from 0 or from 1; "
        'say which at the camera in capture.json, "keypoints_from": 0 or 1'
    )


def _check_units(path: Path, people: dict[int, Array], size: tuple[int, int]) -> None:
    """Raise PzcapError where columns and rows cannot be those of pictures of this size."""
    known = np.concatenate(
        [person[person[:, 2] > 0.0, :2] for each in people.values() for person in each] or [_NOWHERE]
    )
    if len(known) == 0:
        return
    if len(known) > 1 and np.abs(known).max() <= 1.0:
        raise PzcapError(
            f"{path}: columns and rows go from {known.min():.2g} to {known.max():.2g}, not in pixels; run it again "
            "without scaling them (OpenPose: --keypoint_scale 0)"
        )
    outside = np.any((known < -0.1 * np.array(size)) | (known > 1.1 * np.array(size)), axis=1)
    if outside.mean() > 0.5:
        raise PzcapError(
            f"{path}: {outside.mean():.0%} of the keypoints lie outside of the video's {size[0]} x {size[1]} pixels; "
            "run it again on the video itself"
        )


def _openpose(folder: Path) -> list[_Found]:
    """A folder of files, one a picture. What a Mac puts beside them is passed over."""
    files = sorted(file for file in folder.glob("*.json") if not file.name.startswith("."))
    if not files:
        raise PzcapError(f"{folder}: holds no .json file; run the detector again, or put null in its place")
    pictures = []
    for file in files:
        number = _number(file.name)
        if number is None:
            raise PzcapError(f"{file}: no number of a picture in its name; keep the names that OpenPose gave")
        root = load_json(file, most_bytes=limits.KEYPOINTS_BYTES)
        people = tuple(person["pose_keypoints_2d"] for person in root["people"].list())
        pictures.append(_Found(number, people, (None,) * len(people), root))
    return pictures


def _results(file: Path) -> list[_Found]:
    """A file of results: COCO's, a person an entry, or MMPose's, a picture an entry; or a data set of COCO's, whose
    pictures are named in a list of their own."""
    root = load_json(file, most_bytes=limits.KEYPOINTS_BYTES)
    if _has(root, "annotations"):
        names = {json.dumps(picture["id"].value): picture["file_name"] for picture in root["images"].list()}
        people = [person for person in root["annotations"].list() if _has(person, "keypoints")]
        return [_coco(person, names.get(json.dumps(person["image_id"].value))) for person in people]
    if _has(root, "instance_info"):
        root = root["instance_info"]
    entries = root.list()
    return [_mmpose(entry) if _has(entry, "instances") else _coco(entry) for entry in entries]


def _has(entry: Json, key: str) -> bool:
    return isinstance(entry.value, dict) and key in entry.value


def _coco(person: Json, name: Json | None = None) -> _Found:
    name = person["image_id"] if name is None else name
    number = name.value if type(name.value) is int else _number(str(name.value))
    if number is None or not 0 <= number <= limits.FRAMES:
        raise name.error("must be the number of a picture, or a name that ends in it")
    return _Found(number, (person["keypoints"],), (None,), person["keypoints"], whole=False)


def _mmpose(picture: Json) -> _Found:
    number = picture["frame_id"]
    if type(number.value) is not int or not 0 <= number.value <= limits.FRAMES:
        raise number.error("must be the number of a picture")
    people = picture["instances"].list()
    keypoints = tuple(person["keypoints"] for person in people)
    return _Found(number.value, keypoints, tuple(person["keypoint_scores"] for person in people), picture)


def _number(name: str) -> int | None:
    """The last number in the name of a picture or of its file."""
    digits = re.findall(r"[0-9]{1,12}", Path(name).stem)
    return int(digits[-1]) if digits else None


def _person(numbers: Json, scores: Json | None) -> Array:
    """(26, 3) from a list of x, y and confidence of each keypoint in turn; or from pairs x, y, and ``scores``."""
    if scores is None:
        values = numbers.array(-1)
    else:
        pairs, confidence = numbers.array(-1, 2), scores.array(-1)
        if len(confidence) != len(pairs):
            raise scores.error(f"holds {len(confidence)} numbers, where there are {len(pairs)} keypoints")
        values = np.column_stack([pairs, confidence]).ravel()
    rows = _ROWS.get(len(values) // 3) if len(values) % 3 == 0 else None
    if rows is None:
        known = ", ".join(str(3 * count) for count in _ROWS)
        raise numbers.error(f"holds {len(values)} numbers; people of {known} are known (docs/capture.md)")
    person = np.zeros((len(KEYPOINTS), 3))
    person[rows] = values.reshape(-1, 3)[: len(rows)]
    person[:, 2] = np.clip(person[:, 2], 0.0, 1.0)
    return person
