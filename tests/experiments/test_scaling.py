"""The command that measures growth, on one small capture, and the exponent of laws that are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import scaling
from experiments.footage import SMALL
from experiments.terminal import terminal
from pzcap.types import PzcapError


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_the_exponent_is_that_of_a_power_law(power: float) -> None:
    amounts = np.array([2.0, 4.0, 8.0, 50.0])
    assert scaling.exponent(amounts.tolist(), (3.0 * amounts**power).tolist()) == pytest.approx(power)


def test_every_axis_grows_what_it_names() -> None:
    for name, axis in scaling.AXES.items():
        small, large = (axis.shoot(value) for value in axis.values[:2])
        assert small != large, name
        amounts = [axis.amount(value) for value in axis.values]
        assert amounts == sorted(set(amounts))
    assert scaling.AXES["width"].amount(640) == 640 * 480


def test_the_page_and_the_table(monkeypatch: pytest.MonkeyPatch, small_capture: Path, tmp_path: Path) -> None:
    monkeypatch.setattr(scaling, "shot", lambda *_: small_capture)
    monkeypatch.setattr(
        scaling, "in_a_process_of_its_own", lambda capture: scaling.Spent(10.0, 20.0, 300.0 if capture.exists() else 0)
    )
    scaling.measure(["cameras"], [], tmp_path, terminal())
    written = json.loads((tmp_path / "scaling.json").read_text())
    assert [each["amount"] for each in written["cameras"]] == [2, 4, 8]
    page = (tmp_path / "index.html").read_text()
    assert page.count("<svg") == 1
    assert "0.00" in page  # the exponent of what stays the same


def test_a_process_that_fails_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=r"capture\.json"):
        scaling.in_a_process_of_its_own(tmp_path)


@pytest.mark.heavy
def test_a_reconstruction_is_measured(small_capture: Path) -> None:
    assert SMALL.cameras == 4
    spent = scaling.in_a_process_of_its_own(small_capture / "capture")
    assert spent.calibration_s > 1.0
    assert spent.motion_s > 0.1
    assert 100.0 < spent.peak_mib < 3000.0


def test_labels_of_the_axis_are_the_values_that_were_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "shot", lambda *_: tmp_path)
    monkeypatch.setattr(scaling, "in_a_process_of_its_own", lambda _: scaling.Spent(10.0, 20.0, 300.0))
    scaling.measure(["frames"], [150, 600, 3000], tmp_path, terminal())
    page = (tmp_path / "index.html").read_text()
    assert [page.count(f">{value}</text>") for value in ("150", "600", "3k")] == [3, 3, 3]
    assert page.count("<th>frame") == 1  # the value is the amount


def test_what_was_measured_is_kept_where_a_value_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def reconstructed(capture: Path) -> scaling.Spent:
        if capture.parent.name == "600":
            raise PzcapError("no markers")
        return scaling.Spent(10.0, 20.0, 300.0)

    monkeypatch.setattr(scaling, "shot", lambda shoot, _: tmp_path / str(shoot.motion_frames))
    monkeypatch.setattr(scaling, "in_a_process_of_its_own", reconstructed)
    with pytest.raises(PzcapError, match=r"^frames 600: no markers$"):
        scaling.measure(["frames"], [150, 600, 3000], tmp_path, terminal())
    assert [len(each) for each in json.loads((tmp_path / "scaling.json").read_text()).values()] == [2]
