"""Frames of the capture that the rows of another program's file stand for, by its own count and frames a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, PzcapError

EQUAL: Final = 0.01
"""Share by which two frame rates, or a multiple of one and the other, may differ: 29.97 is written as 30, too."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """All that a file of points says: T rows of N points."""

    names: Sequence[str]  # (N,)
    places_m: Array  # (T, N, 3) in the file's axes
    rate: float | None = None  # frames a second
    numbers: NDArray[np.int64] | None = None  # (T,) of its frames, by its own count from 0 or 1; None: it has none


@dataclass(frozen=True, slots=True)
class Asked:
    """Frames that the capture has."""

    frames: int
    rate: str  # a second, a fraction such as "30000/1001"


def frames_of(
    path: Path, points: Points, asked: Asked, first: int | None, rate: float | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of a file that fall on frames of the capture, and these frames.

    ``first`` is the frame that the file begins with, ``rate`` its frames a second where it does not say the truth.
    Raises PzcapError where the file leaves either open, has a frame twice, or has frames that the capture has not.
    """
    numbers = np.arange(len(points.places_m)) if points.numbers is None else points.numbers
    if not len(numbers):
        raise PzcapError(f"{path}: holds no frame; write it again")
    values, counts = np.unique(numbers, return_counts=True)
    if np.any(counts > 1):
        raise PzcapError(f"{path}: frame {values[np.argmax(counts)]} is there twice; give each frame once")
    if first is None and numbers[0] > 1:
        raise PzcapError(
            f"{path}: begins with frame {numbers[0]} of its own count; say --first-frame {numbers[0] - 1} if it counts "
            "the capture's frames from 1, 0 if it begins with the capture"
        )
    own, theirs = float(Fraction(asked.rate)), rate or points.rate
    since = numbers - numbers[0]
    every, apart = _steps(path, own, own if theirs is None else theirs, said=rate is not None)
    rows = np.flatnonzero(since % every == 0)
    frames = (first or 0) + since[rows] // every * apart
    if frames.min() < 0 or frames.max() >= asked.frames:
        raise PzcapError(
            f"{path}: {len(rows)} frames from {first or 0} on, of {asked.frames}; see --first-frame, or cut off what "
            "is not the capture's"
        )
    return rows, frames


def _steps(path: Path, own: float, theirs: float, *, said: bool) -> tuple[int, int]:
    """Frames of a file, and of the capture, from one that both have to the next."""
    ratio = theirs / own
    if abs(ratio - 1.0) < EQUAL:
        return 1, 1
    what = f"{path}: {theirs:g} frames a second where the capture has {own:g}"
    for many, every, apart in ((ratio, round(ratio), 1), (1.0 / ratio, 1, round(1.0 / ratio))):
        if many > 1.0 and abs(many / round(many) - 1.0) < EQUAL:
            if said:
                return every, apart
            raise PzcapError(
                f"{what}; say --rate {theirs:g} to score the frames that both have, or --rate {own:g} if the file has "
                "a frame for each of the capture's"
            )
    raise PzcapError(f"{what}; interpolate it to {own:g}, or say --rate {own:g} if it has a frame for each")
