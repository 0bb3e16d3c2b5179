"""All runs of a sweep as one table: what was set, what came out, and with which versions.

`python -m experiments.sweep` ends with FOLDER/runs.parquet and FOLDER/index.html (`experiments.studies.page`).
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from experiments.config import leaves
from experiments.metrics import Metric, read_metrics
from experiments.studies import jobs
from pzcap.io.files import written_whole
from pzcap.types import PzcapError

TABLE: Final = "runs.parquet"
METRICS: Final = "metrics.json"
SEED: Final = "seed"


@dataclass(frozen=True, slots=True)
class Run:
    """One finished run."""

    folder: Path
    overrides: tuple[str, ...]  # all that was asked for, study and experiment included
    settings: Mapping[str, Any]  # dotted key -> value, of the whole configuration
    metrics: tuple[Metric, ...]
    versions: Mapping[str, str]
    seconds: float  # wall clock

    @property
    def command(self) -> str:
        """Command that makes it again."""
        return shlex.join(["python", "-m", "experiments.run", *self.overrides])

    def value(self, metric: str) -> float | None:
        """Of a metric by name; None where the run had not the material for it."""
        return next((m.value for m in self.metrics if m.key == metric), None)

    def setting(self, key: str) -> Any:
        """Of the configuration; of a group (experiment=...) what was chosen."""
        return self.settings.get(key, self.chosen.get(key))

    @property
    def chosen(self) -> dict[str, str]:
        """Key -> value of each override, in their order."""
        return {key.lstrip("+"): value for key, _, value in (one.partition("=") for one in self.overrides)}


@dataclass(frozen=True, slots=True)
class Study:
    """The runs of one sweep, and why the others failed."""

    folder: Path
    runs: tuple[Run, ...]
    failed: Mapping[str, str]  # name of the job -> reason

    @property
    def axes(self) -> tuple[str, ...]:
        """Settings that were varied, in the order of the command; the seed is none, unless it is all there is."""
        keys = dict.fromkeys(chain.from_iterable(run.chosen for run in self.runs))
        varied = [key for key in keys if len({json.dumps(run.setting(key)) for run in self.runs}) > 1]
        return tuple(key for key in varied if key != SEED) or (SEED,)


def read(folder: Path, places: Sequence[Path]) -> Study:
    """The study in ``folder`` whose jobs are those of ``places``. A job without metrics is left out; one whose files
    cannot be read counts as failed."""
    runs, failed = [], {}
    for place in places:
        try:
            if (place / METRICS).exists():
                runs.append(_run(place))
            reason = jobs.failure(place)
        except PzcapError as error:
            reason = str(error)
        if reason is not None:
            failed[place.name] = reason
    return Study(folder, tuple(runs), failed)


def _run(folder: Path) -> Run:
    metrics, info = read_metrics(folder / METRICS)
    overrides, seconds = jobs.marked(folder)
    return Run(folder, overrides, leaves(info["config"]), metrics, info["versions"], seconds)


def table(study: Study) -> pa.Table:
    """A row a run: path, command, seconds, ``config.*``, ``metric.*`` (with its unit), ``version.*``."""
    rows = [
        {
            "path": run.folder.relative_to(study.folder).as_posix(),
            "command": run.command,
            "seconds": run.seconds,
            **{f"config.{key}": _scalar(value) for key, value in run.settings.items()},
            **{f"metric.{metric.key}": metric.value for metric in run.metrics},
            **{f"version.{name}": version for name, version in run.versions.items()},
        }
        for run in study.runs
    ]
    units = {f"metric.{metric.key}": metric.unit for run in study.runs for metric in run.metrics}
    names = list(dict.fromkeys(chain.from_iterable(rows)))
    columns = [_column([row.get(name) for row in rows], number=name in units) for name in names]
    fields = [
        pa.field(name, column.type, metadata={"unit": units[name]} if name in units else None)
        for name, column in zip(names, columns, strict=True)
    ]
    return pa.table(columns, schema=pa.schema(fields))


def _scalar(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict) else value


def _column(values: list[Any], *, number: bool) -> pa.Array:
    """One type a column: a number that one run has whole and another not is a number, and what is mixed is text."""
    kinds = {type(value) for value in values if value is not None}
    if number or kinds == {int, float}:
        return pa.array(values, pa.float64())
    return pa.array(values if len(kinds) <= 1 else [None if value is None else str(value) for value in values])


def write_table(study: Study) -> None:
    """FOLDER/runs.parquet, whole or not at all."""
    with written_whole(study.folder / TABLE) as partial:
        pq.write_table(table(study), partial)
