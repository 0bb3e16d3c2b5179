"""Motions, one module each, found by name: a module of this package with a function ``make`` is a motion.

To add one, write ``sim/motion/NAME.py`` with ``make(measurements, rng) -> MotionClip``; nothing else is to be edited.
Modules whose names begin with an underscore are shared by the motions. A name that ends in ``.bvh`` is a file's.
"""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from pathlib import Path

import numpy as np

from pzcap.types import PzcapError
from sim.motion._bvh import read_bvh
from sim.motion._clip import END_POINTS, FRAME_RATE, MotionClip
from sim.motion._retarget import retarget

__all__ = ["END_POINTS", "FRAME_RATE", "MotionClip", "file_of", "make", "names", "title"]


def names() -> tuple[str, ...]:
    """Return the names of all motions."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_")))


def file_of(name: str) -> Path | None:
    """Return the BVH file that a motion's name is, or None if it is a module's."""
    return Path(name) if name.lower().endswith(".bvh") else None


def title(name: str) -> str:
    """Return a motion's name, without folder and ending if it is a file's."""
    file = file_of(name)
    return file.stem if file else name


def make(name: str, measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Make the motion of this name for a person with these measurements (metres).

    Raises PzcapError, with the nearest names, when there is no such motion, and when a file cannot be used.
    """
    file = file_of(name)
    if file:
        return retarget(read_bvh(file), measurements)
    if name not in names():
        near = difflib.get_close_matches(name, names(), n=3, cutoff=0.0)
        raise PzcapError(f"there is no motion '{name}' in sim/motion; the nearest are {', '.join(near)}")
    clip = importlib.import_module(f"{__name__}.{name}").make(measurements, rng)
    assert isinstance(clip, MotionClip)
    return clip
