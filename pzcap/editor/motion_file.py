"""The motion with what was tracked anew on the page, kept beside the capture."""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.io.files import written_whole
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
            with np.load(self.path, allow_pickle=False) as file:
                base, motion = str(file["base"]), Motion(**{name: file[name] for name in _ARRAYS})
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise PzcapError(f"{self.path}: damaged ({error}); remove it, and solve again on the page") from error
        return motion if base == self.base and len(motion.valid) == frames else None

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
