"""The page of a study: errors over what was varied, a point a run, and below how each run is got again."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments import pages
from experiments.metrics import format_value
from experiments.report import style
from experiments.settings_reference import descriptions
from experiments.studies.study import SEED, Study, collect
from pzcap.scoring.metric import Metric
from pzcap.types import Array

PAGE: Final = "index.html"
LINKS: Final = ("report.html", "recording.rrd", "metrics.json")
LOST: Final = "panzoom.lost"
COLUMNS: Final = 3
WIDTH_IN: Final = 11.8
ROW_IN: Final = 3.3
ROWS: Final = 1000
"""Runs that have a row and points of their own on the page; the others are in the table, and in the means."""
RING: Final = 90
"""Size of the ring around a run that speaks, square points."""
TICKS: Final = 24
"""Most values on an axis, or lines in a legend, that are named one by one."""


class Panel(NamedTuple):
    """One quantity over what was varied."""

    metric: str
    title: str
    bound_ratio: str | None = None  # the metric that says how many times its Cramer-Rao bound it is
    beyond: float | None = None  # from here on an error passes three of the claimed sigmas


PANELS: Final = (
    Panel("panzoom.pan.rms", "Pan, RMS [deg]", "panzoom.bound_ratio.pan"),
    Panel("panzoom.focal.rms", "Focal length, RMS [%]", "panzoom.bound_ratio.focal"),
    Panel("panzoom.reprojection.rms", "Scene points, RMS [px]"),
    Panel("panzoom.nees", "NEES (1: honest; 9: three sigmas)", beyond=9.0),
    Panel("foreground.iou", "Silhouettes, IoU"),
    Panel("body.mpjpe.mean", "Joints, mean [mm]"),
    Panel("body.lost", "Frames with a lost joint"),
    Panel("body.covered", "Joints within one sigma [%] (68: honest)"),
    Panel("body.beyond3", "Joints beyond three sigmas [%]"),
)


class Statistics:
    """Number, mean and squared deviations of P quantities over runs that are added one by one (Welford)."""

    def __init__(self, quantities: int) -> None:
        self._count, self._mean, self._squares = np.zeros((3, quantities))

    def add(self, values: Array) -> None:
        """(P,), NaN where the run has none."""
        known = np.isfinite(values)
        self._count += known
        away = np.where(known, values - self._mean, 0.0)
        self._mean += away / np.maximum(self._count, 1)
        self._squares += away * np.where(known, values - self._mean, 0.0)

    @property
    def mean(self) -> Array:
        """(P,), NaN where no run has a value."""
        return np.where(self._count > 0, self._mean, np.nan)

    @property
    def sigma(self) -> Array:
        """(P,) standard deviation, 0 of one alone."""
        return np.sqrt(self._squares / np.maximum(self._count - 1, 1))


class Point(NamedTuple):
    """A run as it is drawn."""

    name: str
    x: float
    values: Array  # (P,) of the panels
    lost: bool
    spoke: bool  # the reconstruction said something of its footage by itself


@dataclass(slots=True, eq=False)
class Line:
    """Runs that are equal in everything but what stands on the x axis, and the seed."""

    settings: tuple[Any, ...]  # of the other axes
    label: str
    found: dict[float, Statistics]  # place on the x axis -> panels, and their bounds behind them
    points: list[Point]  # the runs that have a row on the page

    @property
    def x(self) -> Array:
        """(M,) places on the x axis."""
        return np.array(sorted(self.found))

    def means(self) -> tuple[Array, Array]:
        """(M, 2 P) means over the seeds, and standard deviations; of the panels, and of their bounds behind them."""
        found = [self.found[place] for place in self.x.tolist()]
        return np.array([one.mean for one in found]), np.array([one.sigma for one in found])


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Places of variables in the plots of a study."""

    x: str
    others: tuple[str, ...]
    names: tuple[str, ...] | None  # of the places on the x axis, where they are no numbers
    panels: tuple[Panel, ...]
    lines: tuple[Line, ...]
    rows: tuple[dict[str, Any], ...]  # of the table, of the runs that have a row on the page

    @classmethod
    def of(cls, study: Study) -> Plan:
        """The first axis of numbers lies along x; the runs that differ in any other are another line.

        The table is read once, and of most of its runs no more kept than what they add to the means.
        """
        axes, panels = tuple(dict.fromkeys((*study.axes, SEED))), tuple(p for p in PANELS if p.metric in study.metrics)
        columns = {axis: study.column(axis) for axis in axes}
        numeric = [axis for axis in study.axes if study.is_number(axis)]
        x = (numeric or study.axes)[0]
        others = tuple(axis for axis in study.axes if axis != x)
        ratios = [panel.bound_ratio for panel in panels if panel.bound_ratio is not None]
        metrics = [f"metric.{name}" for name in (*(panel.metric for panel in panels), *ratios, LOST)]
        names: dict[str, int] = {}
        lines: dict[tuple[str, ...], Line] = {}
        rows: list[dict[str, Any]] = []
        for row in study.rows(["path", "command", "notes", *columns.values(), *metrics]):
            settings = tuple(row[columns[axis]] for axis in others)
            key = tuple(map(_plain, settings))
            label = ", ".join(f"{_short(axis)} {value}" for axis, value in zip(others, key, strict=True))
            line = lines.setdefault(key, Line(settings, label, {}, []))
            value = row[columns[x]]
            place = float(value) if numeric else float(names.setdefault(_plain(value), len(names)))
            values = np.array([_or_nan(row[f"metric.{panel.metric}"]) for panel in panels])
            ratio = np.array([_or_nan(row.get(f"metric.{panel.bound_ratio}")) for panel in panels])
            bounds = values / np.where(ratio > 0, ratio, np.nan)
            line.found.setdefault(place, Statistics(2 * len(panels))).add(np.r_[values, bounds])
            if len(rows) < ROWS:
                rows.append({**row, "settings": [_plain(row[columns[axis]]) for axis in axes]})
                lost = bool(row[f"metric.{LOST}"])
                line.points.append(Point(Path(row["path"]).name, place, values, lost, bool(row["notes"])))
        return cls(x, others, None if numeric else tuple(names), panels, tuple(lines.values()), tuple(rows))


def write_study(folder: Path, places: Iterable[Path]) -> bool:
    """Table and page of the jobs in ``places``; False, and nothing is written, where none of them left metrics."""
    study = collect(folder, places)
    if study is None:
        return False
    pages.write(folder / PAGE, "study.html.j2", _context(study))
    return True


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _plain(value: Any) -> str:
    """A setting as people write it."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _phrase(text: str) -> str:
    """First sentence of a setting's text, to stand within another."""
    sentence = text.split(". ")[0].removesuffix(".")
    return sentence[:1].lower() + sentence[1:]


def _context(study: Study) -> dict[str, Any]:
    plan, axes, told = Plan.of(study), tuple(dict.fromkeys((*study.axes, SEED))), descriptions()
    height_in = ROW_IN * math.ceil(len(plan.panels) / COLUMNS)
    return {
        "title": study.folder.name,
        "axes": [_short(axis) for axis in axes],
        "varied": [(axis, _phrase(told.get(axis, ""))) for axis in study.axes],
        "panels": [panel.title for panel in plan.panels],
        "figure": style.svg(WIDTH_IN, height_in, lambda figure: _draw(figure, plan)),
        "surface": _surfaces(plan),
        "count": study.count,
        "rows": [
            {
                "name": Path(row["path"]).name,
                "settings": row["settings"],
                "values": [_text(panel.metric, row[f"metric.{panel.metric}"]) for panel in plan.panels],
                "links": [f"{row['path']}/{file}" for file in LINKS if (study.folder / row["path"] / file).is_file()],
                "command": row["command"],
                "notes": (row["notes"] or "").splitlines(),
            }
            for row in plan.rows
        ],
        "failures": study.failures,
        "failed": study.failed,
    }  # fmt: skip


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(key: str) -> str:
    return key.rpartition(".")[2].replace("_", " ")


def _text(metric: str, value: float | None) -> str:
    return "–" if value is None else format_value(Metric(metric, value, ""))


def _draw(figure: Figure, plan: Plan) -> None:
    rows = math.ceil(len(plan.panels) / COLUMNS)
    for number, panel in enumerate(plan.panels):
        axes = figure.add_subplot(rows, COLUMNS, number + 1)
        for index, line in enumerate(plan.lines):
            _curve(axes, line, number, _colour(index, len(plan.lines)))
        axes.set(title=panel.title, xlabel=_short(plan.x))
        _scale(axes, plan, number)
        if panel.beyond is not None:
            axes.axhline(panel.beyond, color=style.MUTED, ls=":", lw=1.2)
        if number == 0:
            _legend(axes, plan)


def _colour(index: int, count: int) -> Any:
    return style.COLOURS[index] if count <= len(style.COLOURS) else mpl.colormaps["viridis"](0.85 * index / (count - 1))


def _curve(axes: Axes, line: Line, panel: int, colour: Any) -> None:
    """Mean and standard deviation over the seeds, the runs as points that lead to their row, in a ring where the run
    said what is wrong; the bound dashed."""
    mean, sigma = line.means()
    axes.errorbar(
        line.x, mean[:, panel], sigma[:, panel], color=colour, capsize=3, elinewidth=1.0,
        label=style.literal(line.label),
    )  # fmt: skip
    filled = ["white" if point.lost else colour for point in line.points]
    places, values = ([point.x for point in line.points], [point.values[panel] for point in line.points])
    points = axes.scatter(places, values, 22, filled, edgecolors=[colour], zorder=3)
    points.set_urls([f"#{point.name}" for point in line.points])
    spoke = [point for point in line.points if point.spoke]
    _rings(axes, [point.x for point in spoke], [point.values[panel] for point in spoke])
    axes.plot(line.x, mean[:, mean.shape[1] // 2 + panel], "--", color=colour, lw=1.2)


def _rings(axes: Axes, x: Sequence[float], y: Sequence[float], label: str | None = None) -> None:
    axes.scatter(x, y, RING, facecolors="none", edgecolors=[style.KEY], zorder=2, label=label)


def _scale(axes: Axes, plan: Plan, panel: int) -> None:
    count = len(plan.panels)
    drawn = [line.means()[0][:, [panel, count + panel]].ravel() for line in plan.lines]
    drawn += [np.array([point.values[panel] for point in line.points]) for line in plan.lines]
    values = np.concatenate(drawn)
    values = values[np.isfinite(values)]
    if values.min() > 0 and values.max() > 5 * values.min():
        axes.set_yscale("log")
    elif values.min() == 0:  # a count, or a share
        axes.set_ylim(bottom=0.0, top=None if values.max() > 0 else 1.0)
    places = np.unique(np.concatenate([line.x for line in plan.lines]))
    if len(places) <= TICKS:
        axes.set_xticks(places, [style.literal(name) for name in plan.names or ()] or [f"{p:g}" for p in places])


def _legend(axes: Axes, plan: Plan) -> None:
    if any(point.lost for line in plan.lines for point in line.points):
        axes.plot([], [], "o", color=style.MUTED, mfc="white", label="with frames lost")
    if any(point.spoke for line in plan.lines for point in line.points):
        _rings(axes, [], [], "the run says what is wrong")
    if any(np.isfinite(line.means()[0][:, len(plan.panels) :]).any() for line in plan.lines):
        axes.plot([], [], "--", color=style.MUTED, lw=1.2, label="Cramér-Rao bound")
    if 0 < len(axes.get_legend_handles_labels()[1]) <= TICKS and any(axes.get_legend_handles_labels()[1]):
        axes.legend()


def _surfaces(plan: Plan) -> Markup | None:
    """Error and bound over two axes of numbers, as surfaces; None where the runs are no such grid."""
    bounded = [number for number, panel in enumerate(plan.panels) if panel.bound_ratio is not None]
    if len(plan.others) != 1 or plan.names is not None or len(plan.lines) < 2 or not bounded:
        return None
    second = [line.settings[0] for line in plan.lines]
    x = np.unique(np.concatenate([line.x for line in plan.lines]))
    if len(x) < 2 or not all(map(_number, second)):
        return None

    def draw(figure: Figure) -> None:
        for place, number in enumerate(bounded):
            plot: Any = figure.add_subplot(1, len(bounded), place + 1, projection="3d")
            error = np.array([_on(x, line, number) for line in plan.lines])
            bound = np.array([_on(x, line, len(plan.panels) + number) for line in plan.lines])
            _surface(plot, x, np.array(second, float), error, bound)
            title = plan.panels[number].title
            plot.set(xlabel=_short(plan.x), ylabel=_short(plan.others[0]), title=title, xticks=x, yticks=second)

    return style.svg(WIDTH_IN, 1.4 * ROW_IN, draw)


def _on(x: Array, line: Line, quantity: int) -> Array:
    """(len(x),) the means at ``x``, NaN where there is none, or nothing to take a logarithm of."""
    means = zip(line.x.tolist(), line.means()[0][:, quantity].tolist(), strict=True)
    known = {place: mean for place, mean in means if mean > 0}
    return np.array([known.get(place, np.nan) for place in x])


def _surface(plot: Any, x: Array, y: Array, error: Array, bound: Array) -> None:
    across, along = np.meshgrid(x, y)
    if np.isfinite(error).any():
        plot.plot_surface(across, along, np.log10(error), color=style.COLOURS[0], alpha=0.75, edgecolor="white", lw=0.6)
    if np.isfinite(bound).any():
        plot.plot_wireframe(across, along, np.log10(bound), color=style.KEY, lw=1.0)
    plot.invert_xaxis()
    low, high = plot.get_zlim()
    ticks: Array = np.arange(np.ceil(2 * low), np.floor(2 * high) + 1) / 2
    plot.set_zticks(ticks, [f"{10**tick:.2g}" for tick in ticks])
