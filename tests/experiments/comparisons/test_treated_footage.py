"""Treatments of the pictures of a capture, and what is counted of them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from experiments.comparisons import treated_footage as treated
from experiments.comparisons.treated_footage import TREATMENTS, TreatedFootageConfig, Treatment
from experiments.progress import Bars
from pzcap.io.capture import read_capture, read_image
from pzcap.io.video import VideoReader
from pzcap.types import Capture, Image, PzcapError
from tests.scenes.fabricated import reconstruction

pytestmark = pytest.mark.xdist_group("experiments")
BY_KEY = {treatment.key: treatment for treatment in TREATMENTS}
NOISE_SIGMA = 3.0
CODEC = 3.0
"""Grey levels by which pictures change, in the mean, where they are encoded anew."""


@pytest.fixture(scope="module")
def capture(small_capture: Path) -> Capture:
    return read_capture(small_capture / "capture")


def pictures(path: Path | None) -> list[Image]:
    assert path is not None
    return [image for _, image in VideoReader(path)]


def of_motion(key: str, camera: int = 0) -> Treatment:
    """The treatment of one motion alone, so that a test takes a second."""
    return replace(BY_KEY[key], only="motion", camera=camera)


@pytest.mark.parametrize("key", [each.key for each in TREATMENTS])
def test_pictures_are_as_many_and_of_one_size(key: str, capture: Capture, tmp_path: Path) -> None:
    changed = treated.treat(of_motion(key), capture, tmp_path)
    before, after = pictures(capture.cameras[0].motion), pictures(changed.cameras[0].motion)
    assert len(after) == len(before)
    assert len({image.shape for image in after}) == 1
    apart = [
        float(np.abs(one.astype(float) - other).mean())
        for one, other in zip(before[1:], after[1:], strict=True)
        if one.shape == other.shape
    ]
    assert all(each < CODEC for each in apart) if key == "copied" else all(each > 0.1 for each in apart)
    assert changed.cameras[1:] == capture.cameras[1:]


def test_all_files_of_all_cameras_are_treated(capture: Capture, tmp_path: Path) -> None:
    capture = replace(capture, cameras=capture.cameras[:1])
    [files], [usual] = treated.treat(BY_KEY["bars"], capture, tmp_path).cameras, capture.cameras
    assert files.reference is not None
    assert usual.reference is not None
    width = VideoReader(tmp_path / f"motion_{files.name}.mp4").width
    for image in (
        read_image(files.reference),
        *(pictures(path)[0] for path in (files.sweep, files.zoom, files.motion)),
    ):
        assert image[:, : width // 6].mean() < CODEC
        assert image[:, width // 3 : -width // 3].mean() > 30
    assert np.array_equal(read_image(files.reference)[:, width // 2], read_image(usual.reference)[:, width // 2])


def test_a_filter_of_noise_lags_where_little_changes() -> None:
    rng = np.random.default_rng(0)
    step = np.full((20, 40, 3), 100.0)
    faint, plain = step.copy(), step.copy()
    faint[:, 20:] += 6.0  # less than the filter takes for noise
    plain[:, 20:] += 60.0
    for edge, follows in ((faint, False), (plain, True)):
        frames = [step] * 8 + [edge]
        noisy = [
            np.clip(frame + rng.normal(0.0, NOISE_SIGMA, frame.shape), 0, 255).astype(np.uint8) for frame in frames
        ]
        *_, before, after = treated.less_noisy(iter(noisy))
        assert before.std() < 0.6 * NOISE_SIGMA
        risen = after[:, 25:].mean() - before[:, 25:].mean()
        assert (risen > 50.0) if follows else (risen < 5.0)


def test_a_stabiliser_holds_a_jolt_back_and_follows_a_pan() -> None:
    rng = np.random.default_rng(0)
    hall = np.asarray(treated.cv2.GaussianBlur(rng.integers(0, 256, (120, 400, 3)).astype(np.uint8), (0, 0), 2.0))
    jolted = [hall[:, 100 + left : 260 + left] for left in (0, 0, 4, 0, 0)]
    held = [image.astype(float) for image in treated.stabilised(iter(jolted))]
    assert np.abs(held[2] - held[1])[20:-20, 20:-20].mean() < 0.3 * np.abs(jolted[2].astype(float) - jolted[1]).mean()
    panned = [hall[:, left : 160 + left] for left in range(0, 200, 8)]
    *_, before, after = treated.stabilised(iter(panned))  # its shift has come to its end: it moves as the camera does
    moved, _ = treated.cv2.phaseCorrelate(*(image[:, :, 1].astype(np.float32) for image in (before, after)))
    assert moved[0] == pytest.approx(-8.0 * 160 / (160 - 2 * treated.HELD_PX), abs=1.5)


def test_what_the_footage_does_not_raise_is_counted(
    capture: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usual = replace(reconstruction(), motion=None, notes=("camera 2: its shutter rolls: 16.1 ms",))
    said = ("camera 2: its shutter rolls: 15.9 ms", "camera 1: its tripod was bumped")
    monkeypatch.setattr(treated, "reconstruct", lambda *_: replace(usual, notes=said))
    monkeypatch.setattr(treated, "_figures", lambda *_: {"panzoom.pan.rms": 0.001})
    truth: Any = None
    with Bars(Console(quiet=True)) as bars:
        arguments = of_motion("bars"), capture, truth, usual, TreatedFootageConfig(), bars, tmp_path
        assert treated._tried(*arguments) == ({"panzoom.pan.rms": 0.001, "notes": 1.0}, [said[1]])

        def refused(*_: object) -> None:
            raise PzcapError("camera 1: sweep: it does not hold together")

        monkeypatch.setattr(treated, "reconstruct", refused)
        assert treated._tried(*arguments) == ({"notes": 1.0}, ["camera 1: sweep: it does not hold together"])
    assert list(tmp_path.iterdir()) == []


def test_a_treatment_that_there_is_not_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=re.escape("no treatment 'fire'; one of copied, date")):
        list(treated.compare(TreatedFootageConfig(treatments=("fire",)), tmp_path, Console(quiet=True)))
