"""What panning and zooming are worth: the same motion filmed in three ways (section 6.2 of the paper).

    python -m experiments.comparisons.operators seed=0 hydra.run.dir=DIR         # conf/experiment/operators.yaml: the
    pedestrian python -m experiments.comparisons.operators experiment=floor_exercise seed=0

pan_zoom  operators who pan and zoom, as always.
pan       operators who pan, with the longest focal length that keeps the body in view all the time.
none      locked cameras: pan and focal length are such that all of the body's way is in view.

Each is shot, reconstructed and scored as by `experiments.run`, with the same sweep, object, keyframes and tape; what
that leaves, but for the report, is in DIR/{pan_zoom, pan, none}. Prints a table and leaves DIR/{metrics.json,
operators.png} beside.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table

from experiments import footage
from experiments.command import command
from experiments.config import CONVERTER, AppConfig
from experiments.metrics import Metric, format_value, run_info, write_metrics
from experiments.report.plots import COLOURS, STYLE
from experiments.run import run as run_one
from experiments.score import BodyErrors, body_errors, frames_of
from pzcap.io.results import load
from pzcap.types import Array, Mask, PzcapError
from sim.truth import Truth

Moves = Literal["pan_zoom", "pan", "none"]
NAMES: Final[dict[Moves, str]] = {"pan_zoom": "pan and zoom", "pan": "pan only", "none": "locked"}
RESULTS: Final = ("metrics.json", "operators.png")
SCORED: Final = {
    "body.mpjpe.mean": "mean mm", "body.mpjpe.p95": "p95 mm", "body.lost": "lost", "panzoom.pan.rms": "pan deg",
    "panzoom.focal.rms": "focal %",
}  # fmt: skip
"""Figures of a run that are compared, and what the table calls them."""
WIDTH: Final = 96  # columns of text that the table takes


@dataclass(frozen=True, slots=True, eq=False)
class Filmed:
    """One way of filming."""

    moves: Moves
    found: dict[str, Metric]  # of the run, by key
    height_px: Array  # (C, F) of the body in the image; 0 where it is not seen
    cut: Mask  # (C, F) the body touches the image's edge or is not seen: it is not whole
    body: BodyErrors | None


def film(config: AppConfig, folder: Path, moves: Moves, console: Console) -> Filmed:
    """Shoot, reconstruct and score one way, into ``folder``."""
    shoot = replace(config.shoot, operator=replace(config.shoot.operator, moves=moves))
    config = replace(config, shoot=shoot, output=replace(config.output, report=False))
    found = run_one(config, CONVERTER.unstructure(config), folder, console)
    truth = footage.truth_beside(folder / "capture")
    assert truth is not None, "what was just shot has its truth beside it"
    reconstruction = load(folder / "reconstruction")
    motion, frames = reconstruction.motion, frames_of(truth, reconstruction)[0]
    height, cut = framing(truth)
    body = None if motion is None else body_errors(motion, truth, frames)
    return Filmed(moves, {metric.key: metric for metric in found}, height, cut, body)


def with_cameras(config: AppConfig, results: Path) -> AppConfig:
    """``config``, with the cameras of a way that has been run: the sweep is the same. An estimator finds its own."""
    return config if config.estimator else replace(config, cameras=str(results))


def framing(truth: Truth) -> tuple[Array, Mask]:
    """Height of the body in pixels (C, F), and whether some of it is beyond the image's edge (C, F)."""
    shape = len(truth.camera_names), len(truth.timecodes)
    height, cut = np.zeros(shape), np.ones(shape, bool)
    for camera, frame in np.ndindex(shape):
        mask = truth.mask(camera, frame)
        rows = np.flatnonzero(mask.any(axis=1))
        if len(rows):
            height[camera, frame] = rows[-1] - rows[0] + 1
            edge = (mask[0], mask[-1], mask[:, 0], mask[:, -1])
            cut[camera, frame] = any(bool(line.any()) for line in edge)
    return height, cut


def metrics_of(ways: Sequence[Filmed]) -> list[Metric]:
    """What is compared, by way: how the body is framed, then figures of the run."""
    metrics = []
    for way in ways:
        key = f"operators.{way.moves}"
        metrics.append(Metric(f"{key}.body.height", float(way.height_px.mean()), "px", "higher"))
        metrics.append(Metric(f"{key}.body.cut", 100.0 * float(way.cut.mean()), "%"))
        metrics += [replace(way.found[name], key=f"{key}.{name}") for name in SCORED]
    return metrics


def print_comparison(console: Console, title: str, metrics: Sequence[Metric]) -> None:
    """A row a way."""
    by_key = {metric.key: metric for metric in metrics}
    table = Table(title=title, title_justify="left", header_style="bold", box=box.SIMPLE, padding=(0, 1))
    table.add_column("operators", no_wrap=True)
    for name in ("body px", "cut off %", *SCORED.values()):
        table.add_column(name, justify="right", no_wrap=True)
    for moves, name in NAMES.items():
        keys = ("body.height", "body.cut", *SCORED)
        table.add_row(name, *(format_value(by_key[f"operators.{moves}.{key}"]) for key in keys))
    console.width = max(console.width, WIDTH)  # a wide table beats one whose figures are cut off
    console.print(table)


def plot(path: Path, ways: Sequence[Filmed]) -> None:
    """How tall the body is in the images, and the joint errors, over the frames."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 3.6), dpi=140)
        size, error = figure.subplots(1, 2)
        for way, colour in zip(ways, COLOURS, strict=False):
            frames = np.arange(way.height_px.shape[1])
            size.plot(frames, way.height_px.mean(axis=0), color=colour, label=NAMES[way.moves])
            size.fill_between(
                frames, way.height_px.min(axis=0), way.height_px.max(axis=0), color=colour, alpha=0.15, lw=0
            )
            if way.body is not None:
                millimetres = np.where(way.body.valid, 1000.0 * way.body.joints_m.mean(axis=1), np.nan)
                error.plot(np.arange(len(millimetres)), millimetres, color=colour)
        size.set_title("height of the body [px], mean and range over the cameras")
        error.set_title("joint error [mm], mean over the joints")
        for axes in (size, error):
            axes.set_ylim(bottom=0.0)
            axes.set_xlabel("frame")
        figure.legend(*size.get_legend_handles_labels(), loc="outside lower center", ncols=len(ways))
        figure.savefig(path, metadata={"Software": None})


def run(config: AppConfig, tree: dict[str, Any], folder: Path, console: Console) -> list[Metric]:
    """All three ways and what is made of them, into ``folder``. PzcapError for what the user can mend."""
    if config.capture is not None:
        raise PzcapError("a comparison of operators shoots its own footage; leave capture=... out")
    folder.mkdir(parents=True, exist_ok=True)
    for name in RESULTS:
        (folder / name).unlink(missing_ok=True)
    ways: list[Filmed] = []
    for moves in NAMES:
        ways.append(film(config, folder / moves, moves, console))
        config = with_cameras(config, folder / ways[0].moves)
    metrics = metrics_of(ways)
    write_metrics(folder / "metrics.json", metrics, run_info(tree, config.seed))
    plot(folder / "operators.png", ways)
    return metrics


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return command("operators", run, print_comparison)


if __name__ == "__main__":
    sys.exit(main())
