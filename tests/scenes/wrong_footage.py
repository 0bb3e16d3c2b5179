"""Captures in which something is wrong: another one's files, linked, but for what a fault changes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from pzcap.io.capture import MANIFEST
from pzcap.io.video import VideoReader
from pzcap.types import Image

Change = Callable[[Path], None]


def linked(capture: Path, folder: Path) -> Path:
    """A copy of a capture whose files are links, of its first two cameras: more of them tell no more."""
    for path in sorted(capture.rglob("*")):
        place = folder / path.relative_to(capture)
        if path.is_dir():
            place.mkdir(parents=True, exist_ok=True)
        elif path.name != MANIFEST:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to(path.resolve())
    content = json.loads((capture / MANIFEST).read_text())
    content["cameras"] = content["cameras"][:2]
    (folder / MANIFEST).write_text(json.dumps(content))
    return folder


def swap(kind: str, one: str = "camera1", other: str = "camera2") -> Change:
    """The files of a kind, of two cameras, in each other's place."""

    def change(folder: Path) -> None:
        first, second = folder / one / kind, folder / other / kind
        here, there = first.readlink(), second.readlink()
        for path, target in ((first, there), (second, here)):
            path.unlink()
            path.symlink_to(target)

    return change


def drawn(kind: str, draw: Callable[[Image], Image], camera: str = "camera1") -> Change:
    """Every picture of a file of a camera drawn anew."""

    def change(folder: Path) -> None:
        path = folder / camera / kind
        source = path.resolve()
        path.unlink()
        if path.suffix == ".png":
            image = cv2.imread(str(source))
            assert image is not None
            cv2.imwrite(str(path), draw(np.asarray(image, np.uint8)))
            return
        reader = VideoReader(source)
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=reader.frame_rate, options={"crf": "10"})
            stream.width, stream.height, stream.pix_fmt = reader.width, reader.height, "yuv420p"
            if reader.timecode:
                container.metadata["timecode"] = reader.timecode
            for _, image in reader:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(draw(image), format="bgr24")))
            container.mux(stream.encode())

    return change


def mirror(image: Image) -> Image:
    return np.ascontiguousarray(image[:, ::-1])


def longer(times: float) -> Callable[[Image], Image]:
    """As a focal length so many times as long shows it."""

    def draw(image: Image) -> Image:
        height, width = image.shape[:2]
        larger = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0.0, times)
        return np.asarray(cv2.warpAffine(image, larger, (width, height)), np.uint8)

    return draw


def upside_down(image: Image) -> Image:
    return np.ascontiguousarray(image[::-1, ::-1])


def lower(pixels: int) -> Callable[[Image], Image]:
    """The picture of a camera that looks higher: all stands lower in it."""
    return lambda image: np.ascontiguousarray(np.pad(image, ((pixels, 0), (0, 0), (0, 0)), mode="edge")[:-pixels])


def brighter(factor: float) -> Callable[[Image], Image]:
    return lambda image: cv2.convertScaleAbs(image, alpha=factor).astype(np.uint8)


def flickering(share: float) -> Callable[[Image], Image]:
    """Lamps that are caught now bright, now dark."""
    rng = np.random.default_rng(0)
    return lambda image: cv2.convertScaleAbs(image, alpha=1.0 + share * rng.normal()).astype(np.uint8)


def manifest(**entries: Any) -> Change:
    """Other entries in capture.json."""

    def change(folder: Path) -> None:
        content = json.loads((folder / MANIFEST).read_text()) | entries
        (folder / MANIFEST).write_text(json.dumps(content))

    return change


def without(kind: str, camera: int = 0) -> Change:
    """A file of a camera that was not brought home."""

    def change(folder: Path) -> None:
        content = json.loads((folder / MANIFEST).read_text())
        content["cameras"][camera][kind] = None
        (folder / MANIFEST).write_text(json.dumps(content))

    return change


def other_object(folder: Path) -> None:
    """object.json of another object: one whose markers, as large as these, stand twice as far apart along y."""
    path = folder / "object.json"
    content = json.loads(path.read_text())
    path.unlink()
    for marker in content["markers"]:
        further = sum(y for _, y, _ in marker["corners_m"]) / 4.0
        marker["corners_m"] = [[x, y + further, z] for x, y, z in marker["corners_m"]]
    path.write_text(json.dumps(content))


def other_size(factor: float) -> Change:
    """object.json of an object that is larger by a factor in all its parts, about its middle on the floor."""

    def change(folder: Path) -> None:
        path = folder / "object.json"
        content = json.loads(path.read_text())
        path.unlink()
        for marker in content["markers"]:
            marker["corners_m"] = (factor * np.array(marker["corners_m"])).tolist()
        path.write_text(json.dumps(content))

    return change


def other_person(factor: float) -> Change:
    """subject.json of somebody who is taller by a factor."""
    return _remeasured(lambda _, each: factor * each)


def misread(measurement: str, by_m: float) -> Change:
    """subject.json with one measurement off."""
    return _remeasured(lambda name, each: each + by_m if name == measurement else each)


def _remeasured(change_of: Callable[[str, float], float]) -> Change:
    def change(folder: Path) -> None:
        path = folder / "subject.json"
        content = json.loads(path.read_text())
        path.unlink()
        content["measurements_m"] = {name: change_of(name, each) for name, each in content["measurements_m"].items()}
        path.write_text(json.dumps(content))

    return change


def of_another(kind: str, camera: str = "camera1", other: str = "camera2") -> Change:
    """A file of a camera, replaced by another camera's."""

    def change(folder: Path) -> None:
        path = folder / camera / kind
        path.unlink()
        path.symlink_to((folder / other / kind).readlink())

    return change


def once_more(marker: int, dictionary: int = cv2.aruco.DICT_4X4_50) -> Callable[[Image], Image]:
    """A marker of the object, lying about elsewhere in the picture as well."""
    patch = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(dictionary), marker, 40)

    def draw(image: Image) -> Image:
        image = image.copy()
        image[4:60, 4:60] = 230
        image[12:52, 12:52] = patch[..., None]
        return image

    return draw
