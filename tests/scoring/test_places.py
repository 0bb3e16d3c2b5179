"""Results and truth are given as folders of one capture, or of a split: what does not go together is led on."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pzcap.scoring.command import REFUSED, SUSPICIOUS, main
from tests.scenes import plain


@pytest.fixture
def split(tmp_path: Path) -> Path:
    """Results of two captures in ``mine``, their truth in ``split/truth``."""
    results, truth = plain.written(tmp_path / "made")
    for name in ("walk_1", "walk_2"):
        shutil.copytree(results, tmp_path / "mine" / name)
        shutil.copytree(truth, tmp_path / "split" / "truth" / name)
        plain.header(tmp_path / "mine" / name, capture=None)
    return tmp_path


def test_a_split_is_checked_without_the_truth(split: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--check", str(split / "mine")]) == 0
    plain.edited(split / "mine" / "walk_2" / "joints.csv", lambda rows: [row | {"valid": "0"} for row in rows])
    assert main(["--check", str(split / "mine")]) == SUSPICIOUS
    assert f"suspicious: {split / 'mine' / 'walk_2'}: no joint is valid" in capsys.readouterr().err


def test_one_capture_of_a_split_is_scored(split: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(split / "mine"), str(split / "split" / "truth" / "walk_2")]) == 0
    assert "means over" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("results", "truth", "line"),
    [
        ("mine/walk_1", "split/truth", "is of one capture, and the truth of 2; give {}/split/truth/walk_1"),
        ("mine", "split", "holds no truth.json, nor do its folders; give {}/split/truth"),
        (
            "mine/walk_1/joints.csv",
            "split/truth/walk_1",
            "joints.csv alone says not of how many frames and cameras",
        ),
        ("bare", "split/truth/walk_1", "write results.json beside it (see docs/benchmark.md)"),
    ],
)
def test_what_does_not_go_together_is_led_on(
    results: str, truth: str, line: str, split: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (split / "bare").mkdir()
    shutil.copy(split / "mine" / "walk_1" / "joints.csv", split / "bare")
    assert main([str(split / results), str(split / truth)]) == REFUSED
    assert line.format(split) in capsys.readouterr().err
