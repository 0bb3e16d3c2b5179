"""What a crew may leave at home, and what that costs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from experiments.comparisons import burden
from experiments.comparisons.harness import Row
from experiments.config import AppConfig
from experiments.footage import SMALL
from pzcap.io.capture import read_capture
from pzcap.types import PzcapError, Reconstruction
from sim.people.detector import DetectorConfig
from tests.scenes.captures import shot
from tests.scenes.fabricated import reconstruction

pytestmark = pytest.mark.xdist_group("experiments")


def test_a_variant_takes_out_what_it_says(small_capture: Path) -> None:
    capture = read_capture(small_capture / "capture")
    brought = {variant.key: variant.of(capture) for variant in burden.VARIANTS}
    assert brought["everything"] is capture
    assert brought["no_object"].calibration_object is None
    assert all(camera.zoom is None and camera.sweep is not None for camera in brought["no_zoom"].cameras)
    assert len(brought["one_keyframe"].keyframe_poses) == 1
    assert brought["no_keyframes"].keyframe_poses == {}
    assert list(brought["stature"].subject.measurements_m) == ["stature"]  # type: ignore[union-attr]
    least = brought["least"]
    assert least.keyframe_poses == {}
    assert all(camera.zoom is None for camera in least.cameras)


def test_cameras_are_calibrated_once_for_those_that_agree_about_them(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[Reconstruction | None] = []

    def calibrated(
        _capture: object, _config: object, _report: object, cameras: Reconstruction | None
    ) -> Reconstruction:
        taken.append(cameras)
        return replace(reconstruction(), motion=None, notes=("the body is not tracked: there is none",))

    monkeypatch.setattr(burden, "reconstruct", calibrated)
    known: dict[tuple[object, ...], Reconstruction] = {}
    rows: list[Row[object]] = []
    for variant in burden.VARIANTS:
        monkeypatch.setattr(burden.Variant, "of", lambda _, capture: capture)
        rows.append(burden._row(variant, None, None, AppConfig(), known, lambda *_: None))  # type: ignore[arg-type]
    assert sum(each is None for each in taken) == len({variant.cameras for variant in burden.VARIANTS}) == 7
    assert all(row.missing == "the body is not tracked: there is none" for row in rows)


def test_a_capture_without_keypoints_is_refused(small_capture: Path, tmp_path: Path) -> None:
    config = AppConfig(capture=str(small_capture))
    with pytest.raises(PzcapError, match="has to have both"):
        burden.compare(config, tmp_path, Console(quiet=True))


@pytest.mark.heavy
def test_the_table_says_what_each_thing_is_worth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = ("everything", "no_object", "partial_sweep", "no_keyframes", "neither")
    monkeypatch.setattr(burden, "VARIANTS", tuple(v for v in burden.VARIANTS if v.key in chosen))
    folder = shot(replace(SMALL, detector=DetectorConfig(enabled=True)))
    rows = {row.key: row for row in burden.compare(AppConfig(capture=str(folder)), tmp_path, Console(quiet=True))}
    assert "object" in (rows["no_object"].missing or "")
    assert rows["partial_sweep"].missing == "would have to be shot"
    assert "neither keyframes" in (rows["neither"].missing or "")
    everything, hands_free = (rows[key].figures[burden.MEAN.key] or 0.0 for key in ("everything", "no_keyframes"))
    assert 0.0 < everything < hands_free < 4 * everything + 20.0
