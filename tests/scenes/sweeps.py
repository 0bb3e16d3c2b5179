"""The sweep of `tests.scenes.stub_sweep`, as a process or here, what it leaves, and the one job that it does."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any
from unittest.mock import patch

from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from experiments.studies import jobs
from tests.scenes import stub_sweep

ROOT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests" / "plugins")])}


def command(folder: Path, *arguments: str, launcher: str = "basic") -> list[str]:
    """Command line of a sweep into ``folder``."""
    stub = [
        sys.executable,
        "-m",
        "tests.scenes.stub_sweep",
        "-m",
        f"hydra.sweep.dir={folder}",
        f"hydra/launcher={launcher}",
    ]
    return [*stub, *arguments]


def sweep(folder: Path, *arguments: str, launcher: str = "basic") -> subprocess.CompletedProcess[str]:
    """Run a sweep to its end."""
    line = command(folder, *arguments, launcher=launcher)
    return subprocess.run(line, capture_output=True, text=True, cwd=ROOT, env=ENVIRONMENT)


def sweep_here(folder: Path, *arguments: str, launcher: str = "basic") -> subprocess.CompletedProcess[str]:
    """Run a sweep of few jobs to its end in this process, which has imported all that it needs.

    Not for many: after other tests each job takes longer here than in a fresh process.
    """
    line, said = command(folder, *arguments, launcher=launcher), io.StringIO()
    GlobalHydra.instance().clear()
    with patch.object(sys, "argv", line[2:]), redirect_stderr(said):
        status = stub_sweep.main()
    return subprocess.CompletedProcess(line, status, None, said.getvalue())


def results(folder: Path) -> dict[str, dict[str, str]]:
    """Folder of each result -> its files. Asserts that nothing in sight is half a result."""
    found = {}
    for job in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        files = {path.name: path.read_text() for path in job.glob("*.txt")}
        if (job / jobs.MARK).exists():
            assert [text.count("\n") for text in files.values()] == [5, 5, 5]
            found[job.name] = files
        else:
            assert not files
    return found


def began(folder: Path) -> int:
    """Number of jobs that have begun."""
    return len((folder / "began.txt").read_text().splitlines())


def composed(**values: Any) -> DictConfig:
    """Configuration of a job."""
    return OmegaConf.create({"value": 1, **values})


def write(tree: dict[str, Any], folder: Path) -> str:
    """A job that writes its value."""
    (folder / "result.txt").write_text(str(tree["value"]))
    return "new"
