"""Kills at random moments: a few of each kind of work; `make kills` tries a hundred."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import pytest

from tests.scenes.sweeps import ENVIRONMENT, ROOT


@pytest.mark.heavy
@pytest.mark.parametrize("kind", ["shoot", "run", "sweep", "ray"])
def test_nothing_is_lost_or_left(kind: str) -> None:
    if kind == "ray" and importlib.util.find_spec("ray") is None:
        pytest.skip("ray is not installed: pip install pzcap[launchers]")
    line = [sys.executable, "-m", "tests.fuzz.kills", "3", "--only", kind, "--seed", "1"]
    done = subprocess.run(line, cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("3 of 3 kills right\n")
