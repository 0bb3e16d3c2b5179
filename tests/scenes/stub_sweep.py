"""A Hydra application whose jobs are quick: what a sweep does can be seen without rendering anything.

A job writes three files, a little of each at a time, and appends its name to a list of who began.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from experiments.errors import guard
from experiments.studies import jobs
from pzcap.types import PzcapError

QUIET = [{"override hydra/job_logging": "none"}, {"override hydra/hydra_logging": "none"}]
TREE = {
    "defaults": ["_self_", *QUIET, {"override hydra/sweeper": "resuming"}],
    "value": 0,
    "noise": 0.0,
    "pause_s": 0.002,
    "fails": None,
    "bug": None,
    "hydra": {"sweep": {"subdir": "${job_name:}"}},
}
ConfigStore.instance().store(name="stub", node=TREE)


def work(tree: dict[str, Any], folder: Path) -> None:
    with (Path(HydraConfig.get().sweep.dir) / "began.txt").open("a") as began:
        began.write(f"{tree['value']}\n")
    if tree["fails"] == tree["value"]:
        raise PzcapError("this value cannot be")
    if tree["bug"] == tree["value"]:
        raise ZeroDivisionError("one over\nzero")
    for name in "abc":
        with (folder / f"{name}.txt").open("w") as file:
            for step in range(5):
                file.write(f"{name} {tree['value']} {tree['noise']} {step}\n")
                file.flush()
                time.sleep(tree["pause_s"])


@hydra.main(version_base="1.3", config_path=None, config_name="stub")
def _job(composed: DictConfig) -> None:
    config = HydraConfig.get()
    jobs.carry_out(Path(config.runtime.output_dir), composed, config.overrides.task, work)


def main() -> int:
    """The exit status of the sweep that the command line says."""
    return guard(_job)


if __name__ == "__main__":
    sys.exit(main())
