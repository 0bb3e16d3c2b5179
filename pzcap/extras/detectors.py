"""Adapters of keypoint detectors that a user has installed: a picture in, people with their keypoints out.

None comes with pzcap, and none is fetched: weights are files of the user's. A detector is any function from a picture
(H, W, 3), blue, green, red, to the people in it, (P, K, 3): column, row and confidence of the K keypoints that
`pzcap.io.detections` knows a person of so many to have.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from pzcap.io.detections import COUNTS, KEYPOINTS, NOBODY
from pzcap.types import Array, Image, PzcapError

Detector = Callable[[Image], Array]

_SHAPE: Final = (
    "a detector returns the people of a picture, (P, K, 3): column, row and confidence of K keypoints, K one of "
    f"{', '.join(map(str, COUNTS))}"
)

_BLAZEPOSE: Final[dict[str, int]] = {
    "nose": 0, "left_eye": 2, "right_eye": 5, "left_ear": 7, "right_ear": 8,
    "left_shoulder": 11, "right_shoulder": 12, "left_elbow": 13, "right_elbow": 14, "left_wrist": 15, "right_wrist": 16,
    "left_hip": 23, "right_hip": 24, "left_knee": 25, "right_knee": 26, "left_ankle": 27, "right_ankle": 28,
    "left_heel": 29, "right_heel": 30, "left_big_toe": 31, "right_big_toe": 32,
}  # fmt: skip
"""Which of MediaPipe's 33 landmarks a keypoint is. Those beside the mouth and on the hands are left out."""


def rtmpose(models: Sequence[Path]) -> Detector:
    """RTMPose by `rtmlib`: Halpe's 26 keypoints of each person. ``models``: the person detector (YOLOX) and the pose
    model, as ONNX files; the sizes of their pictures are read from them."""
    if len(models) != 2:
        first = "" if importlib.util.find_spec("rtmlib") else "pip install rtmlib onnxruntime, and "
        raise PzcapError(f"rtmlib: {first}give --models PERSON.onnx POSE.onnx (its page lists them); none is fetched")
    library, runtime = _installed("rtmlib", "rtmlib"), _installed("onnxruntime", "onnxruntime")
    sizes = [runtime.InferenceSession(str(model)).get_inputs()[0].shape[:1:-1] for model in models]
    solution = library.BodyWithFeet(
        det=str(models[0]), det_input_size=tuple(sizes[0]), pose=str(models[1]), pose_input_size=tuple(sizes[1]),
        backend="onnxruntime", device="cpu",
    )  # fmt: skip

    def detect(image: Image) -> Array:
        keypoints, scores = solution(image)
        return np.dstack([np.asarray(keypoints, np.float64), np.clip(scores, 0.0, 1.0)])

    return detect


def mediapipe(models: Sequence[Path]) -> Detector:
    """BlazePose by MediaPipe. ``models``: one pose landmarker's .task file; none: the model that versions up to 0.10.21
    have inside, which sees one person."""
    library = _installed("mediapipe", "mediapipe")
    if models:
        return _landmarker(library, models[0])
    if not hasattr(library, "solutions"):
        raise PzcapError("mediapipe: this version has no model inside; give --models POSE.task, which its page offers")
    solution = library.solutions.pose.Pose(static_image_mode=True, model_complexity=1)

    def detect(image: Image) -> Array:
        found = solution.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB)).pose_landmarks
        return _blazepose([] if found is None else [found.landmark], image)

    return detect


def _landmarker(library: Any, model: Path) -> Detector:
    tasks = library.tasks
    options = tasks.vision.PoseLandmarkerOptions(
        base_options=tasks.BaseOptions(model_asset_path=str(model)), num_poses=4
    )
    landmarker = tasks.vision.PoseLandmarker.create_from_options(options)

    def detect(image: Image) -> Array:
        picture = library.Image(image_format=library.ImageFormat.SRGB, data=cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        return _blazepose(landmarker.detect(picture).pose_landmarks, image)

    return detect


def _blazepose(people: Sequence[Any], image: Image) -> Array:
    """People (P, 26, 3) from MediaPipe's landmarks, whose columns and rows are shares of the picture, counted from its
    edges."""
    found = np.zeros((len(people), len(KEYPOINTS), 3))
    size = np.array(image.shape[1::-1])
    for person, landmarks in zip(found, people, strict=True):
        for name, number in _BLAZEPOSE.items():
            mark = landmarks[number]
            person[KEYPOINTS.index(name)] = *(np.array([mark.x, mark.y]) * size - 0.5), mark.visibility
    return found


def of_module(name: str) -> Detector:
    """The detector that ``module:function`` names."""
    module, _, function = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), function, None)
    except ImportError as error:
        raise PzcapError(f"{name}: {error}; is the folder of {module} in PYTHONPATH?") from error
    if not callable(found):
        raise PzcapError(f"{name}: there is no such function; give MODULE:FUNCTION")
    return lambda image: _people(found(image), name)


def _people(found: object, name: str) -> Array:
    """The people that the function ``name`` has returned, (P, K, 3). Raises PzcapError where it is anything else."""
    try:
        people = np.asarray(found, np.float64)
    except (TypeError, ValueError) as error:
        raise PzcapError(f"{name}: returned no array of numbers ({error}); {_SHAPE}") from error
    if people.size and (people.ndim != 3 or people.shape[2] != 3 or people.shape[1] not in COUNTS):
        raise PzcapError(f"{name}: returned an array of shape {people.shape}; {_SHAPE}")
    return people if people.size else NOBODY


def detector(name: str, models: Sequence[Path]) -> Detector:
    """The detector of that ``name``: rtmlib, mediapipe, or anybody's module:function."""
    for model in models:
        if not model.is_file():
            raise PzcapError(f"{model}: no such file; give the detector's weights")
    if ":" in name:
        return of_module(name)
    known: dict[str, Callable[[Sequence[Path]], Detector]] = {"rtmlib": rtmpose, "mediapipe": mediapipe}
    if name not in known:
        raise PzcapError(f"no detector '{name}'; there are {', '.join(known)}, and MODULE:FUNCTION of your own")
    return known[name](models)


def coco_results(pictures: Iterator[Image], detect: Detector) -> Iterator[dict[str, Any]]:
    """The people in each of the ``pictures``, as entries of COCO's results. The picture's number counts from 0."""
    for number, picture in enumerate(pictures):
        for person in detect(picture):
            yield {"image_id": number, "keypoints": np.round(person, 3).ravel().tolist()}


def _installed(module: str, package: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise PzcapError(f"{module} is not installed ({error}); pip install {package}") from error
