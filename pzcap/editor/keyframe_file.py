"""keyframes.json as the editor writes it: what nobody has touched stands as it was."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pzcap.editor.paper import Paper
from pzcap.io.manifest import covariance_entry
from pzcap.types import SEGMENTS, Array, Pose


class KeyframeFile:
    """The keyframes of a capture folder. ``backups`` is a folder for what was replaced."""

    def __init__(self, folder: Path, backups: Path) -> None:
        self.paper = Paper(folder, "keyframes", backups)

    def entries(self) -> dict[str, dict[str, Any]]:
        """The entries by timecode, with colons, as they stand in the file."""
        return {str(entry["timecode"]).replace(";", ":"): entry for entry in self.paper.entries()}

    def write(self, poses: Mapping[str, Pose], covariances: Mapping[str, Array]) -> str | None:
        """Replace the file by ``poses`` by timecode, in their order, with the ``covariances`` (43, 43) of those that
        clicks tell of; an entry that says the same stands as it was. Returns the new digest; None where all is as it
        was."""
        before = self.entries()
        untouched = {
            timecode: entry
            for timecode, entry in before.items()
            if timecode in poses
            and same_pose(poses[timecode], _pose_of(entry))
            and (timecode not in covariances or entry.get("covariance") == covariance_entry(covariances[timecode]))
        }
        if untouched.keys() == poses.keys() == before.keys():
            return None
        return self.paper.replace(
            [
                untouched.get(timecode) or _entry(timecode, pose, covariances.get(timecode))
                for timecode, pose in poses.items()
            ]
        )


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
