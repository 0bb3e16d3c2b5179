"""Cameras brought together by what they see: a lamp, or the athlete."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from pzcap.synchronisation import flash, subject_motion
from pzcap.types import Array, Image

RATE = 30


def reader(frames: int) -> Any:
    return SimpleNamespace(times_s=np.arange(frames) / RATE, frame_rate=RATE)


def levels(lit: list[tuple[int, int]], frames: int, seed: int) -> Array:
    """Brightness of a camera that pans: blocks change one by one; a lamp makes all brighter."""
    rng = np.random.default_rng(seed)
    walls = np.cumsum(rng.normal(0.0, 0.08, (frames, 96)), axis=0) * 0.3 + rng.normal(4.5, 0.3, 96)
    gain = np.ones(frames)
    for start, stop in lit:
        gain[start:stop] = 1.2
    return np.asarray(walls + np.log(gain)[:, None] + rng.normal(0, 0.003, (frames, 96)))


def test_a_lamp_is_seen_by_cameras_that_pan() -> None:
    starts = (0, 17, 5)
    seen = [flash.steps(reader(80), levels([(40 - s, 48 - s)], 80, s)) for s in starts]
    found = list(flash.delays(seen))
    assert len(found) == 3
    for each in found:
        assert each.delay_s == pytest.approx((starts[each.a] - starts[each.b]) / RATE, abs=0.01)
        assert each.sigma_s < 0.5 / RATE


def test_lamps_that_fit_twice_leave_doubt() -> None:
    """Three that are lit at even intervals, of which the second camera saw two."""
    seen = [flash.steps(reader(90), levels([(20, 25), (40, 45), (60, 65)], 90, 0))]
    seen.append(flash.steps(reader(90), levels([(20, 25), (40, 45)], 90, 1)))
    assert list(flash.delays(seen)) == []


def test_a_pan_is_no_lamp() -> None:
    seen = [flash.steps(reader(80), levels([], 80, seed)) for seed in range(2)]
    assert [len(each.times_s) for each in seen] == [0, 0]


def jumping(frames: int, start: int, focal: float, seed: int) -> list[Image]:
    """A dark figure that jumps before a textured wall, filmed by a camera that pans and zooms."""
    rng = np.random.default_rng(seed)
    wall = cv2.GaussianBlur(rng.uniform(0, 255, (300, 900)).astype(np.float32), (0, 0), 3.0)
    wall = cv2.normalize(wall, None, 40, 220, cv2.NORM_MINMAX).astype(np.uint8)
    found = []
    for k in range(frames):
        t = (start + k) / RATE
        height = focal * (0.35 * abs(np.sin(2.1 * t + 0.6 * np.sin(1.3 * t))) + 0.1 * np.sin(7.0 * t))
        zoom, pan = 1.0 + 0.1 * np.sin(0.7 * t + seed), 250 + 120 * np.sin(0.5 * t + seed)
        view = cv2.warpAffine(wall, np.float32([[zoom, 0, -pan], [0, zoom, -20]]), (320, 240))
        cv2.ellipse(view, (160, int(150 - height)), (14, 34), 0, 0, 360, 15, -1)
        cv2.circle(view, (160, int(110 - height)), 9, 90, -1)
        found.append(np.repeat(view[..., None], 3, axis=2))
    return found


def test_a_jump_is_seen_from_all_sides() -> None:
    starts = (0, 12)
    signals = []
    for seed, start in enumerate(starts):
        gathered = subject_motion.RisingSignal()
        for image in jumping(110, start, 90.0 - 20.0 * seed, seed):
            gathered.add(image)
        signals.append(gathered.signal(reader(110)))
    [found] = subject_motion.delays(signals)
    assert found.delay_s == pytest.approx(-12 / RATE, abs=0.6 / RATE)


def test_a_body_that_stands_still_leaves_doubt() -> None:
    rng = np.random.default_rng(4)
    still = [subject_motion.Rising(np.arange(100) / RATE, rng.normal(0, 0.05, 100), 1 / RATE) for _ in range(3)]
    assert list(subject_motion.delays(still)) == []
