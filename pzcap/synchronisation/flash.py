"""Delays between cameras by a lamp that is lit, or a flash: all the picture grows brighter from one frame to the next,
whatever the camera does meanwhile."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import cv2
import numpy as np

from pzcap.io.video import VideoReader
from pzcap.solver.robust import normal_sigma
from pzcap.synchronisation.offsets import Delay
from pzcap.synchronisation.tuning import FLASH
from pzcap.types import Array, Image

_FRAME_SIGMA: Final = float(np.sqrt(2.0 / 12.0))  # each camera takes it up to a frame late


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Sudden changes of a recording's brightness."""

    times_s: Array  # (N,) by the file's clock
    sizes: Array  # (N,) of the logarithm
    frame_s: float


def brightness(image: Image) -> Array:
    """(96,) logarithm of the brightness of the blocks of a picture."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    small = cv2.resize(grey, FLASH.blocks, interpolation=cv2.INTER_AREA).astype(np.float64)
    return np.asarray(np.log(small.ravel() + 4.0))


def steps(reader: VideoReader, levels: Array) -> Steps:
    """The steps of a recording of which every picture's `brightness` (N, 96) is known."""
    change = np.median(np.diff(levels, axis=0), axis=1)
    # a camera that pans changes blocks one by one, and a lamp nearly all of them alike
    usual = normal_sigma(change - np.median(change)) if len(change) else 0.0
    found = np.flatnonzero(np.abs(change) > max(FLASH.step, FLASH.clear * usual))
    return Steps(reader.times_s[found + 1], change[found], 1.0 / float(reader.frame_rate))


def delays(recordings: Sequence[Steps]) -> Iterator[Delay]:
    """Those delays between pairs of cameras that their steps give without doubt."""
    for a, b in combinations(range(len(recordings)), 2):
        one, other = recordings[a], recordings[b]
        frame_s = max(one.frame_s, other.frame_s)
        found = _matched(one, other, 1.25 * frame_s)
        if found is not None:
            yield Delay(a, b, found[0], _FRAME_SIGMA * frame_s / np.sqrt(found[1]))


def _matched(one: Steps, other: Steps, within_s: float) -> tuple[float, int] | None:
    """Delay that brings most steps of two recordings together, and how many; None without one, or with several."""
    candidates = []
    for time, size in zip(one.times_s, one.sizes, strict=True):
        for there, height in zip(other.times_s, other.sizes, strict=True):
            if np.sign(size) == np.sign(height):
                candidates.append(there - time)
    if not candidates:
        return None
    best: list[tuple[int, float]] = []
    for delay in candidates:
        off = one.times_s[:, None] + delay - other.times_s[None]
        same = np.sign(one.sizes)[:, None] == np.sign(other.sizes)[None]
        near = np.where(same & (np.abs(off) < within_s), np.abs(off), np.inf)
        pairs = [(i, int(np.argmin(row))) for i, row in enumerate(near) if np.isfinite(row.min())]
        best.append((len({j for _, j in pairs}), float(delay - np.mean([off[i, j] for i, j in pairs]))))
    count, delay = max(best)
    if any(number == count and abs(other_delay - delay) > within_s for number, other_delay in best):
        return None
    return delay, count
