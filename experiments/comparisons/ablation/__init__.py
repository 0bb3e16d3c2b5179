"""An error budget of the body in millimetres: what each piece of evidence is worth, and what each error costs.

    python -m experiments.compare ablation seed=0 hydra.run.dir=DIR       # conf/experiment/ablation.yaml
    python -m experiments.compare ablation experiment=pedestrian          # of another motion
    python -m experiments.compare ablation capture=FOLDER                 # with truth/ beside it

prints a table and leaves DIR/{metrics.json, ablation.csv, ablation.png, keyframes.png}. The cameras are calibrated and
localised once; then the body is tracked under one variant after the other
(`experiments.comparisons.ablation.variants`):

switched off  one piece of evidence, or one mechanism, is left out.
keyframes     fewer of those that the capture has, or more, posed with the error of a hand as those are. The second plot
              is the joint error against keyframes a second.
cameras       the body may not correct them (`pzcap.tracking.camera_refinement`); or each pan is made wrong, and the
              tracker told by how much it may be.
known         the experiment puts the truth in place of an estimate: cameras, masks (before a hall that shows them, so
              that colours agree), the athlete's lengths and girths, the keyframes' poses. The tracker is the same, and
              does not know.

Joints are scored as in a run, in frames that are keyframes neither by default nor in the variant. CPU time is that of
the tracker and its worker process, a frame set, one variant after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator
from rich.console import Console

from experiments.comparisons.ablation.trial import attempt, prepare
from experiments.comparisons.ablation.variants import VARIANTS
from experiments.comparisons.harness import Bar, Column, Comparison, Row, draw_bars, scored_capture, with_differences
from experiments.config import AppConfig
from experiments.progress import Bars
from experiments.report.style import COLOURS, INK, MUTED

MEAN: Final = "mpjpe.mean"
CUT_OFF: Final = 3.0
"""Times the default's error, where a bar ends."""


def compare(config: AppConfig, folder: Path, console: Console) -> Sequence[Row[Any]]:
    """Every variant on one capture, the default first."""
    del folder
    with Bars(console) as bars:
        capture, truth = scored_capture(config, bars.update)
        material = prepare(capture, truth, config.reconstruct, bars.update)
    with Bars(console) as bars:
        outcomes = [attempt(material, variant, config.reconstruct, bars.update) for variant in VARIANTS]
    rows: list[Row[Any]] = []
    for outcome in outcomes:
        figures = outcome.figures | {"cpu": outcome.cpu_ms, "keyframes": outcome.keyframes_per_s}
        rows.append(Row(outcome.variant.key, outcome.variant.label, figures, outcome.variant.group))
    return with_differences(rows, MEAN)


def draw_budget(figure: Figure, rows: Sequence[Row[Any]]) -> None:
    """A bar a variant, cut off where it is far longer than the default's."""
    bars = [Bar(row, row.figures[MEAN], row.figures["lost"]) for row in rows if row.figures[MEAN] is not None]
    means = [bar.mean or 0.0 for bar in bars]
    longest = CUT_OFF * means[0]
    label = "mean joint error [mm]" + (", bars cut off" if max(means) > longest else "")
    draw_bars(figure, bars, longest, label).axvline(means[0], color=INK, lw=0.8, ls="--")


def draw_keyframes(figure: Figure, rows: Sequence[Row[Any]]) -> None:
    """Joint error against keyframes a second."""
    posed = [row for row in rows if row.group in ("default", "keyframes")]
    posed.sort(key=lambda row: row.figures["keyframes"] or 0.0)
    rate = [row.figures["keyframes"] or 0.0 for row in posed]
    axes = figure.subplots()
    for name, colour, dash, label in ((MEAN, COLOURS[0], "-", "mean"), ("mpjpe.p95", MUTED, "--", "p95")):
        values = [row.figures[name] or np.nan for row in posed]
        axes.plot(rate, values, dash, marker="o", color=colour, label=label)
    for row, x in zip(posed, rate, strict=True):
        if lost := row.figures["lost"]:
            place = (x, row.figures[MEAN] or 0.0)
            axes.annotate(f"{lost:.0f} frames lost", place, (6, 3), textcoords="offset points", color=INK, fontsize=8)
    axes.set(xscale="log", yscale="log", xlabel="keyframes a second", ylabel="joint error [mm]")
    axes.set_xticks(rate, [f"{value:.2g}" for value in rate])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.legend()


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="ablation",
    columns=(
        Column(MEAN, "mean", "mm", "{:.1f}"),
        Column("mpjpe.p95", "p95", "mm", "{:.1f}"),
        Column("mpjpe.inverted", "inverted", "mm", "{:.1f}"),
        Column("mpjpe.airborne", "airborne", "mm", "{:.1f}"),
        Column("lost", "lost", "frames", "{:.0f}"),
        Column("more", "± mean", "mm", "{:+.1f}"),
        Column("cpu", "CPU ms", "ms/frame", "{:.0f}"),
        Column("keyframes", None, "1/s"),
    ),
    compare=compare,
    plots={
        "ablation.png": ((8.0, 0.25 * 1.15 * len(VARIANTS) + 1.0), draw_budget),
        "keyframes.png": ((6.4, 3.6), draw_keyframes),
    },
    experiment="ablation",
    variants="joint errors in mm",
    also={"body.mpjpe.true_cameras": "true_cameras.mpjpe.mean"},
)
