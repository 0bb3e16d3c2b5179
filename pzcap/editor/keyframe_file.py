"""keyframes.json as the editor writes it: whole or not at all, what it replaces is kept, and what nobody has touched
stands as it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from pzcap.io.capture import MANIFEST
from pzcap.io.files import checked, write_bytes, write_json
from pzcap.io.manifest import covariance_entry, load_json
from pzcap.types import SEGMENTS, Array, Pose

USUAL: Final = "keyframes.json"


@dataclass(slots=True)
class KeyframeFile:
    """The keyframes of a capture folder. ``backups`` is a folder for what was replaced."""

    folder: Path
    backups: Path
    _backed_up: bool = False

    @property
    def path(self) -> Path:
        """Where capture.json says that they are, or will."""
        name = load_json(self.folder / MANIFEST).value.get("keyframes")
        return self.folder / (name or USUAL)

    def digest(self) -> str:
        """Of the file's content; empty where capture.json names none."""
        named = load_json(self.folder / MANIFEST).value.get("keyframes")
        path = self.folder / (named or USUAL)
        return hashlib.sha256(checked(path).read_bytes()).hexdigest() if named and path.is_file() else ""

    def entries(self) -> dict[str, dict[str, Any]]:
        """The entries by timecode, with colons, as they stand in the file."""
        if not self.digest():
            return {}
        return {str(entry["timecode"]).replace(";", ":"): entry for entry in load_json(self.path).value}

    def write(self, poses: Mapping[str, Pose], covariances: Mapping[str, Array]) -> str | None:
        """Replace the file by ``poses`` by timecode, in their order, with the ``covariances`` (43, 43) of those that
        clicks tell of; an entry that says the same stands as it was. Returns the new digest; None where all is as it
        was. Without any pose there is no file, and capture.json says so."""
        before, path = self.entries(), self.path
        untouched = {
            timecode: entry
            for timecode, entry in before.items()
            if timecode in poses
            and same_pose(poses[timecode], _pose_of(entry))
            and (timecode not in covariances or entry.get("covariance") == covariance_entry(covariances[timecode]))
        }
        if untouched.keys() == poses.keys() == before.keys():
            return None
        self._back_up(path)
        if not poses:
            self._name(None)
            path.unlink(missing_ok=True)
            return ""
        content = [
            untouched.get(timecode) or _entry(timecode, pose, covariances.get(timecode))
            for timecode, pose in poses.items()
        ]
        data = (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()
        write_bytes(path, data)
        self._name(path.name)
        return hashlib.sha256(data).hexdigest()

    def _back_up(self, path: Path) -> None:
        """Keep what this run of the editor finds."""
        if self._backed_up or not path.is_file():
            return
        now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%f")
        write_bytes(self.backups / f"keyframes-{now}.json", path.read_bytes())
        self._backed_up = True

    def _name(self, name: str | None) -> None:
        """Have capture.json name the file, or none."""
        path = self.folder / MANIFEST
        content = load_json(path).value
        if content.get("keyframes") == name or (content.get("keyframes") and name):
            return
        content["keyframes"] = name
        write_json(path, content)


def _entry(timecode: str, pose: Pose, covariance: Array | None) -> dict[str, Any]:
    known = {} if covariance is None else {"covariance": covariance_entry(covariance)}
    return {
        "timecode": timecode,
        "root_position_m": pose.root_position_m.tolist(),
        "rotations_wxyz": dict(zip(SEGMENTS, pose.rotations.tolist(), strict=True)),
        **known,
    }


def same_pose(one: Pose, other: Pose) -> bool:
    """True if two poses are the same but for rounding and the sign of quaternions."""
    turned = np.abs(np.sum(one.rotations * other.rotations, axis=1))
    return bool(np.abs(one.root_position_m - other.root_position_m).max() < 1e-9 and np.abs(turned - 1.0).max() < 1e-12)


def _pose_of(entry: dict[str, Any]) -> Pose:
    table = entry["rotations_wxyz"]
    rotations = np.array([table[name] for name in SEGMENTS], float)
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    return Pose(np.array(entry["root_position_m"], float), rotations)
