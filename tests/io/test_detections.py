"""Keypoints of detectors: their files, written here as OpenPose, COCO's tools and AlphaPose write them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pzcap.io import detections
from pzcap.io.detections import BODY_25, COCO_18, KEYPOINTS
from pzcap.types import Array, PzcapError

INDICES = np.array([0, 1, 4, 5])
"""Of the video's pictures: two were dropped."""
SIZE = (640, 480)


def read_keypoints(path: Path, first: int | None = None) -> dict[int, Array]:
    return detections.read_keypoints(path, INDICES, SIZE, first)


def flat(names: tuple[str, ...], seed: int) -> list[float]:
    rng = np.random.default_rng(seed)
    table = np.column_stack([rng.uniform(0, 479, (len(names), 2)), rng.uniform(0.1, 1.0, len(names))])
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
    found = read_keypoints(openpose(tmp_path / "found", {0: [first, second], 1: [], 2: [third]}))
    assert sorted(found) == [0, 4]  # picture 2 is the one after the gap
    np.testing.assert_allclose(found[0], [expected(names, first), expected(names, second)])
    np.testing.assert_allclose(found[4], [expected(names, third)])


@pytest.mark.parametrize("names", [KEYPOINTS[:17], KEYPOINTS])
@pytest.mark.parametrize("image", [3, "3.jpg", "take2_000003.png"])
def test_results_of_coco_and_alphapose(tmp_path: Path, names: tuple[str, ...], image: int | str) -> None:
    person, other = flat(names, 0), flat(names, 1)
    found = read_keypoints(results(tmp_path / "results.json", {image: person, 0: other}))
    assert sorted(found) == [0, 5]
    np.testing.assert_allclose(found[5], [expected(names, person)])


WHOLE_BODY = (*KEYPOINTS[:17], *detections._COCO_FEET)


def test_a_data_set_of_coco(tmp_path: Path) -> None:
    """Its ids are any; the pictures' names count."""
    names, person = KEYPOINTS[:17], flat(KEYPOINTS[:17], 1)
    pictures = [{"id": 40 + k, "file_name": f"take2/frame_{k:06d}.PNG"} for k in range(4)]
    people = [{"id": 1, "image_id": 42, "keypoints": person, "num_keypoints": 17}, {"id": 2, "image_id": 40}]
    people.append({"id": 3, "image_id": 40, "keypoints": person})
    file = tmp_path / "instances.json"
    file.write_text(json.dumps({"images": pictures, "annotations": people, "categories": []}))
    found = read_keypoints(file)
    assert sorted(found) == [0, 4]
    np.testing.assert_array_equal(found[4][0], expected(names, person))


@pytest.mark.parametrize(("count", "names"), [(23, WHOLE_BODY), (133, WHOLE_BODY), (136, KEYPOINTS)])
def test_faces_and_hands_are_left_out(count: int, names: tuple[str, ...], tmp_path: Path) -> None:
    person = flat(tuple(str(k) for k in range(count)), 0)
    found = read_keypoints(results(tmp_path / "results.json", {0: person}))
    np.testing.assert_allclose(found[0], [expected(names, person[: 3 * len(names)])])


@pytest.mark.parametrize("first", [0, 1])
def test_mmpose(first: int, tmp_path: Path) -> None:
    """It lists every picture, also one without anybody; some of its scripts count from 1."""
    person, other = flat(KEYPOINTS[:17], 0), flat(KEYPOINTS[:17], 1)
    pictures = {first: [person], first + 1: [], first + 2: [], first + 3: [person, other]}
    found = read_keypoints(mmpose(tmp_path / "results.json", pictures))
    assert sorted(found) == [0, 5]
    np.testing.assert_allclose(found[5], [expected(KEYPOINTS[:17], one) for one in (person, other)])


def test_pictures_unpacked_by_ffmpeg_are_counted_from_one(tmp_path: Path) -> None:
    """Somebody in the last picture tells; with nobody in it, the capture has to say."""
    people = {f"{k:06d}.jpg": flat(KEYPOINTS[:17], k) for k in (1, 2, 4)}
    found = read_keypoints(results(tmp_path / "results.json", people))
    assert sorted(found) == [0, 1, 5]
    people.pop("000004.jpg")
    path = results(tmp_path / "results.json", people)
    assert sorted(read_keypoints(path, first=1)) == [0, 1]
    assert sorted(read_keypoints(path, first=0)) == [1, 4]


def test_one_file_more_than_pictures_is_the_last_read_twice(tmp_path: Path) -> None:
    pictures = {k: [flat(BODY_25, k)] for k in range(5)}
    assert sorted(read_keypoints(openpose(tmp_path / "found", pictures))) == [0, 1, 4, 5]


def test_what_a_mac_puts_beside_the_files_is_passed_over(tmp_path: Path) -> None:
    folder = openpose(tmp_path / "found", {0: [flat(BODY_25, 0)]})
    (folder / "._take2_000000000000_keypoints.json").write_bytes(b"\x00\x05\x16\x07\x00\xff")
    assert sorted(read_keypoints(folder)) == [0]


def test_a_few_keypoints_beyond_the_edge_are_usual(tmp_path: Path) -> None:
    person = np.array(flat(BODY_25, 0)).reshape(-1, 3)
    person[:8, 1] += 480
    found = read_keypoints(openpose(tmp_path / "found", {0: [person.ravel().tolist()]}))
    assert sorted(found) == [0]


def test_the_formats_name_every_keypoint_once() -> None:
    for names in (BODY_25, COCO_18, KEYPOINTS):
        assert len(set(names)) == len(names)
        assert set(names) <= set(KEYPOINTS)
    assert (len(COCO_18), len(BODY_25), len(KEYPOINTS)) == (18, 25, 26)


def test_a_confidence_beyond_one_is_one(tmp_path: Path) -> None:
    """A file of clicked keypoints has 2 where the others have a confidence."""
    found = read_keypoints(results(tmp_path / "results.json", {0: [10.0, 20.0, 2.0] * 17}))
    np.testing.assert_array_equal(found[0][0, :17, 2], 1.0)


FAULTS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "an empty folder": (lambda at: openpose(at / "found", {}), "no .json file"),
    "too many pictures": (
        lambda at: openpose(at / "found", {0: [flat(BODY_25, 0)], 5: [flat(BODY_25, 0)]}),
        "picture 5",
    ),
    "another skeleton": (lambda at: openpose(at / "found", {0: [[1.0] * 45]}), "45 numbers"),
    "not in threes": (lambda at: openpose(at / "found", {0: [[1.0] * 50]}), "50 numbers"),
    "not a number": (lambda at: openpose(at / "found", {0: [[float("nan")] * 75]}), "finite"),
    "no image": (lambda at: results(at / "results.json", {"mine.jpg": flat(KEYPOINTS, 0)}), "image_id"),
    "an object": (lambda at: written(at / "results.json", {"people": []}), "list"),
    "numbers of a year": (lambda at: results(at / "results.json", {20261126: flat(KEYPOINTS, 0)}), "image_id"),
    "scores of others": (
        lambda at: mmpose(at / "results.json", {0: [flat(KEYPOINTS[:17], 0)]}, scores=16),
        "16 numbers",
    ),
    "no frame": (lambda at: written(at / "results.json", {"instance_info": [{"instances": []}]}), "frame_id"),
    "shares of the picture": (lambda at: openpose(at / "found", {0: [scaled(0.001)]}), "--keypoint_scale 0"),
    "shares from -1 to 1": (lambda at: openpose(at / "found", {0: [scaled(0.001, -0.5)]}), "--keypoint_scale 0"),
    "pixels of a larger video": (
        lambda at: openpose(at / "found", {0: [scaled(4.0)]}),
        "lie outside of the video's 640",
    ),
    "from 0 or from 1": (
        lambda at: results(at / "results.json", {2: flat(KEYPOINTS, 0), 3: flat(KEYPOINTS, 1)}),
        r'pictures 2 to 3 of 4 .* "keypoints_from": 0 or 1',
    ),
    "no people": (lambda at: written(at / "found" / "0.json", {"bodies": []}).parent, '"people" is missing'),
    "a name without a number": (lambda at: written(at / "found" / "mine.json", {"people": []}).parent, "no number"),
}


def scaled(factor: float, offset: float = 0.0) -> list[float]:
    person = np.array(flat(BODY_25, 0)).reshape(-1, 3)
    person[:, :2] = person[:, :2] * factor + offset
    return [float(value) for value in person.ravel()]


def mmpose(file: Path, pictures: dict[int, list[list[float]]], scores: int | None = None) -> Path:
    """As the inferencer of MMPose writes a video: pairs, and confidences beside them."""
    entries = []
    for number, people in pictures.items():
        tables = [np.array(person).reshape(-1, 3) for person in people]
        instances = [
            {"keypoints": table[:, :2].tolist(), "keypoint_scores": table[:scores, 2].tolist(), "bbox": [[0, 0, 9, 9]]}
            for table in tables
        ]
        entries.append({"frame_id": number, "instances": instances})
    return written(file, {"meta_info": {"dataset_name": "coco"}, "instance_info": entries})


def written(path: Path, value: Any) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(value))
    return path


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_file_gets_one_line(tmp_path: Path, fault: str) -> None:
    make, message = FAULTS[fault]
    path = make(tmp_path)
    with pytest.raises(PzcapError, match=message) as caught:
        read_keypoints(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
