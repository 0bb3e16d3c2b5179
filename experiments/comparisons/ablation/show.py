"""What an ablation leaves behind: a table, the same as CSV, metrics, and two plots."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator
from rich import box
from rich.console import Console
from rich.table import Table

from experiments.comparisons.ablation.trial import Outcome
from experiments.metrics import Metric
from experiments.report.plots import COLOURS, INK, MUTED, STYLE

RESULTS: Final = ("metrics.json", "ablation.csv", "ablation.png", "keyframes.png")
FIGURES: Final = {
    "mpjpe.mean": "mm", "mpjpe.p95": "mm", "mpjpe.inverted": "mm", "mpjpe.airborne": "mm", "lost": "frames"
}  # fmt: skip
GROUPS: Final = dict(zip(("default", "evidence", "keyframes", "cameras", "truth"), (MUTED, *COLOURS), strict=False))
DOTS_PER_INCH: Final = 140
CUT_OFF: Final = 3.0  # default's errors, where a bar ends
WIDTH: Final = 96  # columns of text that the table takes


def metrics_of(outcomes: Sequence[Outcome]) -> list[Metric]:
    """Every figure of every variant, and the one that metrics.md asks for by a name of its own."""
    found = []
    for outcome in outcomes:
        key = f"ablation.{outcome.variant.key}"
        found += [Metric(f"{key}.{name}", outcome.figures[name], unit) for name, unit in FIGURES.items()]
        found.append(Metric(f"{key}.keyframes", outcome.keyframes_per_s, "1/s"))
        found.append(Metric(f"{key}.cpu", outcome.cpu_ms, "ms/frame"))
        if outcome.variant.key == "true_cameras":
            found.append(Metric("body.mpjpe.true_cameras", outcome.figures["mpjpe.mean"], "mm"))
    return found


def _numbers(outcome: Outcome, usual: Outcome) -> list[float | None]:
    """The figures, by how much the mean is more than as ``usual``, and CPU milliseconds."""
    mean, before = outcome.figures["mpjpe.mean"], usual.figures["mpjpe.mean"]
    more = None if mean is None or before is None else mean - before
    return [*(outcome.figures[name] for name in FIGURES), more, outcome.cpu_ms]


def print_budget(console: Console, title: str, outcomes: Sequence[Outcome]) -> None:
    """A row a variant, the default first."""
    table = Table(title=title, title_justify="left", header_style="bold", box=box.SIMPLE, padding=(0, 1))
    table.add_column("joint errors in mm", no_wrap=True)
    for name in ("mean", "p95", "inverted", "airborne", "lost", "± mean", "CPU ms"):
        table.add_column(name, justify="right", no_wrap=True)
    forms = ("{:.1f}",) * 4 + ("{:.0f}", "{:+.1f}", "{:.0f}")
    for outcome, following in zip(outcomes, [*outcomes[1:], outcomes[-1]], strict=True):
        values = zip(forms, _numbers(outcome, outcomes[0]), strict=True)
        cells = ["–" if value is None else form.format(value) for form, value in values]
        last = outcome.variant.group != following.variant.group
        table.add_row(outcome.variant.label, *cells, end_section=last)
    console.width = max(console.width, WIDTH)  # a wide table beats one whose figures are cut off
    console.print(table)


def write_csv(path: Path, outcomes: Sequence[Outcome]) -> None:
    """The table's numbers."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        names = [f"{name} [{unit}]" for name, unit in FIGURES.items()]
        writer.writerow(["group", "variant", *names, "difference of mean [mm]", "CPU [ms/frame]"])
        for outcome in outcomes:
            writer.writerow([outcome.variant.group, outcome.variant.label, *_numbers(outcome, outcomes[0])])


def plot_budget(path: Path, outcomes: Sequence[Outcome]) -> None:
    """A bar a variant, cut off where it is far longer than the default's, with its figures beside it."""
    known = [(each, each.figures["mpjpe.mean"]) for each in outcomes]
    shown = [(each, mean) for each, mean in known if mean is not None]
    steps = (1.0 + 0.6 * (one.variant.group != other.variant.group) for (one, _), (other, _) in pairwise(shown))
    at, means = np.cumsum([0.0, *steps]), np.array([mean for _, mean in shown])
    longest = CUT_OFF * means[0]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.25 * float(at[-1]) + 1.0))
        axes = figure.subplots()
        axes.barh(at, np.minimum(means, longest), 0.72, color=[GROUPS[each.variant.group] for each, _ in shown])
        axes.axvline(means[0], color=INK, lw=0.8, ls="--")
        plain = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}  # the dashed line stays legible beside figures
        for y, (each, mean) in zip(at.tolist(), shown, strict=True):
            lost = each.figures["lost"]
            said = f"{mean:.1f}" + (f", {lost:.0f} frames lost" if lost else "")
            axes.annotate(
                said, (min(mean, longest), y), (4, 0), textcoords="offset points", va="center", color=INK, bbox=plain
            )
        axes.set_xlim(0.0, 1.25 * min(float(means.max()), longest))
        axes.set_yticks(at, [each.variant.label for each, _ in shown])
        axes.invert_yaxis()
        axes.margins(y=0.02)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("mean joint error [mm]" + (", bars cut off" if means.max() > longest else ""))
        figure.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": None})


def plot_keyframes(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Joint error against keyframes a second."""
    posed = [each for each in outcomes if each.variant.group in ("default", "keyframes")]
    posed.sort(key=lambda each: each.keyframes_per_s)
    rate = [each.keyframes_per_s for each in posed]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.6))
        axes = figure.subplots()
        for name, colour, dash, label in (("mpjpe.mean", COLOURS[0], "-", "mean"), ("mpjpe.p95", MUTED, "--", "p95")):
            axes.plot(
                rate, [each.figures[name] or np.nan for each in posed], dash, marker="o", color=colour, label=label
            )
        for each in posed:
            lost = each.figures["lost"]
            if lost:
                text = f"{lost:.0f} frames lost"
                axes.annotate(text, (each.keyframes_per_s, each.figures["mpjpe.mean"] or 0.0), (6, 3),
                              textcoords="offset points", color=INK, fontsize=8)  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(rate, [f"{value:.2g}" for value in rate])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set_xlabel("keyframes a second")
        axes.set_ylabel("joint error [mm]")
        axes.legend()
        figure.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": None})
