"""`pzcap keypoints`: a detector that the user has installed, run over the motion of each camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pzcap.command.footage_files import keypoints_beside
from pzcap.extras.detectors import coco_results, detector
from pzcap.io.capture import MANIFEST, read_capture
from pzcap.io.files import write_json
from pzcap.io.manifest import load_json
from pzcap.io.video import VideoReader
from pzcap.types import PzcapError


def detect_keypoints(folder: Path, by: str, models: Sequence[Path], *, replace: bool) -> int:
    """Write a file of keypoints beside each camera's motion and name it in capture.json; the exit status."""
    capture = read_capture(folder)
    filmed = [camera for camera in capture.cameras if camera.motion is not None]
    if not filmed:
        raise PzcapError(f'{folder / MANIFEST}: no camera has a "motion" video; name at least one')
    there = [camera.name for camera in filmed if camera.keypoints is not None]
    if there and not replace:
        raise PzcapError(f"{folder}: camera {', '.join(there)} has keypoints already; give --replace to find them anew")
    detect = detector(by, models)
    manifest = load_json(folder / MANIFEST).value
    entries = {entry["name"]: entry for entry in manifest["cameras"]}
    for camera in filmed:
        assert camera.motion is not None
        reader = VideoReader(camera.motion)
        pictures = (image for _, image in reader.read(int(reader.indices[0]), int(reader.indices[-1]) + 1))
        found = list(coco_results(pictures, detect))
        path = keypoints_beside(camera.motion)
        write_json(path, found, indent=None)
        entries[camera.name] |= {"keypoints": path.relative_to(folder).as_posix(), "keypoints_from": 0}
        pictured = len({entry["image_id"] for entry in found})
        print(f"camera {camera.name}: somebody in {pictured} of {len(reader.indices)} pictures; {path}")
    write_json(folder / MANIFEST, manifest)
    return 0
