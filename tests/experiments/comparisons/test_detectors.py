"""Simulated detectors and a real one beside a hand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from experiments.comparisons import detectors
from experiments.comparisons.harness import Row
from experiments.config import AppConfig
from pzcap.types import PzcapError


def test_keypoints_of_the_other_side_are_told_from_those_of_the_right_one() -> None:
    rng = np.random.default_rng(0)
    pixels, mm_per_px = rng.uniform(0.0, 400.0, (12, 2)), np.full(12, 5.0)
    person = np.column_stack([pixels + np.array([2.0, 0.0]), np.ones(12)])
    person[3, 2] = 0.0  # not found
    straight, crossed = detectors._off(person, pixels, mm_per_px)
    np.testing.assert_allclose(straight, np.full(11, 10.0))
    other = person[detectors._OTHER_SIDE]
    straight, crossed = detectors._off(other, pixels, mm_per_px)
    np.testing.assert_allclose(crossed, np.full(11, 10.0))
    assert np.median(straight) > 100.0


def test_all_are_compared_on_the_same_footage() -> None:
    shoots = {key: shoot for key, _, _, shoot in detectors._shoots(AppConfig())}
    by_hand, kind, harsh = (shoots[key] for key in ("hand", "kind", "harsh"))
    assert by_hand is not None
    assert kind is not None
    assert harsh is not None
    assert (by_hand.crew.keyframes, kind.crew.keyframes, harsh.crew.keyframes) == ("hand", "none", "none")
    assert not by_hand.detector.enabled
    assert harsh.detector.exchanged > kind.detector.exchanged == 0.0
    assert by_hand.sensor == kind.sensor == harsh.sensor


def test_where_the_real_one_is_not_installed_its_row_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> None:
        raise PzcapError("mediapipe is not installed (No module named 'mediapipe'); pip install mediapipe")

    capture = SimpleNamespace(cameras=(), keyframe_poses={}, folder=tmp_path)
    monkeypatch.setattr(detectors, "scored_capture", lambda *_: (capture, None))
    monkeypatch.setattr(detectors, "replace", lambda one, **_: one)
    monkeypatch.setattr(detectors, "_shoots", lambda _: [("kind", "simulated, kind", "simulated", None)])
    monkeypatch.setattr(detectors, "_row", lambda named, *_: (Row(named[0], named[1], {"found": 1.0}), None))
    monkeypatch.setattr(detectors, "detector", missing)
    *_, real = detectors.compare(AppConfig(), tmp_path, Console(quiet=True))
    assert real.key == "blazepose"
    assert "pip install mediapipe" in (real.missing or "")
