"""The motion with what was tracked anew on the page, kept beside the capture."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from pzcap.io.arrays import read_arrays
from pzcap.io.files import checked, written_whole
from pzcap.io.record_checks import check_array, check_record
from pzcap.types import Motion, PzcapError

_ARRAYS: Final = ("root_position_m", "rotations", "joints_m", "sigma_m", "keyframes", "valid")


@dataclass(frozen=True, slots=True)
class MotionFile:
    """A file of a motion that was edited, begun from the motion of results by their digest."""

    path: Path
    base: str

    def load(self, frames: int) -> Motion | None:
        """The motion of so many frames; None where there is none, or others have been made since."""
        if not self.path.is_file():
            return None
        try:
            found = read_arrays(checked(self.path))
            base = str(found["base"])
            arrays: dict[str, Any] = {name: found[name] for name in _ARRAYS}
            for name, array in arrays.items():
                check_array(Motion, name, array, name)
        except (OSError, ValueError, KeyError, PzcapError) as error:
            raise PzcapError(f"{self.path}: damaged ({error}); remove it, and solve again on the page") from error
        if base != self.base or len(arrays["valid"]) != frames:
            return None
        motion = Motion(**arrays)
        check_record(motion, arrays, str(self.path), frames)
        return motion

    def save(self, motion: Motion) -> None:
        """Keep the motion."""
        with written_whole(self.path) as partial, partial.open("wb") as file:
            arrays = {name: getattr(motion, name) for name in _ARRAYS}
            np.savez_compressed(file, allow_pickle=False, base=np.array(self.base), **arrays)


def digest_of(motion: Motion | None) -> str:
    """By which a motion is known again."""
    if motion is None:
        return ""
    return hashlib.sha256(motion.root_position_m.tobytes() + motion.rotations.tobytes()).hexdigest()
