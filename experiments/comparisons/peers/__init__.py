"""Other people's ways to pan and focal length beside ours, on the same frames. docs/peers.md.

    python -m experiments.compare peers experiment=floor_exercise seed=0 every=10
    python -m experiments.compare peers capture=FOLDER methods=[ours,sift,hugin] reconstruction=RESULTS/reconstruction
    python -m experiments.compare peers capture=FOLDER_OF_FRAMES

leaves metrics.json, peers.csv, answers.csv (every answer) and errors.png in outputs/peers/EXPERIMENT/SEED, or in the
folder given by hydra.run.dir=FOLDER. Without a truth ``agreement`` with the median of all answers stands in the place
of errors.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from experiments import footage
from experiments.comparisons.harness import Column, Comparison, Row
from experiments.comparisons.peers import bench
from experiments.comparisons.peers.folder import from_folder, is_folder_of_frames
from experiments.comparisons.peers.material import Material, from_capture
from experiments.config import AppConfig
from experiments.progress import Bars
from experiments.report.style import COLOURS, INK, MUTED
from pzcap.io.capture import MANIFEST, read_capture
from pzcap.types import Array, PzcapError

ANSWERS: Final = "answers.csv"
DASHES: Final = ("-", "--", ":")


@dataclass(frozen=True, slots=True)
class PeersConfig(AppConfig):
    """Everything that `python -m experiments.compare peers` can be told: what a run can, and this."""

    every: int = 10
    """Locate every so many-th frame of each camera: enough for a median, in a tenth of the time."""
    methods: tuple[str, ...] = ()
    """Of `bench.METHODS`; none: all."""
    reconstruction: str | None = None
    """A folder that a run left of the same capture; null: calibrate now."""


def compare(config: PeersConfig, folder: Path, console: Console) -> Sequence[Row[bench.Summary]]:
    """Every method on the same frames, a row each. Raises PzcapError for what the user can mend."""
    names = bench.choose(config.methods)
    if config.method != AppConfig().method:
        raise PzcapError(f"method={config.method}: the bench runs all methods; choose with methods=[ours,paper,...]")
    with Bars(console) as bars:
        material = _material(config, "paper" in names, bars)
    with Bars(console) as bars:
        results = bench.run(material, names, config.every, bars.update)
    _write_answers(folder / ANSWERS, material, results)
    summaries, what = bench.summarise(results), "" if bench.scored(results) else "agreement."
    return [
        Row(
            result.name, bench.METHODS[result.name].label, bench.figures(summaries[result.name], what),
            missing=result.missing, detail=summaries[result.name],
        )
        for result in results
    ]  # fmt: skip


def _material(config: PeersConfig, with_paper: bool, bars: Bars) -> Material:
    named = None if config.capture is None else Path(config.capture).resolve()
    panzoom = config.reconstruct.panzoom
    if named is not None and is_folder_of_frames(named):
        return from_folder(named, panzoom, bars.update)
    shot = footage.capture_of(config, bars.update)
    if not (shot / MANIFEST).exists():
        raise PzcapError(
            f"{shot}: holds neither {MANIFEST} (docs/capture.md) nor camera.json (docs/peers.md); give a folder of one"
        )
    finished = None if config.reconstruction is None else Path(config.reconstruction)
    truth = footage.truth_beside(shot)
    return from_capture(read_capture(shot), truth, finished, panzoom, with_paper, bars.update)


def _write_answers(path: Path, material: Material, results: Sequence[bench.Result]) -> None:
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


def draw(figure: Figure, rows: Sequence[Row[bench.Summary]]) -> None:
    """The share of views (of all that there are) below an error, for pan and for the focal length."""
    scored = any("pan.median" in row.figures for row in rows)
    what = "error" if scored else "distance from the median of all methods"
    pan, focal = figure.subplots(1, 2, sharey=True)
    for number, row in enumerate(rows):
        if row.detail is None:
            continue
        style = (COLOURS[number % len(COLOURS)], DASHES[number // len(COLOURS) % len(DASHES)])
        if row.key.startswith("ours"):
            style = (INK, DASHES[number % 2])
        _distribution(pan, np.degrees(np.abs(row.detail.pan_rad)), row.detail.views, row.label, style)
        _distribution(focal, 100.0 * np.abs(row.detail.focal), row.detail.views, row.label, style)
    pan.set_xlabel(f"pan {what} [deg]")
    focal.set_xlabel(f"focal length {what} [%]")
    pan.set_ylabel("share of views below it")
    focal.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), labelcolor=INK, edgecolor=MUTED)


def _distribution(axes: Axes, errors: Array, views: int, label: str, style: tuple[str, str]) -> None:
    colour, dash = style
    axes.set_xscale("log")
    axes.plot(np.sort(errors), np.arange(1, len(errors) + 1) / max(views, 1), color=colour, ls=dash, label=label)


def _columns() -> tuple[Column, ...]:
    """Errors where there is a truth; agreement, of which the table shows the same, where there is none."""
    quantities = (("pan", "deg", "{:.2g}"), ("focal", "%", "{:.2g}"))
    errors = [
        Column(f"{what}{quantity}.{name}", f"{quantity}\n{name} {unit}", unit, form)
        for what in ("", "agreement.")
        for quantity, unit, form in quantities
        for name in bench.STATISTICS
    ]
    rest = Column("failures", "failures", "views", "{:.0f}"), Column("views", "of", "views", "{:.0f}", "higher")
    return (*errors, *rest, Column("time", "CPU ms", "ms/view", "{:.0f}"))


COMPARISON: Final[Comparison[bench.Summary]] = Comparison(
    name="peers",
    columns=_columns(),
    compare=compare,
    plots={"errors.png": ((11.0, 4.4), draw)},
    experiment="floor_exercise",
    variants="method",
    config=PeersConfig,
    config_name="peers",
    others=(ANSWERS,),
)
