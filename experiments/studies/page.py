"""The page of a study: errors over what was varied, a point a run, and below how each run is got again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments import pages
from experiments.metrics import Metric, format_value
from experiments.report import plots
from experiments.settings_reference import descriptions
from experiments.studies.study import SEED, Run, Study, read, write_table
from pzcap.types import Array

PAGE: Final = "index.html"
LINKS: Final = ("report.html", "recording.rrd", "metrics.json")
LOST: Final = "panzoom.lost"
COLUMNS: Final = 3
WIDTH_IN: Final = 11.8
ROW_IN: Final = 3.3


class Panel(NamedTuple):
    """One quantity over what was varied."""

    metric: str
    title: str
    bound_ratio: str | None = None  # the metric that says how many times its Cramer-Rao bound it is


PANELS: Final = (
    Panel("panzoom.pan.rms", "Pan, RMS [deg]", "panzoom.bound_ratio.pan"),
    Panel("panzoom.focal.rms", "Focal length, RMS [%]", "panzoom.bound_ratio.focal"),
    Panel("panzoom.reprojection.rms", "Scene points, RMS [px]"),
    Panel("panzoom.nees", "NEES (1: honest)"),
    Panel("foreground.iou", "Silhouettes, IoU"),
    Panel("body.mpjpe.mean", "Joints, mean [mm]"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Runs that are equal in everything but what stands on the x axis, and the seed."""

    label: str
    x: Array  # (N,) a value a run
    runs: tuple[Run, ...]

    def values(self, metric: str) -> Array:
        """(N,), NaN where a run has none: matplotlib leaves that out."""
        found = [run.value(metric) for run in self.runs]
        return np.array([np.nan if value is None else value for value in found])

    def bounds(self, panel: Panel) -> Array:
        """(N,) the least that any estimator could reach."""
        if panel.bound_ratio is None:
            return np.full(len(self.runs), np.nan)
        ratio = self.values(panel.bound_ratio)
        return self.values(panel.metric) / np.where(ratio > 0, ratio, np.nan)


class Means(NamedTuple):
    """Over the seeds: (M,) where, the mean, and the standard deviation (0 of one alone)."""

    x: Array
    mean: Array
    sigma: Array


def means(x: Array, values: Array) -> Means:
    """Statistics of ``values`` at each ``x``."""
    known = np.isfinite(values)
    places = np.unique(x[known])
    groups = [values[known & (x == place)] for place in places]
    sigma = [group.std(ddof=1) if len(group) > 1 else 0.0 for group in groups]
    return Means(places, np.array([group.mean() for group in groups]), np.array(sigma))


@dataclass(frozen=True, slots=True)
class Plan:
    """Places of variables in the plots of a study."""

    x: str
    others: tuple[str, ...]
    names: tuple[str, ...] | None  # of the places on the x axis, where they are no numbers
    lines: tuple[Line, ...]

    @classmethod
    def of(cls, study: Study) -> Plan:
        """The first axis of numbers lies along x; the runs that differ in any other are another line."""
        numeric = [axis for axis in study.axes if all(_number(run.setting(axis)) for run in study.runs)]
        x = (numeric or study.axes)[0]
        others = tuple(axis for axis in study.axes if axis != x)
        names = None if numeric else tuple(dict.fromkeys(str(run.setting(x)) for run in study.runs))
        groups: dict[tuple[Any, ...], list[Run]] = {}
        for run in study.runs:
            groups.setdefault(tuple(str(run.setting(axis)) for axis in others), []).append(run)
        lines = []
        for values, runs in groups.items():
            label = ", ".join(f"{_short(axis)} {value}" for axis, value in zip(others, values, strict=True))
            places = [float(run.setting(x)) if names is None else names.index(str(run.setting(x))) for run in runs]
            lines.append(Line(label, np.array(places, float), tuple(runs)))
        return cls(x, others, names, tuple(lines))


def write_study(folder: Path, places: Sequence[Path]) -> bool:
    """Table and page of the jobs in ``places``; False, and nothing is written, where none of them left metrics."""
    study = read(folder, places)
    if not study.runs:
        return False
    write_table(study)
    pages.write(folder / PAGE, "study.html.j2", _context(study))
    return True


def _phrase(text: str) -> str:
    """First sentence of a setting's text, to stand within another."""
    sentence = text.split(". ")[0].removesuffix(".")
    return sentence[:1].lower() + sentence[1:]


def _context(study: Study) -> dict[str, Any]:
    panels = [panel for panel in PANELS if any(run.value(panel.metric) is not None for run in study.runs)]
    plan, axes, told = Plan.of(study), tuple(dict.fromkeys((*study.axes, SEED))), descriptions()
    return {
        "title": study.folder.name,
        "axes": [_short(axis) for axis in axes],
        "varied": [(axis, _phrase(told.get(axis, ""))) for axis in study.axes],
        "panels": [panel.title for panel in panels],
        "figure": plots.svg(WIDTH_IN, ROW_IN * math.ceil(len(panels) / COLUMNS), lambda f: _draw(f, plan, panels)),
        "surface": _surfaces(plan, panels),
        "rows": [
            {
                "name": run.folder.name,
                "settings": [run.setting(axis) for axis in axes],
                "values": [_text(run, panel.metric) for panel in panels],
                "links": [_place(study, run) + "/" + file for file in LINKS if (run.folder / file).is_file()],
                "command": run.command,
            }
            for run in study.runs
        ],
        "failed": study.failed,
    }  # fmt: skip


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(key: str) -> str:
    return key.rpartition(".")[2].replace("_", " ")


def _place(study: Study, run: Run) -> str:
    return run.folder.relative_to(study.folder).as_posix()


def _text(run: Run, metric: str) -> str:
    value = run.value(metric)
    return "–" if value is None else format_value(Metric(metric, value, ""))


def _draw(figure: Figure, plan: Plan, panels: Sequence[Panel]) -> None:
    rows = math.ceil(len(panels) / COLUMNS)
    for number, panel in enumerate(panels):
        axes = figure.add_subplot(rows, COLUMNS, number + 1)
        for index, line in enumerate(plan.lines):
            _curve(axes, line, panel, _colour(index, len(plan.lines)))
        axes.set(title=panel.title, xlabel=_short(plan.x))
        _scale(axes, plan, panel)
        if number == 0:
            _legend(axes, plan, panels)


def _colour(index: int, count: int) -> Any:
    return plots.COLOURS[index] if count <= len(plots.COLOURS) else mpl.colormaps["viridis"](0.85 * index / (count - 1))


def _curve(axes: Axes, line: Line, panel: Panel, colour: Any) -> None:
    """Mean and standard deviation over the seeds, the runs as points that lead to their row, the bound dashed."""
    values = line.values(panel.metric)
    found = means(line.x, values)
    axes.errorbar(
        found.x, found.mean, found.sigma, color=colour, capsize=3, elinewidth=1.0, label=plots.literal(line.label)
    )
    filled = ["white" if run.value(LOST) else colour for run in line.runs]
    points = axes.scatter(line.x, values, 22, filled, edgecolors=[colour], zorder=3)
    points.set_urls([f"#{run.folder.name}" for run in line.runs])
    bound = means(line.x, line.bounds(panel))
    axes.plot(bound.x, bound.mean, "--", color=colour, lw=1.2)


def _scale(axes: Axes, plan: Plan, panel: Panel) -> None:
    values = np.concatenate([np.r_[line.values(panel.metric), line.bounds(panel)] for line in plan.lines])
    values = values[np.isfinite(values)]
    if values.min() > 0 and values.max() > 5 * values.min():
        axes.set_yscale("log")
    places = np.unique(np.concatenate([line.x for line in plan.lines]))
    axes.set_xticks(places, [plots.literal(name) for name in plan.names or ()] or [f"{place:g}" for place in places])


def _legend(axes: Axes, plan: Plan, panels: Sequence[Panel]) -> None:
    if any(run.value(LOST) for line in plan.lines for run in line.runs):
        axes.plot([], [], "o", color=plots.MUTED, mfc="white", label="with frames lost")
    if any(np.isfinite(line.bounds(panel)).any() for panel in panels for line in plan.lines):
        axes.plot([], [], "--", color=plots.MUTED, lw=1.2, label="Cramér-Rao bound")
    if any(axes.get_legend_handles_labels()[1]):
        axes.legend()


def _surfaces(plan: Plan, panels: Sequence[Panel]) -> Markup | None:
    """Error and bound over two axes of numbers, as surfaces; None where the runs are no such grid."""
    bounded = [panel for panel in panels if panel.bound_ratio is not None]
    if len(plan.others) != 1 or plan.names is not None or len(plan.lines) < 2 or not bounded:
        return None
    second = [line.runs[0].setting(plan.others[0]) for line in plan.lines]
    x = np.unique(np.concatenate([line.x for line in plan.lines]))
    if len(x) < 2 or not all(map(_number, second)):
        return None

    def draw(figure: Figure) -> None:
        for number, panel in enumerate(bounded):
            plot: Any = figure.add_subplot(1, len(bounded), number + 1, projection="3d")
            error = np.array([_on(x, means(line.x, line.values(panel.metric))) for line in plan.lines])
            bound = np.array([_on(x, means(line.x, line.bounds(panel))) for line in plan.lines])
            _surface(plot, x, np.array(second, float), error, bound)
            plot.set(xlabel=_short(plan.x), ylabel=_short(plan.others[0]), title=panel.title, xticks=x, yticks=second)

    return plots.svg(WIDTH_IN, 1.4 * ROW_IN, draw)


def _on(x: Array, found: Means) -> Array:
    """(len(x),) the means at ``x``, NaN where there is none, or nothing to take a logarithm of."""
    known = {place: mean for place, mean in zip(found.x, found.mean, strict=True) if mean > 0}
    return np.array([known.get(place, np.nan) for place in x])


def _surface(plot: Any, x: Array, y: Array, error: Array, bound: Array) -> None:
    across, along = np.meshgrid(x, y)
    if np.isfinite(error).any():
        plot.plot_surface(across, along, np.log10(error), color=plots.COLOURS[0], alpha=0.75, edgecolor="white", lw=0.6)
    if np.isfinite(bound).any():
        plot.plot_wireframe(across, along, np.log10(bound), color=plots.KEY, lw=1.0)
    plot.invert_xaxis()
    low, high = plot.get_zlim()
    ticks: Array = np.arange(np.ceil(2 * low), np.floor(2 * high) + 1) / 2
    plot.set_zticks(ticks, [f"{10**tick:.2g}" for tick in ticks])
