"""The harness of all comparisons: variants on material in, rows out; metrics, table, csv and plots are made here.

A comparison declares its columns and plots, and a function that runs its variants; `python -m experiments.compare NAME`
does the rest. The metric of a row's figure is named ``PREFIX.ROW.COLUMN``.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.text import Text

from experiments import footage
from experiments.config import AppConfig
from experiments.metrics import run_info, write_metrics
from experiments.report.style import COLOURS, INK, MUTED, STYLE
from experiments.score import score
from experiments.terminal import print_whole, table
from experiments.totals import metrics
from pzcap.io import results
from pzcap.io.capture import read_capture
from pzcap.io.files import written_whole
from pzcap.pipeline import reconstruct
from pzcap.progress import Report
from pzcap.scoring.metric import Direction, Metric
from pzcap.types import Capture, PzcapError, Reconstruction
from sim.truth import Truth

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Column:
    """One figure of every row."""

    key: str  # in metrics
    head: str | None  # over the table's column; None: in metrics and csv alone
    unit: str
    form: str = "{:.3g}"
    direction: Direction = "lower"


@dataclass(frozen=True, slots=True, eq=False)
class Row(Generic[T]):
    """Result of one variant."""

    key: str  # in metrics
    label: str
    figures: Mapping[str, float | None]  # Column.key -> value; a column may be missing
    group: str = ""  # rows of one group stand together
    missing: str | None = None  # why the variant did not run
    detail: T | None = None  # what plots are drawn from, besides


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Generic[T]):
    """One comparison."""

    name: str  # on the command line, and of the csv file
    columns: tuple[Column, ...]
    compare: Callable[[Any, Path, Console], Iterable[Row[T]]]  # of the configuration, the folder, for progress
    experiment: str  # of conf/experiment, where none is named
    plots: Mapping[str, tuple[tuple[float, float], Callable[[Figure, Sequence[Row[T]]], None]]] = field(
        default_factory=dict
    )
    """File -> its size in inches, and what draws it."""
    prefix: str = ""  # of its metrics; empty: its name
    variants: str = "variant"  # what the table calls a row
    note: str = ""  # below the table
    also: Mapping[str, str] = field(default_factory=dict)  # a metric's further name -> "ROW.COLUMN"
    config: type[AppConfig] = AppConfig
    config_name: str = "config"
    others: tuple[str, ...] = field(default=())  # files that ``compare`` itself leaves
    takes_cameras: bool = False  # those of earlier results, ``cameras=``

    @property
    def results(self) -> tuple[str, ...]:
        """The files that it leaves."""
        return ("metrics.json", f"{self.name}.csv", *self.plots, *self.others)


def execute(
    comparison: Comparison[T], config: AppConfig, tree: dict[str, Any], folder: Path, console: Console
) -> Sequence[Row[T]]:
    """Run ``comparison`` and leave its results in ``folder``; the csv file holds the rows that there are, also where a
    later one is killed. Raises PzcapError for what the user can mend."""
    if config.cameras is not None and not comparison.takes_cameras:
        raise PzcapError(f"the comparison {comparison.name} calibrates by itself; leave cameras=... out")
    folder.mkdir(parents=True, exist_ok=True)
    for name in comparison.results:
        (folder / name).unlink(missing_ok=True)
    rows: list[Row[T]] = []
    for row in comparison.compare(config, folder, console):
        rows.append(row)
        _write_csv(folder / f"{comparison.name}.csv", comparison, rows)
    for name, ((width, height), draw) in comparison.plots.items():
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(width, height), dpi=130)
            draw(figure, rows)
            figure.savefig(folder / name, metadata={"Software": None})
    write_metrics(folder / "metrics.json", metrics_of(comparison, rows), run_info(tree, config.seed))
    return rows


def metrics_of(comparison: Comparison[T], rows: Sequence[Row[T]]) -> list[Metric]:
    """Every figure of every row."""
    prefix = comparison.prefix or comparison.name
    found = {
        f"{row.key}.{column.key}": Metric(
            f"{prefix}.{row.key}.{column.key}", row.figures[column.key], column.unit, column.direction
        )
        for row in rows
        for column in comparison.columns
        if column.key in row.figures
    }
    return [*found.values(), *(replace(found[place], key=key) for key, place in comparison.also.items())]


def print_rows(console: Console, comparison: Comparison[T], title: str, rows: Sequence[Row[T]]) -> None:
    """The table: a line a row, a rule between groups."""
    known = {key for row in rows for key in row.figures}
    columns = [column for column in comparison.columns if column.head is not None and column.key in known]
    cells: list[Sequence[str | Text]] = []
    for row in rows:
        if row.missing is not None:
            cells.append((row.label, Text(row.missing, "dim")))
            continue
        values = [(column.form, row.figures.get(column.key)) for column in columns]
        cells.append((row.label, *("–" if value is None else form.format(value) for form, value in values)))
    shown = table(title, (comparison.variants, *(f">{column.head}" for column in columns)), cells, plain=True)
    for line, row, following in zip(shown.rows, rows, rows[1:], strict=False):
        line.end_section = row.group != following.group
    print_whole(console, shown)
    if comparison.note:
        console.print(comparison.note, highlight=False)


def _write_csv(path: Path, comparison: Comparison[T], rows: Sequence[Row[T]]) -> None:
    with written_whole(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["group", "key", "label", *(f"{column.key} [{column.unit}]" for column in comparison.columns)])
        for row in rows:
            values = (row.figures.get(column.key) for column in comparison.columns)
            writer.writerow([row.group, row.key, row.label, *("" if value is None else value for value in values)])


def scored_capture(config: AppConfig, report: Report) -> tuple[Capture, Truth]:
    """The capture that is named, or else shot, and the truth beside it. Raises PzcapError where there is none."""
    shot = footage.capture_of(config, report)
    truth = footage.truth_beside(shot)
    if truth is None:
        raise PzcapError(f"{shot}: a comparison needs the truth; give a capture with truth/ beside it, or none")
    return read_capture(shot), truth


# --------------------------------------------------------------------------------------------------------------
# What comparisons of the body share

MEAN: Final = Column("body.mpjpe.mean", "mean mm", "mm", "{:.1f}")
P95: Final = Column("body.mpjpe.p95", "p95 mm", "mm", "{:.1f}")
LOST: Final = Column("body.lost", "lost", "frames", "{:.0f}")
COVERED: Final = Column("body.covered", "covered %", "%", "{:.0f}", "higher")


def body(reconstruction: Reconstruction, truth: Truth) -> dict[str, float | None]:
    """The scores of the body alone."""
    bodily = replace(reconstruction, tracks=(None,) * len(reconstruction.tracks))
    return {metric.key: metric.value for metric in metrics(score(bodily, truth, None))}


def without_keypoints(capture: Capture) -> Capture:
    """The capture as if no detector had been run."""
    return replace(capture, cameras=tuple(replace(camera, keypoints=None) for camera in capture.cameras))


def on_keypoints(config: AppConfig, report: Report) -> tuple[Capture, Truth, Reconstruction, Reconstruction]:
    """A capture with keypoints and its truth; its reconstruction by pixels alone, and by both with the same cameras.

    Raises PzcapError where no camera has keypoints.
    """
    known = None if config.cameras is None else results.load(footage.reconstruction_in(Path(config.cameras)))
    capture, truth = scored_capture(config, report)
    if not any(camera.keypoints for camera in capture.cameras):
        raise PzcapError(f"{capture.folder}: no camera has keypoints; name them in capture.json (docs/capture.md)")
    pixels = reconstruct(without_keypoints(capture), config.reconstruct, report, known)
    return capture, truth, pixels, reconstruct(capture, config.reconstruct, report, pixels)


def labelled(report: Report, label: str) -> Report:
    """``report``, each stage named after the variant that it is of."""
    return lambda stage, done, total: report(f"{label}: {stage}", done, total)


def with_differences(rows: Sequence[Row[T]], mean: str) -> list[Row[T]]:
    """The rows, each with how much its figure ``mean`` is beyond that of the first, as ``more``."""
    usual = rows[0].figures.get(mean)
    found = []
    for row in rows:
        own = row.figures.get(mean)
        more = None if own is None or usual is None else own - usual
        found.append(replace(row, figures={**row.figures, "more": more} if row.figures else {}))
    return found


class Bar(NamedTuple):
    """Error of a row as a bar."""

    row: Row[Any]
    mean: float | None  # mm; None: no body
    lost: float | None  # frames


def draw_bars(figure: Figure, shown: Sequence[Bar], longest: float, label: str) -> Axes:
    """A bar a row, cut off where it is longer than ``longest``, with its figures beside it; groups stand apart, each in
    its colour."""
    colours = dict(zip(dict.fromkeys(bar.row.group for bar in shown), (MUTED, *COLOURS), strict=False))
    steps = (1.0 + 0.6 * (one.row.group != other.row.group) for one, other in pairwise(shown))
    at = np.cumsum([0.0, *steps])
    axes = figure.subplots()
    plain = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}  # lines stay legible behind figures
    for y, (row, mean, lost) in zip(at.tolist(), shown, strict=True):
        length = min(mean or 0.0, longest)
        axes.barh(y, length, 0.72, color=colours[row.group])
        said = "no body" if mean is None else f"{mean:.1f}" + (f", {lost:.0f} frames lost" if lost else "")
        colour = MUTED if mean is None else INK
        axes.annotate(said, (length, y), (4, 0), textcoords="offset points", va="center", color=colour, bbox=plain)
    axes.set_xlim(0.0, 1.25 * min(longest, max(bar.mean or 0.0 for bar in shown)))
    axes.set_yticks(at, [bar.row.label for bar in shown])
    axes.set_ylim(float(at[-1]) + 0.7, -0.7)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(label)
    return axes
