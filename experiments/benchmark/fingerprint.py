"""Are these the captures of the release? By hash on a machine of the same kind, by tolerance on any other.

Rendering and compression give the same bytes on one kind of machine, with the same versions of what renders and
compresses. Elsewhere a pixel may differ by a grey level: then the means of blocks of some frames are compared, and the
number of frames.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from experiments.metrics import machine, versions
from pzcap.io.capture import read_capture, read_image
from pzcap.io.files import checked, write_bytes
from pzcap.io.video import VideoReader
from pzcap.types import Image, PzcapError

BLOCKS: Final = (8, 6)
"""Columns and rows of the blocks of a frame."""
GREY_LEVELS: Final = 1.0
"""A block's mean may differ by this much. Another noise level, seed or motion differs by more in some block."""
DEPENDS: Final = ("numpy", "opencv-python-headless", "av", "mujoco")
"""Packages whose version the bytes depend on."""


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """Features of one capture that are compared."""

    files: dict[str, str]
    """Path in the capture -> SHA-256."""
    frames: dict[str, int]
    """Video -> number of its frames."""
    blocks: dict[str, list[float]]
    """Video or image, and frame -> means of its blocks, grey levels."""


def kind() -> dict[str, Any]:
    """Machine and libraries on which the bytes of a shoot depend, besides its configuration."""
    found = versions()
    return {"cpu": machine()["cpu"], "versions": {name: found.get(name, "") for name in DEPENDS}}


def fingerprint(capture: Path) -> Fingerprint:
    """The fingerprint of a capture folder."""
    files = {
        path.relative_to(capture).as_posix(): hashlib.sha256(checked(path).read_bytes()).hexdigest()
        for path in sorted(capture.rglob("*"))
        if path.is_file()
    }
    frames: dict[str, int] = {}
    blocks: dict[str, list[float]] = {}
    for camera in read_capture(capture).cameras:
        if camera.reference is not None:
            blocks[_name(camera.reference, capture)] = _means(read_image(camera.reference))
        for video in (camera.sweep, camera.zoom, camera.motion):
            if video is None:
                continue
            name = _name(video, capture)
            kept: dict[int, Image] = {}
            count = 0
            for count, (_, image) in enumerate(VideoReader(video), start=1):
                if count == 1 or count & (count - 1) == 0:  # first, second, fourth ...: of short and long ones alike
                    kept[count - 1] = image
            frames[name] = count
            blocks |= {f"{name} {number}": _means(image) for number, image in kept.items()}
    return Fingerprint(files, frames, blocks)


def _name(path: Path, capture: Path) -> str:
    return path.relative_to(capture).as_posix()


def _means(image: Image) -> list[float]:
    small = cv2.resize(image, BLOCKS, interpolation=cv2.INTER_AREA).astype(np.float64).mean(axis=2)
    return [round(float(value), 2) for value in small.ravel()]


def differences(found: Fingerprint, frozen: Fingerprint, same_kind: bool) -> Iterator[str]:
    """Differences from the captures as they were when the release was frozen, a line each."""
    for missing in sorted(frozen.files.keys() ^ found.files.keys()):
        yield f"{missing}: {'missing' if missing in frozen.files else 'is not of the release'}"
    if same_kind:
        for name in sorted(frozen.files.keys() & found.files.keys()):
            if frozen.files[name] != found.files[name]:
                yield f"{name}: another content ({found.files[name][:12]}, frozen {frozen.files[name][:12]})"
        return
    for name, count in frozen.frames.items():
        if found.frames.get(name) != count:
            yield f"{name}: {found.frames.get(name, 0)} frames where the release has {count}"
    for name, means in frozen.blocks.items():
        apart = np.abs(np.array(found.blocks.get(name, [np.inf])) - np.array(means)).max()
        if apart > GREY_LEVELS:
            yield f"{name}: differs by {apart:.2g} grey levels, where {GREY_LEVELS:g} is allowed"


def write_manifest(path: Path, release: str, split: str, found: Mapping[str, Fingerprint]) -> None:
    """Write what the captures of a split are, and where they were shot."""
    captures = {name: asdict(one) for name, one in found.items()}
    content = {"release": release, "split": split, "kind": kind(), "captures": captures}
    write_bytes(path, (json.dumps(content, separators=(",", ":"), sort_keys=True) + "\n").encode())


def read_manifest(path: Path) -> tuple[dict[str, Any], dict[str, Fingerprint]]:
    """The kind of machine and the fingerprints of a manifest. Raises PzcapError where it is none."""
    try:
        content = json.loads(checked(path).read_text(encoding="utf-8"))
        return dict(content["kind"]), {name: Fingerprint(**one) for name, one in content["captures"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise PzcapError(f"{path}: no readable manifest ({error}); make the split again") from error


def compared(found: Mapping[str, Fingerprint], frozen: Path) -> tuple[str, list[str]]:
    """Comparison of the captures with the frozen ones: by hash or tolerance, and the differences."""
    if not frozen.is_file():
        return "not frozen yet: nothing to compare with", []
    where, wanted = read_manifest(frozen)
    same_kind = where == kind()
    lines = [f"{name}: not made" for name in sorted(wanted.keys() - found.keys())]
    for name in sorted(found):
        if name not in wanted:
            lines.append(f"{name}: is not of the release")
            continue
        lines += [f"{name}/{line}" for line in differences(found[name], wanted[name], same_kind)]
    return ("by hash: a machine of the same kind" if same_kind else "by tolerance: a machine of another kind"), lines
