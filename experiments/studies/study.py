"""All runs of a sweep as one table: what was set, what came out, and with which versions.

`python -m experiments.sweep` ends with FOLDER/runs.parquet and FOLDER/index.html (`experiments.studies.page`). The
table is a Parquet data set: a folder of parts, each of a thousand runs, written one after the other and never held
whole.
"""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from experiments.config import leaves
from experiments.metrics import read_metrics
from experiments.studies import jobs
from pzcap.extras import keyframe_diagnostics
from pzcap.scoring.metric import Metric
from pzcap.types import PzcapError

TABLE: Final = "runs.parquet"
METRICS: Final = "metrics.json"
SEED: Final = "seed"
PART: Final = 1000
"""Runs in one part of the table: some MB while it is written."""
REASONS: Final = 1000
"""Reasons of failed jobs that are kept."""


@dataclass(frozen=True, slots=True)
class Run:
    """One finished run."""

    folder: Path
    overrides: tuple[str, ...]  # all that was asked for, study and experiment included
    settings: Mapping[str, Any]  # dotted key -> value, of the whole configuration
    metrics: tuple[Metric, ...]
    versions: Mapping[str, str]
    notes: tuple[str, ...]  # of its reconstruction, on what is wrong or odd
    seconds: float  # wall clock

    @property
    def command(self) -> str:
        """Command that makes it again."""
        return shlex.join(["python", "-m", "experiments.run", *self.overrides])

    @property
    def chosen(self) -> dict[str, str]:
        """Key -> value of each override, in their order."""
        return {key.lstrip("+"): value for key, _, value in (one.partition("=") for one in self.overrides)}


@dataclass(frozen=True, slots=True)
class Study:
    """The table of a sweep, on disk, and why the jobs without a result failed."""

    folder: Path
    count: int  # runs
    axes: tuple[str, ...]  # settings that were varied, in the order of the command; the seed where nothing else was
    failures: int
    failed: Mapping[str, str]  # name of the job -> reason, of the first thousand

    @property
    def metrics(self) -> frozenset[str]:
        """Those that at least one run has a value of."""
        schema = _dataset(self.folder / TABLE).schema
        names = [name for name in schema.names if name.startswith("metric.")]
        empty = set(names)
        for batch in self._batches(names):
            empty -= {name for name in empty if batch.column(name).null_count < len(batch)}
            if not empty:
                break
        return frozenset(name.removeprefix("metric.") for name in set(names) - empty)

    def column(self, key: str) -> str:
        """The table's column of a setting, or of a group that was chosen."""
        return _column_of(key, _dataset(self.folder / TABLE).schema.names)

    def is_number(self, key: str) -> bool:
        """Tell if all runs have a number for this setting."""
        kind = _dataset(self.folder / TABLE).schema.field(self.column(key)).type
        return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind)) and not self._has_null(self.column(key))

    def rows(self, columns: Sequence[str]) -> Iterator[dict[str, Any]]:
        """The runs, one after the other, by these columns of the table; None where the table has no such column."""
        names = _dataset(self.folder / TABLE).schema.names
        known = [name for name in columns if name in names]
        missing = dict.fromkeys(set(columns) - set(known))
        for batch in self._batches(known):
            for row in batch.to_pylist():
                yield {**row, **missing}

    def _batches(self, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
        return _batches(_dataset(self.folder / TABLE), columns)

    def _has_null(self, column: str) -> bool:
        return any(batch.column(0).null_count for batch in self._batches([column]))


def collect(folder: Path, places: Iterable[Path]) -> Study | None:
    """Write FOLDER/runs.parquet of the jobs in ``places``, whole or not at all; None where none of them has metrics.

    A row a run: path, command, seconds, notes (a line each), ``config.*``, ``chosen.*`` (of groups, as experiment=...),
    ``metric.*`` (with its unit), ``version.*``. A job without metrics is left out; one whose files cannot be read
    counts as failed.
    """
    failed: dict[str, str] = {}
    count = failures = 0
    chosen: dict[str, None] = {}
    fresh = folder / f".{TABLE}.fresh"
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    try:
        part: list[Run] = []
        for place in places:
            run, reason = _read(place)
            if reason is not None:
                failures += 1
                if len(failed) < REASONS:
                    failed[place.name] = reason
            if run is not None:
                part.append(run)
                chosen |= dict.fromkeys(run.chosen)
                count += 1
            if len(part) == PART:
                _write(fresh, count, folder, part)
                part = []
        if part:
            _write(fresh, count, folder, part)
        if not count:
            return None
        _align(fresh)
        _replace(fresh, folder / TABLE)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    return Study(folder, count, _axes(_dataset(folder / TABLE), list(chosen)), failures, failed)


def _column_of(key: str, names: Iterable[str]) -> str:
    return f"config.{key}" if f"config.{key}" in names else f"chosen.{key}"


def _dataset(path: Path) -> ds.Dataset:
    return ds.dataset(path, format="parquet")


def _batches(table: ds.Dataset, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """Some rows at a time, in their order, and no more of them in memory than that."""
    yield from table.to_batches(columns=list(columns), batch_readahead=1, fragment_readahead=1)


def _read(place: Path) -> tuple[Run | None, str | None]:
    """The run in ``place``, and the reason why its job failed."""
    try:
        run = _run(place) if (place / METRICS).exists() else None
        return run, jobs.failure(place)
    except PzcapError as error:
        return None, str(error)


def _run(folder: Path) -> Run:
    metrics, info = read_metrics(folder / METRICS)
    overrides, seconds = jobs.marked(folder)
    notes = tuple(note for note in info["notes"] if not keyframe_diagnostics.is_advice(note))
    return Run(folder, overrides, leaves(info["config"]), metrics, info["versions"], notes, seconds)


def _write(parts: Path, count: int, folder: Path, runs: Sequence[Run]) -> None:
    """A further part of the table, whose last run is number ``count``."""
    rows = [
        {
            "path": run.folder.relative_to(folder).as_posix(),
            "command": run.command,
            "seconds": run.seconds,
            "notes": "\n".join(run.notes),
            **{f"config.{key}": _scalar(value) for key, value in run.settings.items()},
            **{f"chosen.{key}": value for key, value in run.chosen.items() if key not in run.settings},
            **{f"metric.{metric.key}": metric.value for metric in run.metrics},
            **{f"version.{name}": version for name, version in run.versions.items()},
        }
        for run in runs
    ]
    units = {f"metric.{metric.key}": metric.unit for run in runs for metric in run.metrics}
    names = list(dict.fromkeys(chain.from_iterable(rows)))
    columns = [_column([row.get(name) for row in rows], number=name in units) for name in names]
    fields = [
        pa.field(name, column.type, metadata={"unit": units[name]} if name in units else None)
        for name, column in zip(names, columns, strict=True)
    ]
    pq.write_table(pa.table(columns, schema=pa.schema(fields)), parts / f"part-{count:09d}.parquet")


def _scalar(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict) else value


def _column(values: list[Any], *, number: bool) -> pa.Array:
    """One type a column: a number that one run has whole and another not is a number, and what is mixed is text."""
    kinds = {type(value) for value in values if value is not None}
    if number or kinds == {int, float}:
        return pa.array(values, pa.float64())
    return pa.array(values if len(kinds) <= 1 else [None if value is None else str(value) for value in values])


def _align(parts: Path) -> None:
    """Give all parts the same columns, of the same types: those that differ are written again, one by one."""
    paths = sorted(parts.iterdir())
    fields: dict[str, pa.Field] = {}
    for path in paths:
        for field in pq.read_schema(path):
            before = fields.get(field.name)
            fields[field.name] = field if before is None else _common(before, field)
    schema = pa.schema(list(fields.values()))
    for path in paths:
        if not pq.read_schema(path).equals(schema, check_metadata=True):
            table = pq.read_table(path)
            columns = [
                table[field.name].cast(field.type)
                if field.name in table.column_names
                else pa.nulls(len(table), field.type)
                for field in schema
            ]
            pq.write_table(pa.table(columns, schema=schema), path)


def _common(one: pa.Field, other: pa.Field) -> pa.Field:
    """The column that holds the values of both."""
    if one.type == other.type or pa.types.is_null(other.type):
        return one
    if pa.types.is_null(one.type):
        return other
    numbers = {pa.int64(), pa.float64()}
    return one.with_type(pa.float64() if {one.type, other.type} <= numbers else pa.string())


def _replace(fresh: Path, table: Path) -> None:
    """Put a table in the place of an earlier one."""
    stale = table.with_name(f".{TABLE}.stale")
    shutil.rmtree(stale, ignore_errors=True)
    if table.is_file():  # as it was written once
        table.unlink()
    elif table.exists():
        table.rename(stale)
    fresh.rename(table)
    shutil.rmtree(stale, ignore_errors=True)


def _axes(table: ds.Dataset, chosen: Sequence[str]) -> tuple[str, ...]:
    """The settings among ``chosen`` that have more than one value; the seed is none, unless it is all there is."""
    varied = [key for key in chosen if key != SEED and _varies(table, _column_of(key, table.schema.names))]
    return tuple(varied) or (SEED,)


def _varies(table: ds.Dataset, name: str) -> bool:
    values: set[Any] = set()
    for batch in _batches(table, [name]):
        values |= set(pc.unique(batch.column(0)).to_pylist())
        if len(values) > 1:
            return True
    return False
