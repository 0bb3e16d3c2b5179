"""Keypoints of detectors: their files, written here as OpenPose, COCO's tools and AlphaPose write them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pzcap.io.detections import BODY_25, COCO_18, KEYPOINTS, read_keypoints
from pzcap.types import Array, PzcapError

INDICES = np.array([0, 1, 4, 5])
"""Of the video's pictures: two were dropped."""


def flat(names: tuple[str, ...], seed: int) -> list[float]:
    rng = np.random.default_rng(seed)
    table = np.column_stack([rng.uniform(0, 600, (len(names), 2)), rng.uniform(0.1, 1.0, len(names))])
    return [float(value) for value in table.ravel()]


def openpose(folder: Path, pictures: dict[int, list[list[float]]]) -> Path:
    folder.mkdir()
    for number, people in pictures.items():
        value = {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": person} for person in people]}
        (folder / f"take2_{number:012d}_keypoints.json").write_text(json.dumps(value))
    return folder


def results(file: Path, pictures: dict[int | str, list[float]]) -> Path:
    entries = [
        {"image_id": image, "category_id": 1, "keypoints": person, "score": 2.9} for image, person in pictures.items()
    ]
    file.write_text(json.dumps(entries))
    return file


def expected(names: tuple[str, ...], person: list[float]) -> Array:
    table = dict(zip(names, np.array(person).reshape(-1, 3), strict=True))
    return np.array([table.get(name, np.zeros(3)) for name in KEYPOINTS])


@pytest.mark.parametrize("names", [BODY_25, COCO_18])
def test_openpose(tmp_path: Path, names: tuple[str, ...]) -> None:
    first, second, third = (flat(names, seed) for seed in range(3))
    found = read_keypoints(openpose(tmp_path / "found", {0: [first, second], 1: [], 2: [third]}), INDICES)
    assert sorted(found) == [0, 4]  # picture 2 is the one after the gap
    np.testing.assert_allclose(found[0], [expected(names, first), expected(names, second)])
    np.testing.assert_allclose(found[4], [expected(names, third)])


@pytest.mark.parametrize("names", [KEYPOINTS[:17], KEYPOINTS])
@pytest.mark.parametrize("image", [3, "3.jpg", "take2_000003.png"])
def test_results_of_coco_and_alphapose(tmp_path: Path, names: tuple[str, ...], image: int | str) -> None:
    person, other = flat(names, 0), flat(names, 1)
    found = read_keypoints(results(tmp_path / "results.json", {image: person, 0: other}), INDICES)
    assert sorted(found) == [0, 5]
    np.testing.assert_allclose(found[5], [expected(names, person)])


def test_the_formats_name_every_keypoint_once() -> None:
    for names in (BODY_25, COCO_18, KEYPOINTS):
        assert len(set(names)) == len(names)
        assert set(names) <= set(KEYPOINTS)
    assert (len(COCO_18), len(BODY_25), len(KEYPOINTS)) == (18, 25, 26)


def test_a_confidence_beyond_one_is_one(tmp_path: Path) -> None:
    """A file of clicked keypoints has 2 where the others have a confidence."""
    found = read_keypoints(results(tmp_path / "results.json", {0: [10.0, 20.0, 2.0] * 17}), INDICES)
    np.testing.assert_array_equal(found[0][0, :17, 2], 1.0)


FAULTS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "an empty folder": (lambda at: openpose(at / "found", {}), "no .json file"),
    "too many pictures": (lambda at: openpose(at / "found", {4: [flat(BODY_25, 0)]}), "picture 4"),
    "another skeleton": (lambda at: openpose(at / "found", {0: [[1.0] * 45]}), "45 numbers"),
    "not in threes": (lambda at: openpose(at / "found", {0: [[1.0] * 50]}), "50 numbers"),
    "not a number": (lambda at: openpose(at / "found", {0: [[float("nan")] * 75]}), "finite"),
    "no image": (lambda at: results(at / "results.json", {"mine.jpg": flat(KEYPOINTS, 0)}), "image_id"),
    "an object": (lambda at: written(at / "results.json", {"annotations": []}), "list"),
    "no people": (lambda at: written(at / "found" / "0.json", {"bodies": []}).parent, '"people" is missing'),
    "a name without a number": (lambda at: written(at / "found" / "mine.json", {"people": []}).parent, "no number"),
}


def written(path: Path, value: Any) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(value))
    return path


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_file_gets_one_line(tmp_path: Path, fault: str) -> None:
    make, message = FAULTS[fault]
    path = make(tmp_path)
    with pytest.raises(PzcapError, match=message) as caught:
        read_keypoints(path, INDICES)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
