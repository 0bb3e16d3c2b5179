"""What the bench leaves behind: a table, a plot of the errors, and every answer."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from rich.text import Text

from experiments.comparisons.peers import bench
from experiments.comparisons.peers.bench import METHODS, Result
from experiments.comparisons.peers.material import Material
from experiments.metrics import Metric, format_value
from experiments.report.plots import COLOURS, INK, MUTED, STYLE
from pzcap.types import Array

RESULTS: Final = ("metrics.json", "errors.png", "answers.csv")
DOTS_PER_INCH: Final = 120
WIDTH: Final = 130  # columns of text that the table takes
DASHES: Final = ("-", "--", ":")


def print_table(console: Console, title: str, results: Sequence[Result]) -> None:
    """A line a method."""
    figures = {metric.key: metric for metric in bench.metrics(results)}
    scored = bench.scored(results)
    what = "" if scored else "agreement."
    of = "" if scored else " from the median of all"
    table = Table(title=f"{title}{of}", title_justify="left", header_style="bold")
    table.add_column("method", no_wrap=True)
    for column in ("pan median", "p95", "rms deg", "focal median", "p95", "rms %", "failures", "CPU ms"):
        table.add_column(column, justify="right", no_wrap=True)
    for result in results:
        label, key = METHODS[result.name].label, f"peers.{result.name}."
        if result.missing is not None:
            table.add_row(label, Text(result.missing, "dim"), *[""] * 7)
            continue
        row = [figures[f"{key}{what}{quantity}.{name}"] for quantity in ("pan", "focal") for name in bench.STATISTICS]
        lost = figures[f"{key}failures"]
        failures = f"{format_value(lost)}/{len(result.answers)}"
        table.add_row(label, *map(_short, row), failures, format_value(figures[f"{key}time"]))
    console.width = max(console.width, WIDTH)  # a wide table beats one whose figures are cut off
    console.print(table)


def _short(metric: Metric) -> str:
    """Two significant digits, without an exponent."""
    if metric.value is None:
        return "–"
    if metric.value <= 0:
        return "0"
    return f"{metric.value:.{max(0, 1 - int(np.floor(np.log10(metric.value))))}f}"


def write_answers(path: Path, material: Material, results: Sequence[Result]) -> None:
    """Every answer, a line a view and method; fields are empty where there is none."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["method", "camera", "frame", "pan_deg", "focal_px", "true_pan_deg", "true_focal_px", "cpu_ms"])
        for result in results:
            for answer in result.answers:
                values: list[object] = [result.name, material.cameras[answer.camera], answer.frame]
                for estimate in (answer.estimate, answer.truth):
                    values += ["", ""] if estimate is None else [np.rad2deg(estimate.pan_rad), estimate.focal_px]
                writer.writerow([*values, round(1000.0 * answer.seconds, 3)])


def write_plot(path: Path, results: Sequence[Result]) -> None:
    """The share of views (of all that there are) below an error, for pan and for the focal length."""
    summaries = bench.summarise(results)
    what = "error" if bench.scored(results) else "distance from the median of all methods"
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 4.4))
        pan, focal = figure.subplots(1, 2, sharey=True)
        for number, result in enumerate(results):
            summary = summaries[result.name]
            if summary is None:
                continue
            style = (COLOURS[number % len(COLOURS)], DASHES[number // len(COLOURS) % len(DASHES)])
            if result.name.startswith("ours"):
                style = (INK, DASHES[number % 2])
            _distribution(
                pan, np.degrees(np.abs(summary.pan_rad)), len(result.answers), METHODS[result.name].label, style
            )
            _distribution(focal, 100.0 * np.abs(summary.focal), len(result.answers), METHODS[result.name].label, style)
        pan.set_xlabel(f"pan {what} [deg]")
        focal.set_xlabel(f"focal length {what} [%]")
        pan.set_ylabel("share of views below it")
        focal.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), labelcolor=INK, edgecolor=MUTED)
        figure.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": None})


def _distribution(axes: Axes, errors: Array, views: int, label: str, style: tuple[str, str]) -> None:
    colour, dash = style
    axes.set_xscale("log")
    axes.plot(np.sort(errors), np.arange(1, len(errors) + 1) / max(views, 1), color=colour, ls=dash, label=label)
