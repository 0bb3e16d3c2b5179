"""Delays between cameras by the athlete's motion: how fast all that moves in the picture rises and falls, once the
camera's own pan and zoom are taken out.

Up and down look alike from all sides, which no other direction does. The background between two frames moves by a
similarity, that of most of its corners; what then still moves is the athlete.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from pzcap.io.video import VideoReader
from pzcap.synchronisation.offsets import Delay
from pzcap.synchronisation.tuning import MOTION
from pzcap.types import Array, Image


@dataclass(frozen=True, slots=True, eq=False)
class Rising:
    """Speed by which what moves in a recording falls."""

    times_s: Array  # (N,) by the file's clock, between two frames
    speed: Array  # (N,)
    frame_s: float


class RisingSignal:
    """Gathers the signal picture by picture."""

    def __init__(self) -> None:
        self._before: Image | None = None
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
        self._speed: list[float] = []

    def add(self, image: Image) -> None:
        """Add the next picture."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        scale = MOTION.width / grey.shape[1]
        small = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
        if self._before is not None:
            self._speed.append(self._falls(self._before, small))
        self._before = small

    def signal(self, reader: VideoReader) -> Rising:
        """The signal of all pictures of ``reader``."""
        times = (reader.times_s[1:] + reader.times_s[:-1]) / 2
        return Rising(times, np.array(self._speed), 1.0 / float(reader.frame_rate))

    def _falls(self, before: Image, now: Image) -> float:
        corners = cv2.goodFeaturesToTrack(before, MOTION.corners, 0.01, 6)
        if corners is None or len(corners) < MOTION.fewest:
            return 0.0
        there, status, _ = cv2.calcOpticalFlowPyrLK(before, now, corners, np.empty_like(corners))
        kept = status.ravel() == 1
        if kept.sum() < MOTION.fewest:
            return 0.0
        similarity, _ = cv2.estimateAffinePartial2D(corners[kept], there[kept], ransacReprojThreshold=1.0)
        if similarity is None:
            return 0.0
        height, width = now.shape
        placed = cv2.warpAffine(before, similarity, (width, height), flags=cv2.INTER_LINEAR)
        inside = cv2.warpAffine(np.full_like(before, 255), similarity, (width, height), flags=cv2.INTER_NEAREST) > 0
        inside = cv2.erode(inside.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        flow = self._flow.calc(
            np.where(inside, placed, now).astype(np.uint8), now, np.zeros((height, width, 2), np.float32)
        )
        moves = inside & (np.linalg.norm(flow, axis=2) > MOTION.moves_px)
        return float(flow[..., 1][moves].sum()) / np.sqrt(float(moves.sum()) + 50.0)


def delays(signals: Sequence[Rising]) -> Iterator[Delay]:
    """Those delays between pairs of cameras that their signals give without doubt."""
    for a, b in combinations(range(len(signals)), 2):
        frame_s = max(signals[a].frame_s, signals[b].frame_s)
        found = correlated(signals[a], signals[b], frame_s / MOTION.grid)
        if found is not None:
            yield Delay(a, b, found, MOTION.frames_sigma * frame_s)


def correlated(one: Rising, other: Rising, step_s: float) -> float | None:
    """How many seconds later ``other`` moves like ``one``; None where that leaves doubt."""
    if min(len(one.speed), len(other.speed)) < 4:
        return None
    first, second = _even(one, step_s), _even(other, step_s)
    least = max(MOTION.least_s / step_s, MOTION.least_share * min(len(first), len(second)))
    lags = np.arange(-(len(first) - 1), len(second))
    overlap = np.minimum(len(first), len(second) - lags) - np.maximum(0, -lags)
    from scipy.signal import correlate  # brings all of scipy.stats: half a second, of every start otherwise

    product = correlate(second, first, "full", method="fft")
    energy_first = correlate(np.ones_like(second), first**2, "full", method="fft")
    energy_second = correlate(second**2, np.ones_like(first), "full", method="fft")
    scale = np.sqrt((energy_first * energy_second).clip(0.0))
    enough = (overlap >= least) & (scale > 1e-9)
    if not enough.any():
        return None
    correlation = np.where(enough, product / np.maximum(scale, 1e-9), -1.0)
    peak = int(np.argmax(correlation))
    far = np.abs(lags - lags[peak]) * step_s > 0.25
    height, following = float(correlation[peak]), float(correlation[far].max(initial=-1.0))
    if height < MOTION.sure or following > MOTION.next * height:
        return None
    return float(lags[peak] * step_s + other.times_s[0] - one.times_s[0])


def _even(signal: Rising, step_s: float) -> Array:
    """The signal at even steps, slow changes taken off, single frames held down."""
    times = np.arange(signal.times_s[0], signal.times_s[-1], step_s)
    limit = 4.0 * float(np.median(np.abs(signal.speed))) + 2.0 * float(np.std(signal.speed))
    values = np.interp(times, signal.times_s, np.clip(signal.speed, -limit, limit))
    smooth = max(1, round(2 * signal.frame_s / step_s))
    values = np.convolve(values, np.ones(smooth) / smooth, "same")
    return np.asarray(values - values.mean())
