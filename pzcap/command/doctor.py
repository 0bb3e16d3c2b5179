"""`pzcap doctor`: what is installed, what is missing, and the line to type."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Final

from pzcap.export.fbx import BLENDER
from pzcap.export.formats import FORMATS


@dataclass(frozen=True, slots=True)
class Part:
    """Something that may be installed."""

    name: str  # as it is imported
    package: str
    serves: str
    line: str  # that installs it
    needed: bool = False  # nothing works without it


_NEEDED: Final = "pip install pzcap"
PARTS: Final[tuple[Part, ...]] = (
    Part("numpy", "numpy", "everything", _NEEDED, True),
    Part("scipy", "scipy", "everything", _NEEDED, True),
    Part("cv2", "opencv-python-headless", "everything", _NEEDED, True),
    Part("numba", "numba", "everything", _NEEDED, True),
    Part("av", "av", "video", _NEEDED, True),
    Part("loky", "loky", "the body", _NEEDED, True),
    Part("ezc3d", "ezc3d", "pzcap export --to c3d", "pip install 'pzcap[export]'"),
    Part("pxr", "usd-core", "pzcap export --to usd, fbx", "pip install 'pzcap[export]'"),
    Part("pygltflib", "pygltflib", "pzcap export --to gltf", "pip install 'pzcap[export]'"),
    Part("aiohttp", "aiohttp", "pzcap edit, pzcap lengths", "pip install 'pzcap[editor]'"),
    Part("mediapipe", "mediapipe", "pzcap keypoints --by mediapipe", "pip install mediapipe"),
    Part("rtmlib", "rtmlib", "pzcap keypoints --by rtmlib", "pip install rtmlib"),
    Part("rerun", "rerun-sdk", "recordings, pzcap review", "pip install 'pzcap[rerun]'"),
)


def report() -> int:
    """Print what there is; the exit status, 1 where something needed is missing."""
    print("\n".join(_lines()))
    return int(any(part.needed and _version(part) is None for part in PARTS))


def _lines() -> Iterator[str]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield f"Python {platform.python_version()} at {sys.executable}, {cores} cores"
    for part in PARTS:
        found = _version(part)
        state = found or ("MISSING" if part.needed else "missing")
        yield f"  {part.package:24} {state:12} {part.serves}" + ("" if found else f"; {part.line}")
    program = shutil.which(BLENDER)
    cure = "" if program else "; install Blender 4.2 or newer and put it on the PATH"
    yield f"  {BLENDER:24} {program or 'missing':12} pzcap export --to fbx{cure}"
    yield "formats of pzcap export --to:"
    yield from (f"  {name:12} {form.title}" for name, form in FORMATS.items())


def _version(part: Part) -> str | None:
    """The version that is installed; None if it is not. A package's name may stand where another build's does."""
    if importlib.util.find_spec(part.name) is None:
        return None
    try:
        return version(part.package)
    except PackageNotFoundError:
        return "installed"
