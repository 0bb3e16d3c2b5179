"""Ask a folder of recordings as one table: how a figure goes with a setting, and how long the answer takes.

    python -m experiments.catalog outputs/study/noise shoot.sensor.read_noise panzoom.pan.rms

The recordings are served as a catalog on this machine and asked through Rerun's own query, as docs/recording.md shows.
Opened means that every recording is registered with the server, asked that the whole table has come back. The time
that Python takes to load the libraries is in neither.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rerun as rr

from experiments.config import nearest
from experiments.errors import guard
from experiments.recordings import readable
from experiments.review import RECORDING, runs_in
from experiments.terminal import command_line, print_whole, table, terminal
from pzcap.types import PzcapError


@contextmanager
def served(recordings: Sequence[Path]) -> Iterator[Any]:
    """A catalog's dataset of the recordings, a segment each."""
    with rr.server.Server(host="127.0.0.1", datasets={"runs": [str(path.resolve()) for path in recordings]}) as server:
        client = server.client()  # the dataset does not outlive it
        yield client.get_dataset("runs")


def ask(dataset: Any, setting: str, metric: str) -> Any:
    """Count, mean and standard deviation of a metric at each value of a setting: a pandas table.

    PzcapError where the recordings hold no such setting or metric.
    """
    runs = dataset.segment_table().to_pandas()
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
    parser = command_line("catalog", __doc__)
    parser.add_argument("folder", type=Path, help="of a study, or of any runs")
    parser.add_argument("setting", help="such as shoot.sensor.read_noise")
    parser.add_argument("metric", help="such as panzoom.pan.rms")
    given = parser.parse_args()
    try:
        for library in ("datafusion", "pandas"):  # which a question would load; before the clock runs
            importlib.import_module(library)
    except ImportError:
        raise PzcapError("a catalog needs more of Rerun; say: pip install 'pzcap[catalog]'") from None
    recordings = readable([run / RECORDING for run in runs_in(given.folder)])
    if not recordings:
        raise PzcapError(f"{given.folder}: none of its recordings can be read; make the runs again")
    begun = _clocks()
    with served(recordings) as dataset:
        opened = _clocks()
        found = ask(dataset, given.setting, given.metric)
        answered = _clocks()
    rows = [
        # one run has no spread
        (f"{value:g}" if isinstance(value, float) else str(value), *("–" if n != n else f"{n:.4g}" for n in row))
        for value, row in found.iterrows()
    ]
    out = terminal()
    columns = [f">{name}" for name in (given.setting, *found.columns)]
    print_whole(out, table(f"{given.metric} by {given.setting}", columns, rows))
    took = f"opened in {_between(begun, opened)}, asked in {_between(opened, answered)}"
    out.print(f"{len(recordings)} recordings, {took}", highlight=False, soft_wrap=True)


def _clocks() -> tuple[float, float]:
    """Wall and CPU time, seconds; the server is a part of this process."""
    return time.perf_counter(), time.process_time()


def _between(start: tuple[float, float], end: tuple[float, float]) -> str:
    return f"{end[0] - start[0]:.2f} s ({end[1] - start[1]:.2f} s of CPU)"


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_command)


if __name__ == "__main__":
    sys.exit(main())
