"""What came out: metrics, a table, a plot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table

from experiments.comparisons.self_calibration.trial import CONDITIONS, METHODS, Errors
from experiments.metrics import Metric
from experiments.report.plots import COLOURS, STYLE
from pzcap.types import Mask

NAMES: Final = {
    "ours": "ours", "shum_szeliski": "Shum-Szeliski", "sinha_pollefeys": "Sinha-Pollefeys", "wu_radke": "Wu-Radke"
}  # fmt: skip
PLOT: Final = "self_calibration.png"


def metrics_of(result: dict[tuple[str, str], list[Errors]]) -> list[Metric]:
    """Medians over the frames of all cameras that did not fail; failures; seconds, all cameras together."""

    def rows() -> Iterator[Metric]:
        for (method, condition), cameras in result.items():
            key = f"selfcal.{method}.{condition}"
            good = [~each.failed for each in cameras]

            def median(name: str, cameras: list[Errors] = cameras, good: list[Mask] = good) -> float | None:
                values = np.concatenate([getattr(e, name)[g] for e, g in zip(cameras, good, strict=True)])
                return float(np.median(values)) if len(values) else None

            focal, pan = median("focal"), median("pan_rad")
            yield Metric(f"{key}.focal.median", None if focal is None else 100.0 * focal, "%")
            yield Metric(
                f"{key}.pan_after_common_rotation.median", None if pan is None else float(np.degrees(pan)), "deg"
            )
            yield Metric(f"{key}.principal.median", median("principal_px"), "px")
            yield Metric(f"{key}.k1.median", median("k1"), "1")
            yield Metric(f"{key}.failures", float(sum(each.failed.sum() for each in cameras)), "frames")
            yield Metric(f"{key}.frames", float(sum(len(each.failed) for each in cameras)), "frames", "higher")
            yield Metric(f"{key}.seconds", sum(each.seconds for each in cameras), "s")

    return list(rows())


def print_comparison(console: Console, title: str, found: Sequence[Metric]) -> None:
    """A row a method and set of frames."""
    by_key = {metric.key: metric.value for metric in found}
    table = Table(title=title, title_justify="left", header_style="bold", box=box.SIMPLE, padding=(0, 0))
    for name in ("method", "frames"):
        table.add_column(name, no_wrap=True)
    for name in ("focal %", "pan deg*", "centre px", "k1", "failed", "s"):
        table.add_column(name, justify="right", no_wrap=True)
    for condition in CONDITIONS:
        for method in METHODS:
            key = f"selfcal.{method}.{condition}"
            values = [
                by_key[f"{key}.{name}"]
                for name in ("focal.median", "pan_after_common_rotation.median", "principal.median", "k1.median")
            ]
            failed, count, seconds = (by_key[f"{key}.{name}"] or 0.0 for name in ("failures", "frames", "seconds"))
            cells = ["–" if value is None else f"{value:.2g}" for value in values]
            table.add_row(NAMES[method], condition, *cells, f"{failed:.0f}/{count:.0f}", f"{seconds:.0f}")
        table.add_section()
    console.print(table)
    console.print("* one common rotation a camera removed; medians over the frames that did not fail")


def plot(path: Path, found: Sequence[Metric]) -> None:
    """Focal and pan error of each method and set of frames, and the share that failed."""
    by_key = {metric.key: metric.value for metric in found}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 3.4), dpi=140)
        panels = figure.subplots(1, 3)
        names = (("focal.median", "focal length [%]"), ("pan_after_common_rotation.median", "pan [deg], one common "
                 "rotation removed"), ("failures", "frames that failed [%]"))  # fmt: skip
        for axes, (name, label) in zip(panels, names, strict=True):
            for n, method in enumerate(METHODS):
                keys = [f"selfcal.{method}.{condition}" for condition in CONDITIONS]
                values = [by_key[f"{key}.{name}"] for key in keys]
                heights = [0.0 if value is None else value for value in values]
                if name == "failures":
                    heights = [
                        100.0 * h / max(by_key[f"{k}.frames"] or 1.0, 1.0) for h, k in zip(heights, keys, strict=True)
                    ]
                axes.bar(np.arange(3) + 0.2 * (n - 1.5), heights, 0.18, color=COLOURS[n], label=NAMES[method])
            axes.set_xticks(np.arange(3), CONDITIONS)
            axes.set_title(label)
            if name != "failures":
                axes.set_yscale("log")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        figure.savefig(path)
