"""The benchmark runs every stage on a small capture, and says what a user did wrong."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from experiments.bench import Stage, Stages, stage_table

pytestmark = pytest.mark.xdist_group("experiments")


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    wide = os.environ | {"COLUMNS": "160"}
    return subprocess.run(
        [sys.executable, "-m", "experiments.bench", *arguments], capture_output=True, text=True, env=wide
    )


def test_it_times_every_stage(small_capture: Path, tmp_path: Path) -> None:
    """Of one camera: each is a sample more."""
    footage = shutil.copytree(small_capture / "capture", tmp_path / "footage")
    manifest = json.loads((footage / "capture.json").read_text())
    manifest["cameras"] = manifest["cameras"][:1]
    (footage / "capture.json").write_text(json.dumps(manifest))
    done = command(str(footage))
    assert done.returncode == 0, done.stderr
    rows = [line for line in done.stdout.splitlines() if " ms " in line or " s " in line]
    assert len(rows) == len(Stages().all())
    for stage in Stages().all():
        assert any(stage.name.split()[0] in row for row in rows), stage.name


def test_a_median_is_held_against_its_limit() -> None:
    stages = Stages()
    stages.cold.samples, stages.follow.samples = [100.0, 200.0, 900.0], [16.0, 16.0, 1.0]
    console = Console(width=200, file=io.StringIO(), record=True)
    console.print(stage_table(stages, "test"))
    cold, follow = (line for line in console.export_text().splitlines() if "localise" in line)
    assert "200.0 ms" in cold
    assert cold.rstrip(" │").endswith("yes")
    assert follow.rstrip(" │").endswith("no")


def test_a_stage_sums_up_in_its_own_unit() -> None:
    stage = Stage("one", "camera", "s")
    assert stage.time(max, 2, 3) == 3
    assert 0.0 <= stage.samples[0] < 0.1


def test_a_reconstruction_that_is_none_costs_one_line(small_capture: Path, tmp_path: Path) -> None:
    done = command(str(small_capture / "capture"), "--reconstruction", str(tmp_path))
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
