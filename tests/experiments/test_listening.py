"""No command listens where another machine could reach it. Sweeps: tests/experiments/test_sweep.py."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import psutil
import pytest

from experiments import catalog
from pzcap.command.places import link_capture
from pzcap.io import results
from pzcap.types import PzcapError
from pzcap.viewer import window
from tests.scenes import edited, listening
from tests.scenes.browsing import Serving
from tests.scenes.captures import TINY
from tests.scenes.studies import record
from tests.scenes.sweeps import ENVIRONMENT, ROOT


@pytest.mark.skipif(importlib.util.find_spec("datafusion") is None, reason="needs rerun-sdk[catalog]")
def test_a_catalog_is_reached_by_nobody_else(tmp_path: Path) -> None:
    record(tmp_path / "run" / "recording.rrd", 1.0, 0)
    with catalog.served([tmp_path / "run" / "recording.rrd"]):
        found = listening.addresses(psutil.Process())
    assert found
    assert not listening.exposed(found)


def test_the_viewer_is_reached_by_nobody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    found: set[str] = set()

    def watch(process: subprocess.Popen[bytes], _port: int) -> None:
        until = time.monotonic() + window.START_S
        while not found and process.poll() is None and time.monotonic() < until:
            found.update(listening.addresses(psutil.Process(process.pid)))
        raise ConnectionError

    monkeypatch.setattr(window, "_connected", watch)
    with pytest.raises(PzcapError):
        window.show([], headless=True)
    assert found == {"127.0.0.1"}


@pytest.mark.skipif(importlib.util.find_spec("aiohttp") is None, reason="needs pzcap[editor]")
def test_an_editor_is_reached_by_nobody_else(tmp_path: Path) -> None:
    results.save(edited.found(tracked=True), tmp_path / "reconstruction")
    link_capture(tmp_path, edited.capture(tmp_path / "take"))
    with Serving("edit", tmp_path) as editing:
        assert listening.addresses(psutil.Process(editing.process.pid)) == {"127.0.0.1"}


@pytest.mark.heavy
def test_a_run_and_a_check_are_reached_by_nobody_else(small_capture: Path, tmp_path: Path) -> None:
    """Filming, its processes, reconstruction with its worker, recording and report; and what a crew types."""
    film = [f"shoot.{key}={value}" for key, value in asdict(TINY).items() if isinstance(value, (int, float, str))]
    outputs = f"output.captures={tmp_path / 'captures'}"
    lines = [
        [sys.executable, "-m", "experiments.run", *film, outputs, f"hydra.run.dir={tmp_path / 'filmed'}"],
        [sys.executable, "-m", "experiments.run", f"capture={small_capture}", f"hydra.run.dir={tmp_path / 'run'}"],
        [sys.executable, "-m", "pzcap.command", "check", str(small_capture / "capture"),
         "--page", str(tmp_path / "check.html")],
        [sys.executable, "-m", "pzcap.command", "reconstruct", str(small_capture / "capture"),
         "--out", str(tmp_path / "results")],
        [sys.executable, "-m", "pzcap.command", "export", str(tmp_path / "results"), "--to", "usd", "freed",
         "--out", str(tmp_path / "exported")],
    ]  # fmt: skip
    for line in lines:
        process, found = subprocess.Popen(line, cwd=ROOT, env=ENVIRONMENT, stderr=subprocess.DEVNULL), set()
        while process.poll() is None:
            found |= listening.addresses(psutil.Process(process.pid))
            time.sleep(0.05)
        assert process.returncode == 0, line
        assert not listening.exposed(found), line
