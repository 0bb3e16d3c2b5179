"""The board: a static page of all entries, tables by track, errors by capture and axis, worst frames, recordings.

    python -m experiments.benchmark board split=mini

leaves outputs/benchmark/RELEASE/SPLIT/board: index.html, breaks.html (what breaks which method), and beside them the
entries, their pictures and recordings. It needs nothing but these files; put it on any server as it is.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments import pages
from experiments.benchmark.entries import read_entries
from experiments.benchmark.make import described
from experiments.benchmark.tracks import TRACKS, Track
from experiments.metrics import format_value
from experiments.report import style
from pzcap.scoring.metric import Metric

PAGE: Final = "index.html"
BREAKS: Final = "breaks.html"
COLOURS: Final = (*style.COLOURS, "#7c4dff", "#6d4c41", "#00838f", "#c62828", "#9e9d24", "#455a64")
DASHES: Final = ("-", "--", ":")
MARKERS: Final = ("o", "s", "^", "D", "v", "P")
HEADS: Final = {
    "panzoom.completeness": "views answered", "body.completeness": "joints answered", "body.lost": "frames lost",
    "panzoom.jac5": "JaC@5", "panzoom.nees": "NEES", "panzoom.bound_ratio.pan": "pan over its bound",
    "panzoom.rotation.common.median": "rotation* median", "panzoom.rotation.common.rms": "rotation* rms",
    "body.mpjpe.similarity": "joints* mean", "body.covered": "within one sigma",
}  # fmt: skip
"""A star stands for: after the one rotation a camera, or the similarity of the motion, that suits it best."""
FAILS: Final = {"deg": 1.0, "mm": 100.0}
"""A method fails where it answers less than half, or where its main error is larger than this."""
HALF: Final = 50.0  # percent
CLAIMS: Final = {
    "reproduced": "run by whoever runs this board",
    "code public": "its code is there for anybody to run",
    "claimed": "files of results were handed in",
}


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """Captures that are equal in everything but one axis, in the order of its values."""

    name: str
    unit: str  # of its values; empty where they are names
    values: tuple[str, ...]
    captures: tuple[str, ...]


def write(folder: Path, entries: Path) -> Path:
    """Write the board of the split in ``folder`` from ``entries``; its page. PzcapError where there are none."""
    split, found = described(folder), read_entries(entries)
    place = folder / "board"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    for entry in found:
        shutil.copyfile(entries / f"{entry['key']}.json", place / f"{entry['key']}.json")
        if (entries / entry["key"]).is_dir():
            shutil.copytree(entries / entry["key"], place / entry["key"])
    tables = [_table(name, track, found, place) for name, track in TRACKS.items()]
    axes = axes_of(split)
    context = {
        "release": split["release"], "split": split["split"], "captures": split["captures"], "tables": tables,
        "claims": CLAIMS, "breaks": BREAKS, "axes": axes, "entries": len(found),
    }  # fmt: skip
    pages.write(place / PAGE, "board.html.j2", context)
    panels = [_panels(track, found, axis) for track in TRACKS for axis in axes if _entered(found, track)]
    failures = [_failures(track, found, axes) for track in TRACKS if _entered(found, track)] if axes else []
    broken = {"panels": panels, "page": PAGE, "failures": failures, "limits": FAILS}
    pages.write(place / BREAKS, "breaks.html.j2", context | broken)
    return place / PAGE


def axes_of(split: Mapping[str, Any]) -> list[Axis]:
    """Every axis along which some captures of a split differ in nothing else, seeds aside if need be."""
    captures: Mapping[str, Mapping[str, Any]] = split["captures"]
    found = []
    for name, order in split["axes"].items():
        for ignored in ((name,), (name, "seed")):
            groups: dict[tuple[Any, ...], list[str]] = {}
            for capture, values in captures.items():
                others = tuple(sorted((k, str(v)) for k, v in values.items() if k not in ignored))
                groups.setdefault(others, []).append(capture)
            best = max(groups.values(), key=lambda some: len({str(captures[c][name]) for c in some}))
            if len({str(captures[c][name]) for c in best}) > 1:
                ordered = sorted(best, key=lambda capture: order.index(str(captures[capture][name])))
                along = tuple(str(captures[c][name]) for c in ordered)
                found.append(Axis(name, split.get("units", {}).get(name, ""), along, tuple(ordered)))
                break
    return found


def _failures(name: str, entries: Sequence[Mapping[str, Any]], axes: Sequence[Axis]) -> dict[str, Any]:
    """A row a method of a track: the values of each axis at which it fails."""
    complete, main = TRACKS[name].columns[:2]

    def fails(entry: Mapping[str, Any], capture: str) -> bool:
        found = entry["scores"][name].get(capture, {})
        error, limit = found.get(main), FAILS[entry["units"].get(main, ["mm"])[0]]
        return error is None or error > limit or (found.get(complete) or 0.0) < HALF

    rows = []
    for entry in _entered(entries, name):
        cells = [
            [value for value, capture in zip(axis.values, axis.captures, strict=True) if fails(entry, capture)]
            for axis in axes
        ]
        rows.append({"label": entry["label"], "cells": [", ".join(cell) or "–" for cell in cells]})
    return {"track": TRACKS[name].label, "rows": rows}


def _entered(entries: Sequence[Mapping[str, Any]], track: str) -> list[Mapping[str, Any]]:
    """The entries of a track, best first by its second column; behind them those that answer less than half."""
    key = TRACKS[track].columns[1]

    def rank(entry: Mapping[str, Any]) -> tuple[bool, bool, float]:
        value = entry["means"][track].get(key)
        return value is None, not _answers(entry, track), float("inf") if value is None else float(value)

    return sorted((entry for entry in entries if track in entry["tracks"]), key=rank)


def _answers(entry: Mapping[str, Any], track: str) -> bool:
    """True where a method answers half of what a track asks, or more."""
    return float(entry["means"][track].get(TRACKS[track].columns[0]) or 0.0) >= HALF


def _table(name: str, track: Track, entries: Sequence[Mapping[str, Any]], place: Path) -> dict[str, Any]:
    entered = _entered(entries, name)
    best = {column: _best(entered, name, column) for column in track.columns}
    rows = []
    for entry in entered:
        means = entry["means"][name]
        cells = [
            {"text": _text(entry, column, means.get(column)), "best": means.get(column) is not None
             and means[column] == best[column] and _answers(entry, name)}
            for column in track.columns
        ]  # fmt: skip
        pictures = [one for one in entry["worst"].get(name, []) if (place / one.get("picture", "?")).is_file()]
        recording = entry.get("recording", "")
        rows.append({
            "entry": entry, "cells": cells, "pictures": pictures, "hash": entry["predictions_sha256"][:12],
            "recording": recording if recording and (place / recording).is_file() else "",
            "seconds": "–" if entry.get("seconds") is None else f"{entry['seconds']:.0f}",
            "memory": "–" if entry.get("memory_mib") is None else f"{entry['memory_mib']:.0f}",
        })  # fmt: skip
    columns = [{"key": column, "head": head(column), "unit": _unit(entered, column)} for column in track.columns]
    chart = by_capture(entered, name, track) if len(entered) > 1 else Markup("")
    return {"name": name, "track": track, "columns": columns, "rows": rows, "chart": chart}


def head(metric: str) -> str:
    """Heading of a metric's column."""
    if metric in HEADS:
        return HEADS[metric]
    words = metric.replace("panzoom.", "").replace("body.mpjpe.", "joints ").replace("body.", "")
    return words.replace(".", " ").replace("_", " ")


def _unit(entered: Sequence[Mapping[str, Any]], column: str) -> str:
    unit = next((entry["units"][column][0] for entry in entered if column in entry["units"]), "")
    return "" if unit == "1" else unit


def _text(entry: Mapping[str, Any], column: str, value: float | None) -> str:
    unit, direction = entry["units"].get(column, ("", "lower"))
    return format_value(Metric(column, value, unit, direction))


def _best(entered: Sequence[Mapping[str, Any]], track: str, column: str) -> float | None:
    values = [entry["means"][track].get(column) for entry in entered if _answers(entry, track)]
    known = [float(value) for value in values if value is not None]
    if len(known) < 2 or column in ("panzoom.nees", "body.covered"):  # of these it is not the least that is best
        return None
    higher = any(entry["units"].get(column, ("", ""))[1] == "higher" for entry in entered)
    return max(known) if higher else min(known)


# --------------------------------------------------------------------------------------------------------------
# Plots


def _style(number: int) -> dict[str, Any]:
    """A colour, and where colours come again another dash and another sign: points have no line to tell them by."""
    again = number // len(COLOURS)
    return {"color": COLOURS[number % len(COLOURS)], "ls": DASHES[again % len(DASHES)],
            "marker": MARKERS[again % len(MARKERS)], "ms": 4.0}  # fmt: skip


def by_capture(entered: Sequence[Mapping[str, Any]], name: str, track: Track) -> Markup:
    """The track's main error of every entry, capture by capture."""
    names = list(dict.fromkeys(capture for entry in entered for capture in entry["scores"][name]))
    metric = track.columns[1]

    def draw(figure: Figure) -> None:
        axes: Axes = figure.subplots()
        for number, entry in enumerate(entered):
            values = [entry["scores"][name].get(capture, {}).get(metric) for capture in names]
            aside = 0.5 * ((number + 0.5) / len(entered) - 0.5)  # so that none hides another
            _line(axes, np.arange(len(names)) + aside, values, entry["label"], number, joined=False)
        _finish(axes, names, f"{head(metric)} [{_unit(entered, metric) or '1'}]")
        figure.legend(loc="outside right upper", handlelength=2.4)

    return style.svg(11.0, 2.6 + 0.16 * max(0, len(entered) - 8), draw)


def _panels(name: str, entries: Sequence[Mapping[str, Any]], axis: Axis) -> dict[str, Any]:
    """Error, loss and honesty along one axis, for all methods of a track."""
    track, entered = TRACKS[name], _entered(entries, name)
    bodily = track.columns[0].startswith("body")
    shown = ((track.columns[1], False), (track.columns[0], True), ("body.covered" if bodily else "panzoom.nees", False))
    titles = ("error", "not answered", "honesty: within sigma (68)" if bodily else "honesty: NEES (1)")

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, len(shown))
        for axes, (metric, lost), title in zip(panels, shown, titles, strict=True):
            for number, entry in enumerate(entered):
                values = [entry["scores"][name].get(capture, {}).get(metric) for capture in axis.captures]
                values = [None if v is None else 100.0 - v for v in values] if lost else values
                _line(axes, np.arange(len(values)), values, entry["label"] if axes is panels[0] else None, number)
            unit = "%" if lost else _unit(entered, metric)
            if unit in FAILS:
                axes.axhline(FAILS[unit], color=style.MUTED, ls=":", lw=1.2)
            _finish(axes, list(axis.values), f"{title} [{unit}]" if unit else title, logarithmic=unit != "%")
        figure.legend(loc="outside right upper", handlelength=2.4)

    return {"axis": axis, "track": track.label, "captures": axis.captures, "svg": style.svg(12.5, 2.8, draw)}


def _line(
    axes: Axes, x: np.ndarray, values: Sequence[float | None], label: str | None, number: int, *, joined: bool = True
) -> None:
    y = np.array([np.nan if value is None or value <= 0.0 else value for value in values], np.float64)
    y = np.where([value == 0.0 for value in values], 0.0, y)
    axes.plot(x, y, label=None if label is None else style.literal(label), **_style(number), lw=1.4 if joined else 0.0)


def _finish(axes: Axes, names: Sequence[str], title: str, *, logarithmic: bool = True) -> None:
    axes.set_title(style.literal(title))
    axes.set_xticks(np.arange(len(names)), [style.literal(name) for name in names])
    axes.set_xlim(-0.4, len(names) - 0.6)
    if any(len(name) > 12 for name in names) and len(names) > 4:
        for label in axes.get_xticklabels():
            label.set(rotation=30, ha="right", rotation_mode="anchor")
    shown = (
        np.concatenate([np.asarray(line.get_ydata(), np.float64) for line in axes.lines]) if axes.lines else np.zeros(0)
    )
    if not np.any(np.isfinite(shown)):
        axes.set_yticks([])
        axes.text(0.5, 0.5, "nobody says", transform=axes.transAxes, ha="center", color=style.MUTED)
    elif not logarithmic:
        axes.set_ylim(-4.0, 104.0)
    elif np.any(shown > 0.0):
        axes.set_yscale("log")
