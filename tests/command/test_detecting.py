"""`pzcap keypoints`: a detector's function over the videos, and its adapters."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from pzcap.command.main import main
from pzcap.extras import detectors
from pzcap.io.capture import frame_sets, read_capture
from pzcap.io.detections import KEYPOINTS
from pzcap.io.video import VideoReader
from pzcap.types import Array, Image, PzcapError


@pytest.fixture
def capture(small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of a capture without keypoints, and a module `spotter` with a detector that finds the brightest pixel."""

    def brightest(image: Image) -> Array:
        row, column = np.unravel_index(int(image[..., 1].argmax()), image.shape[:2])
        return np.tile([float(column), float(row), 0.5], (1, 17, 1))

    spotter = ModuleType("spotter")
    vars(spotter)["brightest"] = brightest
    monkeypatch.setitem(sys.modules, "spotter", spotter)
    return Path(shutil.copytree(small_capture / "capture", tmp_path / "take"))


def test_what_it_finds_is_named_in_the_capture_and_read(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["keypoints", str(capture), "--by", "spotter:brightest"]) == 0
    assert "somebody in" in capsys.readouterr().out
    sets = frame_sets(read_capture(capture))
    for frames in sets:
        for image, people in zip(frames.images, frames.keypoints, strict=True):
            assert image is not None
            column, row, confidence = people[0, KEYPOINTS.index("left_knee")]
            assert image[int(row), int(column), 1] == image[..., 1].max()
            assert confidence == 0.5
            assert people[0, KEYPOINTS.index("neck"), 2] == 0.0


def test_what_is_there_is_not_found_anew_without_being_asked(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["keypoints", str(capture), "--by", "spotter:brightest"]
    assert main(line) == 0
    before = (capture / "capture.json").read_bytes()
    assert main(line) == 1
    assert "--replace" in capsys.readouterr().err
    assert main([*line, "--replace"]) == 0
    assert (capture / "capture.json").read_bytes() == before


def test_cameras_that_are_done_stay_done_when_it_is_interrupted(
    capture: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = 0

    def tired(_: Image) -> Array:
        nonlocal pictures
        pictures += 1
        if pictures == 20:
            raise KeyboardInterrupt
        return np.zeros((0, 17, 3))

    spotter = sys.modules["spotter"]
    monkeypatch.setattr(spotter, "tired", tired, raising=False)
    line = ["keypoints", str(capture), "--by", "spotter:tired"]
    assert main(line) == 130
    done = [camera.name for camera in read_capture(capture).cameras if camera.keypoints is not None]
    assert main(line) == 0
    said = capsys.readouterr().out
    assert all(said.count(f"camera {camera.name}: ") == 1 for camera in read_capture(capture).cameras)
    assert done
    assert pictures < 20 + sum(len(VideoReader(camera.motion).indices) for camera in read_capture(capture).cameras)


@pytest.mark.parametrize(
    "returned",
    [None, [0.0], np.zeros((1, 19, 3)), np.zeros((17, 3)), [["a"]]],
    ids=["none", "flat", "19", "one", "text"],
)
def test_a_detector_that_returns_anything_else_is_one_line(
    capture: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, returned: object
) -> None:
    monkeypatch.setattr(sys.modules["spotter"], "wrong", lambda _: returned, raising=False)
    assert main(["keypoints", str(capture), "--by", "spotter:wrong"]) == 1
    said = capsys.readouterr().err
    assert "spotter:wrong: returned" in said
    assert "(P, K, 3)" in said
    assert main(["keypoints", str(capture), "--by", "no_such_module:f"]) == 1
    assert "PYTHONPATH" in capsys.readouterr().err


def test_a_capture_json_written_anew_names_the_keypoints_again(
    capture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["keypoints", str(capture), "--by", "spotter:brightest"]) == 0
    before = [camera.keypoints for camera in read_capture(capture).cameras]
    assert main(["new", str(capture), "--replace"]) == 0
    assert [camera.keypoints for camera in read_capture(capture).cameras] == before
    assert None not in before
    assert "_keypoints.json has its keypoints" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("by", "said"),
    [
        (["nobody"], "rtmlib, mediapipe"),
        (["spotter:nothing"], "no such function"),
        (["no_such_module:find"], "PYTHONPATH"),
        (["rtmlib"], "PERSON.onnx POSE.onnx"),
        (["mediapipe", "--models", "no.task"], "no such file"),
    ],
)
def test_what_is_missing_is_said_in_one_line(
    capture: Path, by: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (capture / "capture.json").read_bytes()
    assert main(["keypoints", str(capture), "--by", *by]) == 1
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert (capture / "capture.json").read_bytes() == before
    assert not list(capture.rglob("*keypoints.json"))


def test_mediapipes_landmarks_become_keypoints(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its columns and rows are shares of the picture, counted from the edge of the first pixel."""
    marks = [SimpleNamespace(x=(n + 0.5) / 64, y=(n + 0.5) / 48, visibility=n / 40) for n in range(33)]
    pose = SimpleNamespace(process=lambda _: SimpleNamespace(pose_landmarks=SimpleNamespace(landmark=marks)))
    solutions = SimpleNamespace(pose=SimpleNamespace(Pose=lambda **_: pose))
    monkeypatch.setitem(sys.modules, "mediapipe", SimpleNamespace(solutions=solutions))
    (person,) = detectors.detector("mediapipe", [])(np.zeros((48, 64, 3), np.uint8))
    for name, number in (("nose", 0), ("left_wrist", 15), ("right_big_toe", 32)):
        np.testing.assert_allclose(person[KEYPOINTS.index(name)], [number, number, number / 40])
    assert person[KEYPOINTS.index("left_small_toe"), 2] == 0.0


def test_a_mediapipe_without_a_model_says_what_to_give(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mediapipe", SimpleNamespace())
    with pytest.raises(PzcapError, match=r"\.task"):
        detectors.detector("mediapipe", [])


def test_rtmlib_is_given_files_and_the_sizes_of_their_pictures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Given names of its own it would fetch weights."""
    given: dict[str, object] = {}
    shapes = {"person.onnx": [1, 3, 416, 640], "pose.onnx": ["batch", 3, 256, 192]}

    class BodyWithFeet:
        def __init__(self, **options: object) -> None:
            given.update(options)

        def __call__(self, _: Image) -> tuple[Array, Array]:
            return np.full((2, 26, 2), 7.0), np.full((2, 26), 1.3)

    def session(path: str) -> SimpleNamespace:
        return SimpleNamespace(get_inputs=lambda: [SimpleNamespace(shape=shapes[Path(path).name])])

    monkeypatch.setitem(sys.modules, "rtmlib", SimpleNamespace(BodyWithFeet=BodyWithFeet))
    monkeypatch.setitem(sys.modules, "onnxruntime", SimpleNamespace(InferenceSession=session))
    models = [tmp_path / name for name in shapes]
    for model in models:
        model.write_bytes(b"")
    people = detectors.detector("rtmlib", models)(np.zeros((48, 64, 3), np.uint8))
    assert given["det"] == str(models[0])
    assert given["det_input_size"] == (640, 416)
    assert given["pose_input_size"] == (192, 256)
    assert people.shape == (2, 26, 3)
    assert json.dumps(people[0, 0].tolist()) == "[7.0, 7.0, 1.0]"
