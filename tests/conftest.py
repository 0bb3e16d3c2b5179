"""Settings and fixtures of all tests."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from experiments.footage import SMALL
from pzcap.io.capture import read_capture
from pzcap.pipeline import Config, reconstruct
from pzcap.types import Reconstruction
from tests.scenes.captures import shot

# the same examples every time, however long the first takes to compile: a gate must not open by luck
settings.register_profile("gate", derandomize=True, deadline=None)
settings.load_profile("gate")

# what a shell starts in the background ignores SIGINT, and so would the commands that tests interrupt
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist looks for groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that share what is made once a file are a group, which one process has."""
    for item in items:
        assert isinstance(item, pytest.Function)
        made = [fixture for found in item._fixtureinfo.name2fixturedefs.values() for fixture in found]
        if any(fixture.scope == "module" for fixture in made) and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


@pytest.fixture(scope="session")
def small_run(small_capture: Path) -> Reconstruction:
    """The pipeline's result on the small capture. Read only. The tests that take it are of the group "pipeline",
    which one process has, so that it is made once."""
    return reconstruct(read_capture(small_capture / "capture"), Config())


@pytest.fixture(scope="session")
def finished(small_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """(folder of the command's run on the small capture, what it printed). Read only. The tests that take it are of the
    group "experiments", as those of "pipeline" are of theirs."""
    folder = tmp_path_factory.mktemp("run")
    line = [sys.executable, "-m", "experiments.run", f"capture={small_capture / 'capture'}", f"hydra.run.dir={folder}"]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


@pytest.fixture(scope="session")
def small_capture() -> Path:
    """A folder with ``capture/`` and ``truth/`` of a short, small shoot. Read only."""
    return shot(SMALL)
