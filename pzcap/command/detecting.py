"""`pzcap keypoints`: a detector that the user has installed, run over the motion of each camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from pzcap.command.footage_files import keypoints_beside
from pzcap.command.progress import ProgressLine
from pzcap.extras.detectors import coco_results, detector
from pzcap.io.capture import MANIFEST, read_capture
from pzcap.io.files import write_json
from pzcap.io.manifest import load_json
from pzcap.io.video import VideoReader
from pzcap.types import Image, PzcapError


def detect_keypoints(folder: Path, by: str, models: Sequence[Path], *, replace: bool) -> int:
    """Write a file of keypoints beside the motion of each camera that has none, or is to have them found anew
    (``replace``), and name it in capture.json as soon as it is whole; the exit status."""
    capture = read_capture(folder)
    filmed = [camera for camera in capture.cameras if camera.motion is not None]
    if not filmed:
        raise PzcapError(f'{folder / MANIFEST}: no camera has a "motion" video; name at least one')
    lacking = [camera for camera in filmed if replace or camera.keypoints is None]
    if not lacking:
        raise PzcapError(f"{folder}: all cameras have keypoints already; give --replace to find them anew")
    detect = detector(by, models)
    manifest = load_json(folder / MANIFEST).value
    entries = {entry["name"]: entry for entry in manifest["cameras"]}
    for camera in lacking:
        assert camera.motion is not None
        reader = VideoReader(camera.motion)
        with ProgressLine() as line:
            found = list(coco_results(_pictures(reader, f"camera {camera.name}", line), detect))
        path = keypoints_beside(camera.motion)
        write_json(path, found, indent=None)
        entries[camera.name] |= {"keypoints": path.relative_to(folder).as_posix(), "keypoints_from": 0}
        write_json(folder / MANIFEST, manifest)
        pictured = len({entry["image_id"] for entry in found})
        print(f"camera {camera.name}: somebody in {pictured} of {len(reader.indices)} pictures; {path}")
    return 0


def _pictures(reader: VideoReader, stage: str, line: ProgressLine) -> Iterator[Image]:
    count = len(reader.indices)
    for done, (_, image) in enumerate(reader.read(int(reader.indices[0]), int(reader.indices[-1]) + 1)):
        line.update(stage, done, count)
        yield image
