"""Overhead of a sweep: what a job costs beside its own work, which is none here.

    python -m experiments.overhead                            # 1,000 jobs, by Ray on this machine
    python -m experiments.overhead --jobs 200 --launcher basic

The jobs have the configuration of `experiments.run` and leave metrics.json, as its jobs do; beside them stand the table
and the page of the sweep. A sweep of two jobs, run before, tells what starting takes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from experiments.errors import guard
from experiments.metrics import run_info, write_metrics
from experiments.run import CONF
from experiments.studies import jobs, study
from experiments.terminal import command_line, table, terminal
from pzcap.scoring.metric import Metric
from pzcap.types import PzcapError

MODULE: Final = "experiments.overhead"
MANY: Final = "--multirun"  # what makes this module the sweep itself


def work(tree: dict[str, Any], folder: Path) -> None:
    """Leave a result that nothing was done for."""
    write_metrics(folder / study.METRICS, [Metric("panzoom.pan.rms", 0.001, "deg")], run_info(tree, tree["seed"]))


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
def _job(composed: DictConfig) -> None:
    config = HydraConfig.get()
    jobs.carry_out(Path(config.runtime.output_dir), composed, config.overrides.task, work)


def measure(count: int, launcher: str, out: Console) -> None:
    """Print what a sweep of two jobs takes, and each further one of ``count``."""
    if count < 3:
        raise PzcapError(f"--jobs is {count}; give 3 or more")
    start_s, whole_s = _swept_s(2, launcher), _swept_s(count, launcher)
    rows = [
        ("a sweep of 2 jobs", f"{start_s:.1f} s"),
        (f"a sweep of {count} jobs", f"{whole_s:.1f} s"),
        ("that is, a job", f"{1e3 * whole_s / count:.1f} ms"),
        ("each further job", f"{1e3 * (whole_s - start_s) / (count - 2):.1f} ms"),
    ]
    out.print(table(f"jobs that do nothing, launched by {launcher}", ("", ">wall time"), rows))


def _swept_s(count: int, launcher: str) -> float:
    """Wall time of a sweep of so many jobs, its process and its launcher started. PzcapError if one has no result."""
    with tempfile.TemporaryDirectory(prefix="overhead-") as folder:
        arguments = [MANY, f"seed=range({count})", f"hydra/launcher={launcher}", f"hydra.sweep.dir={folder}"]
        start = time.perf_counter()
        ended = subprocess.run([sys.executable, "-m", MODULE, *arguments], capture_output=True, text=True)
        seconds = time.perf_counter() - start
        done = len(list(Path(folder).rglob(jobs.MARK)))
    if ended.returncode or done < count:
        raise PzcapError(f"{done} of {count} jobs have a result: {ended.stderr.strip()[-500:]}")
    return seconds


def main() -> int:
    """The command, or the sweep that it is about. Exit status 0, or 1 with a line on stderr."""
    if MANY in sys.argv:
        return guard(_job)
    parser = command_line("overhead", __doc__)
    parser.add_argument("--jobs", type=int, default=1000)
    parser.add_argument("--launcher", default="ray", help="as in hydra/launcher=")
    options = parser.parse_args()
    return guard(lambda: measure(options.jobs, options.launcher, terminal()))


if __name__ == "__main__":
    sys.exit(main())
