"""How well a sweep uses the cores: the same small study on one of them, and side by side on several.

    python -m experiments.efficiency                               # six jobs, two cores
    python -m experiments.efficiency --jobs 8 --cores 4 experiment=clean

A first run, which does not count, shoots the footage and compiles the kernels. Then the study runs in a fresh folder,
one job after the other and bound to one core, and once more with joblib, as many jobs at once as there are cores. The
efficiency is what one core needed over what all the cores needed together: 1 if nothing is lost. Both tables must hold
the same but for times and memory: exit status 1 where they do not.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from experiments.errors import AlreadyReported, guard
from experiments.study import TABLE
from pzcap.types import PzcapError

FOLDER: Final = Path("outputs/efficiency")
SMALL: Final = (
    "experiment=pedestrian", "shoot.motion_frames=24", "shoot.width=320", "shoot.height=240", "shoot.zoom_frames=8",
    "shoot.optics.zoom_max=1.8", "shoot.gym.texture_px_per_m=80",
)  # fmt: skip
"""A capture that is quick to shoot; the jobs differ in a setting of the tracker and share it."""
SETTING: Final = "reconstruct.tracking.velocity_gain"
OF_THE_MACHINE: Final = ("seconds", "metric.speed.*", "metric.memory.*")


def study(folder: Path, launcher: Sequence[str], overrides: Sequence[str], jobs: int, cores: int) -> float:
    """Run the study in ``folder`` on so many cores; its wall time, seconds. PzcapError if a job failed."""
    axis = f"{SETTING}=" + ",".join(f"{0.8 - 0.01 * job:g}" for job in range(jobs))
    given = [*launcher, f"hydra.sweep.dir={folder.resolve()}", *overrides, axis]
    start = time.perf_counter()
    _run(["-m", *given], cores)
    return time.perf_counter() - start


def _run(arguments: Sequence[str], cores: int) -> None:
    """`experiments.run` in a process that has so many of the cores."""
    chosen = sorted(os.sched_getaffinity(0))[:cores]
    line = [sys.executable, "-m", "experiments.run", *arguments]
    done = subprocess.run(
        line, stdout=subprocess.DEVNULL, check=False, preexec_fn=lambda: os.sched_setaffinity(0, chosen)
    )
    if done.returncode:
        raise PzcapError(f"a run failed (exit status {done.returncode}): {' '.join(line)}")


def differing(one: pa.Table, other: pa.Table) -> list[str]:
    """The columns that are not the same in both tables, but for what depends on the machine. Rows in any order."""
    names = sorted({*one.column_names, *other.column_names})
    compared = [name for name in names if not any(fnmatch(name, pattern) for pattern in OF_THE_MACHINE)]
    first, second = (
        sorted(table.to_pylist(), key=lambda row: str(row["path"])) for table in (one, other)
    )  # fmt: skip
    return [name for name in compared if [row.get(name) for row in first] != [row.get(name) for row in second]]


def measure(overrides: Sequence[str], jobs: int, cores: int, out: Console) -> None:
    """Print the table. AlreadyReported where the two studies do not hold the same."""
    available = len(os.sched_getaffinity(0))
    if not 2 <= cores <= available:
        raise PzcapError(f"--cores is {cores}; give 2 to {available}, what this process may use")
    shutil.rmtree(FOLDER, ignore_errors=True)
    _run([*overrides, f"hydra.run.dir={FOLDER / 'first'}"], cores)
    side_by_side = ("hydra/launcher=joblib", f"hydra.launcher.n_jobs={cores}")
    alone_s = study(FOLDER / "serial", (), overrides, jobs, 1)
    together_s = study(FOLDER / "parallel", side_by_side, overrides, jobs, cores)
    table = Table(title=f"{jobs} jobs", title_justify="left", header_style="bold")
    for name in ("", "wall s", "efficiency"):
        table.add_column(name, justify="right" if name else "left")
    table.add_row("one after the other, on one core", f"{alone_s:.1f}", "1")
    table.add_row(f"side by side, on {cores} cores", f"{together_s:.1f}", f"{alone_s / cores / together_s:.2f}")
    out.print(table)
    tables = [pq.read_table(_only(FOLDER / name)) for name in ("serial", "parallel")]
    unequal = differing(*tables)
    if unequal:
        out.print(f"The two tables differ in {', '.join(unequal)}", highlight=False)
        raise AlreadyReported("the tables differ")
    out.print(f"The two tables are equal: {tables[0].num_rows} rows, {tables[0].num_columns} columns", highlight=False)


def _only(folder: Path) -> Path:
    (found,) = folder.rglob(TABLE)
    return found


def main() -> int:
    """The command. Exit status 0, or 1."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="python -m experiments.efficiency", description=__doc__, formatter_class=raw)
    parser.add_argument("--jobs", type=int, default=6)
    parser.add_argument("--cores", type=int, default=2)
    options, overrides = parser.parse_known_args()
    return guard(lambda: measure(overrides or SMALL, options.jobs, options.cores, Console()))


if __name__ == "__main__":
    sys.exit(main())
