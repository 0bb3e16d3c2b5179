"""The capture folder: what a crew brings home, read, checked and written. docs/capture.md specifies the format.

`read_capture` checks every file that the folder names, so that what is wrong is said before any work begins;
`frame_sets` brings the recordings of the motion together by timecode.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pzcap.types import (
    MEASUREMENTS,
    SEGMENTS,
    Array,
    CalibrationObject,
    CameraFiles,
    Capture,
    FrameSet,
    Image,
    Keyframe,
    Marker,
    Pose,
    PzcapError,
    Subject,
)
from pzcap.video import VideoReader, frames_per_day, frames_to_timecode, timecode_to_frames

FORMAT = "pzcap-capture"
VERSION = 1
MANIFEST = "capture.json"
_UNIT_TOLERANCE = 1e-3  # quaternions are written with a few decimals; they are normalised after this check


def read_capture(folder: Path) -> Capture:
    """Read a capture folder and check everything it names, but for the pixels.

    Raises PzcapError naming the file at fault and the remedy: a file that is missing or no JSON, a wrong version, a
    missing, misspelt or malformed entry, a video that cannot be opened, lacks its timecode, or has another frame rate
    than the manifest or another size than the camera's other files.
    """
    manifest = _load(folder / MANIFEST, "give the folder that holds it, or write one (docs/capture.md)")
    if manifest["format"].text() != FORMAT or manifest["version"].value != VERSION:
        raise manifest.error(f'this is not format "{FORMAT}", version {VERSION}; convert it (docs/capture.md)')
    rate = _frame_rate(manifest["frame_rate"])
    cameras = tuple(_read_camera(entry, folder) for entry in manifest["cameras"].list())
    names = [camera.name for camera in cameras]
    if not cameras or len(set(names)) < len(names):
        raise manifest["cameras"].error("list at least one camera, each with a name of its own")
    for camera in cameras:
        _check_videos(camera, rate)
    object_path, subject_path, keyframes_path = (
        manifest.file(key, folder) for key in ("object", "subject", "keyframes")
    )
    return Capture(
        folder=folder,
        name=manifest["name"].text(),
        frame_rate=rate,
        cameras=cameras,
        calibration_object=_read_object(object_path) if object_path else None,
        subject=_read_subject(subject_path) if subject_path else None,
        keyframe_poses=_read_keyframes(keyframes_path, rate) if keyframes_path else {},
        full_turn=manifest["full_turn"].boolean(),
    )


def write_capture(capture: Capture) -> None:
    """Write the JSON files of ``capture`` into its folder, which holds the images and videos already."""

    def relative(path: Path | None) -> str | None:
        return path.relative_to(capture.folder).as_posix() if path else None

    manifest: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": capture.name,
        "frame_rate": f"{capture.frame_rate.numerator}/{capture.frame_rate.denominator}",
        "full_turn": capture.full_turn,
        "cameras": [
            {"name": c.name, **{kind: relative(getattr(c, kind)) for kind in ("reference", "sweep", "zoom", "motion")}}
            for c in capture.cameras
        ],
    }
    if (what := capture.calibration_object) is not None:
        manifest["object"] = "object.json"
        markers = [{"id": marker.id, "corners_m": marker.corners_m.tolist()} for marker in what.markers]
        _dump(
            capture.folder / "object.json",
            {"dictionary": what.dictionary, "markers": markers, "wireframe_m": what.wireframe_m.tolist()},
        )
    if (subject := capture.subject) is not None:
        manifest["subject"] = "subject.json"
        _dump(capture.folder / "subject.json", {"measurements_m": subject.measurements_m, "sigma_m": subject.sigma_m})
    if capture.keyframe_poses:
        manifest["keyframes"] = "keyframes.json"
        keyframes = [
            {
                "timecode": timecode,
                "root_position_m": pose.root_position_m.tolist(),
                "rotations_wxyz": dict(zip(SEGMENTS, pose.rotations.tolist(), strict=True)),
            }
            for timecode, pose in capture.keyframe_poses.items()
        ]
        _dump(capture.folder / "keyframes.json", keyframes)
    _dump(capture.folder / MANIFEST, manifest)


def read_image(path: Path) -> Image:
    """Read a still image (H, W, 3). Raises PzcapError if it is missing or cannot be decoded."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        problem = "the image cannot be decoded" if path.is_file() else "no such image"
        raise PzcapError(f"{path}: {problem}; copy it again from the camera, as PNG or JPEG")
    return np.asarray(image, np.uint8)


# --------------------------------------------------------------------------------------------------------------
# Frame sets


class FrameSets:
    """The recordings of the motion, brought together by timecode. See `frame_sets`.

    ``len()`` is the number of frame sets, ``timecodes`` names each, ``keyframes`` holds the poses set by hand.
    """

    def __init__(self, readers: Sequence[VideoReader | None], starts: Sequence[int], first: int, count: int) -> None:
        self._readers = readers
        self._starts = starts  # of each camera's index 0, on the common clock
        self._first = first  # of the first frame set, on the common clock
        rate = next(reader.frame_rate for reader in readers if reader is not None)
        self.timecodes: tuple[str, ...] = tuple(frames_to_timecode(first + k, rate) for k in range(count))
        self.keyframes: tuple[Keyframe, ...] = ()

    def __len__(self) -> int:
        return len(self.timecodes)

    def __iter__(self) -> Iterator[FrameSet]:
        return self.between(0, len(self))

    def between(self, start: int, stop: int) -> Iterator[FrameSet]:
        """Frame sets ``start`` to ``stop`` - 1, in order.

        The cameras are decoded side by side, one frame set ahead of the caller; memory does not grow with the length.
        """
        views = [self._view(camera, start, stop) for camera in range(len(self._readers))]
        with ThreadPoolExecutor(max_workers=len(views)) as pool:
            ahead = [pool.submit(next, view) for view in views] if start < stop else []
            for index in range(start, stop):
                images = tuple(future.result() for future in ahead)
                if index + 1 < stop:
                    ahead = [pool.submit(next, view) for view in views]
                yield FrameSet(index=index, timecode=self.timecodes[index], images=images)

    def _view(self, camera: int, start: int, stop: int) -> Iterator[Image | None]:
        """One camera's image for each of the frame sets, None where it has none."""
        reader = self._readers[camera]
        offset = self._first - self._starts[camera]
        frames = iter(()) if reader is None else reader.read(start + offset, stop + offset)
        index, image = next(frames, (stop + offset, None))
        for wanted in range(start + offset, stop + offset):
            if index == wanted:
                yield image
                index, image = next(frames, (stop + offset, None))
            else:
                yield None


def frame_sets(capture: Capture) -> FrameSets:
    """Align the cameras' recordings of the motion by timecode.

    The range is what all cameras with a recording have in common. Within it a frame that a camera dropped is None, and
    so is every view of a camera that recorded no motion. Raises PzcapError if no camera recorded the motion, the
    recordings do not overlap, or a keyframe lies outside them.
    """
    readers = [None if camera.motion is None else VideoReader(camera.motion) for camera in capture.cameras]
    recorded = [reader for reader in readers if reader is not None]
    if not recorded:
        raise PzcapError(f'{capture.folder / MANIFEST}: no camera has a "motion" video; name at least one')
    day = frames_per_day(capture.frame_rate)
    clocks = [_start(reader, capture.frame_rate) for reader in recorded]
    # A clock that passed midnight before another was started is a day ahead of it, not a day behind.
    unwrapped = iter([clocks[0] + (clock - clocks[0] + day // 2) % day - day // 2 for clock in clocks])
    starts = [0 if reader is None else next(unwrapped) for reader in readers]
    spans = [
        (start + int(reader.indices[0]), start + int(reader.indices[-1]) + 1)
        for reader, start in zip(readers, starts, strict=True)
        if reader is not None
    ]
    first, stop = max(span[0] for span in spans), min(span[1] for span in spans)
    if first >= stop:
        raise PzcapError(
            f"{capture.folder}: the motion videos have no timecode in common; check that the clocks were synchronised"
        )
    sets = FrameSets(readers, starts, first, stop - first)
    keyframes = []
    for timecode, pose in capture.keyframe_poses.items():
        index = (timecode_to_frames(timecode, capture.frame_rate) - first) % day
        if index >= len(sets):
            raise PzcapError(
                f"{capture.folder}: the keyframe at {timecode} lies outside the recordings' common range"
                f" {sets.timecodes[0]} to {sets.timecodes[-1]}; correct its timecode or remove it"
            )
        keyframes.append(Keyframe(frame=index, pose=pose))
    sets.keyframes = tuple(sorted(keyframes, key=lambda keyframe: keyframe.frame))
    return sets


def _start(reader: VideoReader, rate: Fraction) -> int:
    """Frames since midnight of a recording's index 0."""
    if reader.timecode is None:
        raise PzcapError(f"{reader.path}: the video holds no SMPTE timecode; export it again with its timecode track")
    try:
        return timecode_to_frames(reader.timecode, rate)
    except PzcapError as error:
        raise PzcapError(f"{reader.path}: {error}") from error


# --------------------------------------------------------------------------------------------------------------
# The JSON files


@dataclass(frozen=True, slots=True)
class _Json:
    """A JSON value that knows where it stands, so that a complaint can say it."""

    value: Any
    path: Path
    where: str = ""

    def error(self, problem: str) -> PzcapError:
        return PzcapError(f"{self.path}: {self.where + ': ' if self.where else ''}{problem}")

    def __getitem__(self, key: str) -> _Json:
        if not isinstance(self.value, dict):
            raise self.error("must be a JSON object; see docs/capture.md")
        if key not in self.value:
            raise self.error(f'"{key}" is missing; add it (docs/capture.md)')
        return _Json(self.value[key], self.path, f"{self.where}.{key}" if self.where else key)

    def list(self) -> list[_Json]:
        if not isinstance(self.value, list):
            raise self.error("must be a JSON list; see docs/capture.md")
        return [_Json(value, self.path, f"{self.where}[{i}]") for i, value in enumerate(self.value)]

    def text(self) -> str:
        if not isinstance(self.value, str) or not self.value:
            raise self.error("must be text in quotes")
        return self.value

    def boolean(self) -> bool:
        if not isinstance(self.value, bool):
            raise self.error("must be true or false")
        return self.value

    def length(self) -> float:
        """A positive number of metres."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float) or not 0 < self.value < 100:
            raise self.error("must be a length in metres, above 0")
        return float(self.value)

    def array(self, *shape: int) -> Array:
        """Finite numbers; a -1 in ``shape`` stands for any length."""
        try:
            array = np.array(self.value, np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        fits = array.ndim == len(shape) and all(w in (-1, n) for w, n in zip(shape, array.shape, strict=True))
        if not fits or not np.isfinite(array).all():
            raise self.error(f"must be {' x '.join('n' if n < 0 else str(n) for n in shape)} finite numbers")
        return array

    def file(self, key: str, folder: Path) -> Path | None:
        """An optional file, which must exist if it is named."""
        if not isinstance(self.value, dict) or self.value.get(key) is None:
            return None
        path = folder / self[key].text()
        if not path.is_file():
            raise self[key].error(f"the file {path} is missing; bring it, or put null in its place")
        return path


def _load(path: Path, remedy: str) -> _Json:
    try:
        return _Json(json.loads(path.read_text(encoding="utf-8")), path)
    except OSError as error:
        raise PzcapError(f"{path}: cannot be read ({error.strerror}); {remedy}") from error
    except ValueError as error:
        raise PzcapError(f"{path}: is not valid JSON ({error}); correct it there") from error


def _dump(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def _frame_rate(entry: _Json) -> Fraction:
    try:
        rate = Fraction(entry.text())
    except (ValueError, ZeroDivisionError) as error:
        raise entry.error('must be a fraction in quotes, such as "30/1"') from error
    if rate <= 0:
        raise entry.error("must be above 0")
    return rate


def _read_camera(entry: _Json, folder: Path) -> CameraFiles:
    reference, sweep, zoom, motion = (entry.file(kind, folder) for kind in ("reference", "sweep", "zoom", "motion"))
    return CameraFiles(entry["name"].text(), reference, sweep, zoom, motion)


def _check_videos(camera: CameraFiles, rate: Fraction) -> None:
    """One size for all that a camera recorded; timecode and the right frame rate on the motion."""
    sizes: dict[Path, tuple[int, int]] = {}
    if camera.reference is not None:
        height, width = read_image(camera.reference).shape[:2]
        sizes[camera.reference] = (width, height)
    for path in (camera.sweep, camera.zoom, camera.motion):
        if path is None:
            continue
        reader = VideoReader(path)
        sizes[path] = (reader.width, reader.height)
        if path == camera.motion:
            if reader.frame_rate != rate:
                raise PzcapError(
                    f"{path}: has {reader.frame_rate} frames/s where {MANIFEST} says {rate}; correct one of them"
                )
            _start(reader, rate)
    if len(set(sizes.values())) > 1:
        listing = ", ".join(f"{path.name} {width}x{height}" for path, (width, height) in sizes.items())
        raise PzcapError(f"{next(iter(sizes)).parent}: one size is needed for all files of a camera, not {listing}")


def _read_object(path: Path) -> CalibrationObject:
    root = _load(path, "write it (docs/capture.md)")
    dictionary = root["dictionary"].text()
    if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
        raise root["dictionary"].error(f'OpenCV knows no ArUco dictionary "{dictionary}"; such as "DICT_4X4_50"')
    markers = []
    for entry in root["markers"].list():
        number = entry["id"].value
        if isinstance(number, bool) or not isinstance(number, int) or number < 0:
            raise entry["id"].error("must be a whole number, 0 or above")
        markers.append(Marker(number, entry["corners_m"].array(4, 3)))
    if not markers or len({marker.id for marker in markers}) < len(markers):
        raise root["markers"].error("list at least one marker, each with an id of its own")
    wireframe = root["wireframe_m"].array(-1, 2, 3) if root.value.get("wireframe_m") else np.zeros((0, 2, 3))
    return CalibrationObject(dictionary, tuple(markers), wireframe)


def _read_subject(path: Path) -> Subject:
    root = _load(path, "write it (docs/capture.md)")
    entry = root["measurements_m"]
    if not isinstance(entry.value, dict):
        raise entry.error("must be a JSON object of lengths in metres")
    for name in entry.value:
        if name not in MEASUREMENTS:
            near = difflib.get_close_matches(name, MEASUREMENTS, n=3, cutoff=0.4) or MEASUREMENTS
            raise entry.error(f'unknown measurement "{name}"; the nearest are {", ".join(near)}')
    return Subject({name: entry[name].length() for name in MEASUREMENTS}, root["sigma_m"].length())


def _read_keyframes(path: Path, rate: Fraction) -> dict[str, Pose]:
    root = _load(path, "write it (docs/capture.md)")
    poses: dict[str, Pose] = {}
    for entry in root.list():
        try:
            timecode = frames_to_timecode(timecode_to_frames(entry["timecode"].text(), rate), rate)
        except PzcapError as error:
            raise entry.error(str(error)) from error
        if timecode in poses:
            raise entry.error(f"a second keyframe at {timecode}; remove one")
        table = entry["rotations_wxyz"]
        for name in table.value if isinstance(table.value, dict) else ():
            if name not in SEGMENTS:
                raise table.error(f'unknown segment "{name}"; the segments are {", ".join(SEGMENTS)}')
        rotations = np.stack([table[segment].array(4) for segment in SEGMENTS])
        norms = np.linalg.norm(rotations, axis=1, keepdims=True)
        if abs(norms[worst := int(np.argmax(np.abs(norms - 1))), 0] - 1) > _UNIT_TOLERANCE:
            raise table[SEGMENTS[worst]].error(f"the quaternion's length is {norms[worst, 0]:.4g}; it must be 1")
        poses[timecode] = Pose(entry["root_position_m"].array(3), rotations / norms)
    if not poses:
        raise root.error('holds no keyframe; add one, or put null at "keyframes" in capture.json')
    return poses
