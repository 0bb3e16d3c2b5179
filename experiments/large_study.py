"""Growth of a study: a hundred thousand made-up results, collected, tabled and plotted.

    python -m experiments.large_study                     # 100,000 runs; some GB of small files while it works
    python -m experiments.large_study --runs 5000

The results are those of a stub in the place of an estimator: the folder, metrics.json and job.json of every job, with
the errors drawn by chance. Then the table and the page are made as after any sweep. The peak is of this process's
memory; it does not grow with the number of runs.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from experiments.config import default_tree
from experiments.errors import guard
from experiments.memory import watched
from experiments.metrics import metrics_text, run_info
from experiments.studies import jobs, page, study
from experiments.terminal import command_line, table, terminal
from pzcap.scoring.metric import Metric
from pzcap.types import PzcapError

NOISES: Final = tuple(0.5 * k for k in range(10))
METHODS: Final = ("exact", "paper")
BOUND_DEG: Final = 0.0004


def measure(runs: int, folder: Path, out: Console) -> None:
    """Make ``runs`` results in ``folder``, and the table and the page of them; print what each took."""
    if runs < 1:
        raise PzcapError(f"--runs is {runs}; give 1 or more")
    rows = []
    for name, work in (
        ("results made by the stub", lambda: sum(1 for _ in stubs(runs, folder))),
        ("collected and tabled", lambda: study.collect(folder, places(runs, folder))),
        ("collected, tabled and plotted", lambda: page.write_study(folder, places(runs, folder))),
    ):
        start = time.perf_counter(), time.process_time()
        with watched() as peak:
            work()
        wall_s, cpu_s = time.perf_counter() - start[0], time.process_time() - start[1]
        rows.append((name, f"{wall_s:.1f}", f"{cpu_s:.1f}", f"{peak.mib:.0f}"))
    size = sum(part.stat().st_size for part in (folder / study.TABLE).iterdir()) / 1e6
    out.print(table(f"{runs} runs; a table of {size:.1f} MB", ("", ">wall s", ">CPU s", ">peak MiB"), rows))


def places(runs: int, folder: Path) -> Iterator[Path]:
    """The folders of the jobs, a thousand in each folder above them."""
    return (folder / f"{k // 1000:03d}" / f"{k:06d}" for k in range(runs))


def stubs(runs: int, folder: Path) -> Iterator[Path]:
    """Write a result in each of the `places`: three settings varied, errors by chance."""
    rng, tree = np.random.default_rng(0), default_tree()
    info = run_info(tree, 0)  # the same for all, but for what is varied
    for k, place in enumerate(places(runs, folder)):
        noise, method, seed = NOISES[k % len(NOISES)], METHODS[k // len(NOISES) % len(METHODS)], k // 20
        tree["shoot"]["sensor"]["read_noise"], tree["method"], tree["seed"] = noise, method, seed
        error = BOUND_DEG * (1.5 + noise) * (1.0 if method == "exact" else 2.0) * rng.lognormal(0.0, 0.1)
        found = [
            Metric("panzoom.pan.rms", error, "deg"),
            Metric("panzoom.bound_ratio.pan", error / BOUND_DEG, "1"),
            Metric("panzoom.focal.rms", 10 * error, "%"),
            Metric("panzoom.lost", 0.0, "frames"),
            Metric("body.mpjpe.mean", 5.0 + 100 * error, "mm"),
        ]
        place.mkdir(parents=True)
        info["config"], info["seed"] = tree, seed
        (place / study.METRICS).write_text(metrics_text(found, info))
        overrides = [f"shoot.sensor.read_noise={noise}", f"method={method}", f"seed={seed}"]
        (place / jobs.MARK).write_text(json.dumps({"key": "", "overrides": overrides, "seconds": 0.0}))
        yield place


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    parser = command_line("large_study", __doc__)
    parser.add_argument("--runs", type=int, default=100_000)
    runs = parser.parse_args().runs

    def work() -> None:
        with tempfile.TemporaryDirectory(prefix="study-") as folder:
            measure(runs, Path(folder), terminal())

    return guard(work)


if __name__ == "__main__":
    sys.exit(main())
