"""Efficiency of a sweep on several cores: the same small study on one of them, and side by side on several.

    python -m experiments.efficiency                               # six jobs, two cores
    python -m experiments.efficiency --jobs 8 --cores 4 experiment=clean

A first run, which does not count, shoots the footage and compiles the kernels. Then the study runs in fresh folders,
one job after the other and bound to one core; in as many such processes as there are cores, each with its share of the
jobs, by hand and without a launcher; and with joblib, as many jobs at once as there are cores. The efficiency is what
one core needed over what all the cores needed together: 1 if nothing is lost. What is lost by hand the machine takes
(cores share memory, cache and heat, some even their arithmetic units, and then a job costs more CPU time, too); what
joblib loses beyond that, the launcher takes. The first and the last table must hold the same but for times and memory:
exit status 1 where they do not.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console

from experiments.errors import AlreadyReported, guard
from experiments.studies.study import TABLE
from experiments.terminal import command_line, table, terminal
from pzcap.types import PzcapError

FOLDER: Final = Path("outputs/efficiency")
SMALL: Final = (
    "experiment=pedestrian", "shoot.motion_frames=24", "shoot.width=320", "shoot.height=240", "shoot.zoom_frames=8",
    "shoot.optics.zoom_max=1.8", "shoot.gym.texture_px_per_m=80",
)  # fmt: skip
"""A capture that is quick to shoot; the jobs differ in a setting of the tracker and share it."""
SETTING: Final = "reconstruct.tracking.velocity_gain"
COMMAND: Final = ("-m", "experiments.run")
OF_THE_MACHINE: Final = ("seconds", "metric.speed.*", "metric.memory.*")


@dataclass(frozen=True, slots=True)
class Spent:
    """Time that a study took."""

    wall_s: float
    cpu_s: float  # of all processes

    def efficiency(self, alone: Spent, cores: int) -> float:
        """Against the same study ``alone`` on one core."""
        return alone.wall_s / cores / self.wall_s


def study(folder: Path, launcher: Sequence[str], overrides: Sequence[str], jobs: Sequence[int]) -> list[str]:
    """Arguments of `experiments.run` for the jobs of these numbers, in ``folder``."""
    axis = f"{SETTING}=" + ",".join(f"{0.8 - 0.01 * job:g}" for job in jobs)
    return ["-m", *launcher, f"hydra.sweep.dir={folder.resolve()}", *overrides, axis]


def run(processes: Sequence[tuple[Sequence[str], Sequence[int]]]) -> Spent:
    """`experiments.run` in processes side by side, each given as arguments and cores. PzcapError if one fails."""
    before, start = _children_s(), time.perf_counter()
    lines = [[sys.executable, *COMMAND, *arguments] for arguments, _ in processes]
    running = [
        subprocess.Popen(line, stdout=subprocess.DEVNULL, preexec_fn=partial(os.sched_setaffinity, 0, cores))
        for line, (_, cores) in zip(lines, processes, strict=True)
    ]
    for line, status in zip(lines, [process.wait() for process in running], strict=True):
        if status:
            raise PzcapError(f"a run failed (exit status {status}): {' '.join(line)}")
    return Spent(time.perf_counter() - start, _children_s() - before)


def _children_s() -> float:
    """CPU time of all child processes that have ended, and of theirs, seconds."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def differing(one: pa.Table, other: pa.Table) -> list[str]:
    """The columns that are not the same in both tables, but for what depends on the machine. Rows in any order."""
    names = sorted({*one.column_names, *other.column_names})
    compared = [name for name in names if not any(fnmatch(name, pattern) for pattern in OF_THE_MACHINE)]
    first, second = (
        sorted(table.to_pylist(), key=lambda row: str(row["path"])) for table in (one, other)
    )  # fmt: skip
    return [name for name in compared if [row.get(name) for row in first] != [row.get(name) for row in second]]


def measure(overrides: Sequence[str], jobs: int, cores: int, out: Console) -> None:
    """Print the table. AlreadyReported where serial and launched study do not hold the same."""
    available = len(os.sched_getaffinity(0))
    if not 2 <= cores <= available:
        raise PzcapError(f"--cores is {cores}; give 2 to {available}, what this process may use")
    if jobs < cores:
        raise PzcapError(f"--jobs is {jobs}; give {cores} or more, one a core")
    shutil.rmtree(FOLDER, ignore_errors=True)
    chosen, numbers = sorted(os.sched_getaffinity(0))[:cores], range(jobs)
    run([([*overrides, f"hydra.run.dir={FOLDER / 'first'}"], chosen)])
    joblib = ("hydra/launcher=joblib", f"hydra.launcher.n_jobs={cores}")
    alone = run([(study(FOLDER / "serial", (), overrides, numbers), chosen[:1])])
    by_hand = run([
        (study(FOLDER / f"by_hand{k}", (), overrides, numbers[k::cores]), [core]) for k, core in enumerate(chosen)
    ])  # fmt: skip
    launched = run([(study(FOLDER / "parallel", joblib, overrides, numbers), chosen)])
    measured = (
        ("one after the other, on one core", alone, 1),
        (f"on {cores} cores, started by hand", by_hand, cores),
        (f"on {cores} cores, launched by joblib", launched, cores),
    )
    rows = [
        (name, f"{spent.wall_s:.1f}", f"{spent.cpu_s:.1f}", f"{spent.efficiency(alone, used):.2f}")
        for name, spent, used in measured
    ]
    out.print(table(f"{jobs} jobs", ("", ">wall s", ">CPU s", ">efficiency"), rows))
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
    parser = command_line("efficiency", __doc__)
    parser.add_argument("--jobs", type=int, default=6)
    parser.add_argument("--cores", type=int, default=2)
    options, overrides = parser.parse_known_args()
    return guard(lambda: measure(overrides or SMALL, options.jobs, options.cores, terminal()))


if __name__ == "__main__":
    sys.exit(main())
