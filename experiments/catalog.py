"""Ask a folder of recordings as one table: how a figure goes with a setting, and how long the answer takes.

    python -m experiments.catalog outputs/study/noise shoot.sensor.read_noise panzoom.pan.rms

The recordings are served as a catalog on this machine and asked through Rerun's own query, as docs/recording.md shows.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rerun as rr
from rich.console import Console
from rich.table import Table

from experiments.config import nearest
from experiments.errors import guard
from experiments.review import RECORDING, runs_in
from pzcap.types import PzcapError


def ask(recordings: Sequence[Path], setting: str, metric: str) -> Any:
    """Count, mean and standard deviation of a metric at each value of a setting: a pandas table.

    PzcapError where the recordings hold no such setting or metric.
    """
    with rr.server.Server(host="127.0.0.1", datasets={"runs": [str(path.resolve()) for path in recordings]}) as server:
        client = server.client()  # the table does not outlive it
        runs = client.get_dataset("runs").segment_table().to_pandas()
    value, figure = (
        _column(runs, f"property:{group}:", name) for group, name in (("config", setting), ("metrics", metric))
    )
    return figure.groupby(value).agg(["count", "mean", "std"])


def _column(runs: Any, prefix: str, name: str) -> Any:
    column = prefix + name.replace(".", "_")
    if column not in runs:
        known = [key.removeprefix(prefix) for key in runs if key.startswith(prefix)]
        raise PzcapError(f"no recording holds '{name}' (a dot is _ in there); {nearest(name.replace('.', '_'), known)}")
    return runs[column].str[0]


def _command() -> None:
    parser = argparse.ArgumentParser(prog="experiments.catalog", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="of a study, or of any runs")
    parser.add_argument("setting", help="such as shoot.sensor.read_noise")
    parser.add_argument("metric", help="such as panzoom.pan.rms")
    given = parser.parse_args()
    if importlib.util.find_spec("datafusion") is None:
        raise PzcapError("a catalog needs more of Rerun; say: pip install 'pzcap[catalog]'")
    recordings = [run / RECORDING for run in runs_in(given.folder)]
    wall, cpu = time.perf_counter(), time.process_time()
    found = ask(recordings, given.setting, given.metric)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    table = Table(title=f"{given.metric} by {given.setting}", title_justify="left", header_style="bold")
    for name in (given.setting, *found.columns):
        table.add_column(name, justify="right")
    for value, row in found.iterrows():
        name = f"{value:g}" if isinstance(value, float) else str(value)
        table.add_row(name, *("–" if number != number else f"{number:.4g}" for number in row))  # no spread of one run
    out = Console()
    out.print(table)
    out.print(f"{len(recordings)} recordings, asked in {wall:.2f} s ({cpu:.2f} s of CPU)", highlight=False)


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_command)


if __name__ == "__main__":
    sys.exit(main())
