"""Joints and frames that a file gives without an answer in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pzcap.scoring.command import SUSPICIOUS, main
from pzcap.scoring.suspicions import suspicions
from tests.scenes.plain import good, header, written
from tests.scoring.test_mistakes import Y_UP


def test_what_was_not_found_hides_no_mistake_of_the_others() -> None:
    results, truth = good()
    assert results.body is not None
    zeros = np.where(np.arange(results.frames)[:, None, None] < 14, 0.0, results.body.joints_m @ Y_UP.T)
    said = suspicions(replace(results, body=replace(results.body, joints_m=zeros)), truth)
    assert [line.split(":")[0] for line in said[-2:]] == [
        "224 joints are exactly at 0, 0, 0, the first in frame 0",
        "joints have other axes (y is up, z to the viewer)",
    ]


def test_a_header_that_leaves_nothing_to_score_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, truth = written(tmp_path)
    header(results, keyframes=list(range(20)))
    assert main(["--check", str(results), str(truth)]) == SUSPICIOUS
    assert "keyframes are all the frames that have joints" in capsys.readouterr().err
