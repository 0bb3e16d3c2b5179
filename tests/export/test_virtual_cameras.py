"""Virtual fixed cameras: what is carried over meets in space where it did, and files are as others read them."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pzcap.export import formats
from pzcap.export import virtual_cameras as export_virtual
from pzcap.export.take import Take
from pzcap.export.virtual_cameras import athlete, carried, virtual_cameras
from pzcap.geometry.camera import project
from pzcap.io.detections import BODY_25, KEYPOINTS
from pzcap.types import Array
from tests.scenes import exported, fabricated, seen_keypoints
from tests.scenes.exported import FRAMES, LOST, NAMES
from tests.scenes.seen_keypoints import OWN, ROWS


def opencv(table: dict[str, list[float]], points: Array) -> Array:
    """Pixels by a calibration as aniposelib and Pose2Sim read it."""
    lens = np.array(table["matrix"]), np.array(table["distortions"])
    vectors = np.array(table["rotation"]), np.array(table["translation"])
    return np.asarray(cv2.projectPoints(points, *vectors, *lens)[0][:, 0])


@pytest.mark.parametrize(("name", "file"), [("aniposelib", "calibration.toml"), ("pose2sim", "Calib_pzcap.toml")])
def test_a_calibration_is_read_by_opencv_alone(name: str, file: str, tmp_path: Path) -> None:
    path = next(path for path in formats.write(exported.take(), name, tmp_path) if path.name == file)
    tables = tomllib.loads(path.read_text())
    assert set(tables.pop("metadata")) == {"adjusted", "error"}
    assert list(tables) == sorted(tables)
    for table, virtual in zip(tables.values(), virtual_cameras(exported.take()), strict=True):
        for frame in (0, FRAMES - 1):
            expected = project(virtual.camera, exported.joints(frame))[0]
            np.testing.assert_allclose(opencv(table, exported.joints(frame)), expected, atol=0.02)
        assert table["distortions"] == [0.0] * 4
    if name == "aniposelib":
        assert [table["name"] for table in tables.values()] == list(NAMES)


def test_what_is_carried_over_meets_where_it_did() -> None:
    """The joints as each real camera sees them, carried over, triangulated by OpenCV through the virtual cameras."""
    take = exported.take()
    virtual, places = virtual_cameras(take), athlete(take)
    for frame in (0, 3, FRAMES - 1):
        true = exported.joints(frame)
        rows = []
        for each in virtual[:2]:
            pixels = project(exported.true_camera(each.located.number, frame), true)[0]
            rows.append(carried(exported.true_camera(each.located.number, frame), each.camera, pixels, places[frame]))
            assert (rows[-1] >= 0).all()
            assert (rows[-1] <= [each.camera.width, each.camera.height]).all()
        matrices = [np.array(each.matrix) @ np.linalg.inv(each.camera.world_T_cam)[:3] for each in virtual[:2]]
        found = cv2.triangulatePoints(*matrices, *(row.T for row in rows))
        # the projection centre moves by centimetres here, and a joint is half a metre nearer than the pelvis
        np.testing.assert_allclose((found[:3] / found[3]).T, true, atol=0.004)


def test_a_point_at_the_athletes_distance_is_carried_over_exactly() -> None:
    take = exported.take()
    for each in virtual_cameras(take):
        real, place = exported.true_camera(each.located.number, 3), athlete(take)[3]
        pixel = project(real, place[None])[0]
        np.testing.assert_allclose(
            carried(real, each.camera, pixel, place), project(each.camera, place[None])[0], atol=1e-6
        )


def test_without_a_body_the_axes_tell_where_the_athlete_is() -> None:
    followed = fabricated.reconstruction(frames=FRAMES).motion
    assert followed is not None
    take = Take(replace(exported.reconstruction(), motion=None))
    np.testing.assert_allclose(athlete(take)[3], followed.root_position_m.mean(axis=0), atol=0.3)


def test_keypoints_are_carried_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two people in every picture, one of them the athlete; the lost camera has nobody in its lost frame."""
    take = seen_keypoints.take(monkeypatch, np.array([60.0, 0.0, 0.0]))
    formats.write(take, "pose2sim", tmp_path / "p")
    formats.write(take, "aniposelib", tmp_path / "a")
    arrays = np.load(tmp_path / "a" / "keypoints.npz")
    assert arrays["points"].shape == (4, FRAMES, 26, 2)
    assert arrays["cameras"].tolist() == list(NAMES)
    for number, each in enumerate(virtual_cameras(take)):
        folder = tmp_path / "p" / "pose" / f"cam{number + 1:02d}_json"
        assert len(list(folder.iterdir())) == FRAMES
        for frame in range(FRAMES):
            people = json.loads((folder / f"cam{number + 1:02d}_{frame:06d}.json").read_text())["people"]
            assert len(people) == (0 if (number, frame) == (0, LOST) else 2)
            points = arrays["points"][number, frame]
            if not people:
                assert np.isnan(points).all()
                continue
            assert np.isnan(np.delete(points, ROWS, axis=0)).all()
            expected = project(each.camera, exported.joints(frame)[OWN])[0]
            np.testing.assert_allclose(points[ROWS], expected, atol=6.0)  # the other one is 60 away
            written = np.array([person["pose_keypoints_2d"] for person in people]).reshape(2, 17, 3)
            of_coco = [row for row in ROWS if row < 17]
            assert np.abs(written[:, of_coco, :2] - points[of_coco]).max(axis=(1, 2)).min() < 1e-6


@pytest.mark.parametrize(
    ("unknown", "model"),
    [
        ((), "Body_with_feet"),
        (("left_eye", "right_ear"), "Body_with_feet"),
        (("head_top",), "BODY_25"),
        (("head_top", "neck"), "COCO_17"),
        (("nose",), "COCO_17"),
    ],
)
def test_pose2sim_is_told_of_no_keypoint_that_the_detector_does_not_know(
    unknown: tuple[str, ...], model: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It would put it into the origin. Keypoints are written in the order of its model."""

    def person(number: int, _: int) -> Array:
        seen = np.column_stack([np.arange(26.0) + 100 * number, np.full(26, 50.0), np.full(26, 0.9)])
        seen[[KEYPOINTS.index(name) for name in unknown], 2] = 0.0
        return seen

    monkeypatch.setattr(seen_keypoints, "person", person)
    monkeypatch.setattr(export_virtual, "carried", lambda *given: given[2])
    formats.write(seen_keypoints.take(monkeypatch), "pose2sim", tmp_path)
    assert tomllib.loads((tmp_path / "Config.toml").read_text())["pose"]["pose_model"] == model
    order = {"Body_with_feet": KEYPOINTS, "BODY_25": BODY_25, "COCO_17": KEYPOINTS[:17]}[model]
    [found] = json.loads((tmp_path / "pose" / "cam02_json" / "cam02_000000.json").read_text())["people"]
    columns = np.reshape(found["pose_keypoints_2d"], (-1, 3))[:, 0]
    expected = [0.0 if name in unknown else 100.0 + KEYPOINTS.index(name) for name in order]
    np.testing.assert_allclose(columns, expected)


def test_without_keypoints_there_is_the_calibration_alone(tmp_path: Path) -> None:
    names = {path.name for path in formats.write(exported.take(), "aniposelib", tmp_path)}
    assert "calibration.toml" in names
    assert "keypoints.npz" not in names
    assert fabricated.WIDTH < virtual_cameras(exported.take())[0].camera.width < 20 * fabricated.WIDTH
