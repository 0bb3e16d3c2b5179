"""Worth of panning and zooming: the same motion filmed in three ways (section 6.2 of the paper).

    python -m experiments.compare operators seed=0 hydra.run.dir=DIR     # conf/experiment/operators.yaml: the
    pedestrian python -m experiments.compare operators experiment=floor_exercise seed=0

pan_zoom  operators who pan and zoom, as always.
pan       operators who pan, with the longest focal length that keeps the body in view all the time.
none      locked cameras: pan and focal length are such that all of the body's way is in view.

Each is shot, reconstructed and scored as by `experiments.run`, with the same sweep, object, keyframes and tape; what
that leaves, but for the report, is in DIR/{pan_zoom, pan, none}.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from experiments import footage
from experiments.comparisons.harness import Column, Comparison, Row
from experiments.config import CONVERTER, AppConfig
from experiments.report.style import COLOURS
from experiments.run import run as run_one
from experiments.score import body_errors, frames_of
from pzcap.io.results import load
from pzcap.scoring.body_errors import BodyErrors
from pzcap.types import Array, Mask, PzcapError
from sim.truth import Truth

Moves = Literal["pan_zoom", "pan", "none"]
COLUMNS: Final = (
    Column("body.height", "body px", "px", "{:.0f}", "higher"),
    Column("body.cut", "cut off %", "%", "{:.2g}"),
    Column("body.mpjpe.mean", "mean mm", "mm", "{:.2f}"),
    Column("body.mpjpe.p95", "p95 mm", "mm", "{:.1f}"),
    Column("body.lost", "lost", "frames", "{:.0f}"),
    Column("panzoom.pan.rms", "pan deg", "deg"),
    Column("panzoom.focal.rms", "focal %", "%"),
)
NAMES: Final[dict[Moves, str]] = {"pan_zoom": "pan and zoom", "pan": "pan only", "none": "locked"}


@dataclass(frozen=True, slots=True, eq=False)
class Filmed:
    """One way of filming, frame by frame."""

    height_px: Array  # (C, F) of the body in the image; 0 where it is not seen
    body: BodyErrors | None


def compare(config: AppConfig, folder: Path, console: Console) -> Iterator[Row[Filmed]]:
    """All three ways, each into a folder of its own; the cameras are calibrated once. PzcapError for a given
    capture."""
    if config.capture is not None:
        raise PzcapError("a comparison of operators shoots its own footage; leave capture=... out")
    first: Row[Filmed] | None = None
    for moves in NAMES:
        row = film(config, folder / moves, moves, console)
        first = first or row
        yield row
        config = with_cameras(config, folder / first.key)


def film(config: AppConfig, folder: Path, moves: Moves, console: Console) -> Row[Filmed]:
    """Shoot, reconstruct and score one way, into ``folder``."""
    shoot = replace(config.shoot, operator=replace(config.shoot.operator, moves=moves))
    config = replace(config, shoot=shoot, output=replace(config.output, report=False))
    found = {metric.key: metric.value for metric in run_one(config, CONVERTER.unstructure(config), folder, console)}
    truth = footage.truth_beside(folder / "capture")
    assert truth is not None, "what was just shot has its truth beside it"
    reconstruction = load(folder / "reconstruction")
    motion, frames = reconstruction.motion, frames_of(truth, reconstruction)[0]
    height, cut = framing(truth)
    body = None if motion is None else body_errors(motion, truth, frames)
    figures: dict[str, float | None] = {"body.height": float(height.mean()), "body.cut": 100.0 * float(cut.mean())}
    figures |= {column.key: found[column.key] for column in COLUMNS if column.key in found}
    return Row(moves, NAMES[moves], figures, detail=Filmed(height, body))


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


def draw(figure: Figure, rows: Sequence[Row[Filmed]]) -> None:
    """Plot the body's height in the images, and the joint errors, over the frames."""
    size, error = figure.subplots(1, 2)
    for row, colour in zip(rows, COLOURS, strict=False):
        assert row.detail is not None
        height, body = row.detail.height_px, row.detail.body
        frames = np.arange(height.shape[1])
        size.plot(frames, height.mean(axis=0), color=colour, label=row.label)
        size.fill_between(frames, height.min(axis=0), height.max(axis=0), color=colour, alpha=0.15, lw=0)
        if body is not None:
            millimetres = np.where(body.valid, 1000.0 * body.joints_m.mean(axis=1), np.nan)
            error.plot(np.arange(len(millimetres)), millimetres, color=colour)
    size.set_title("height of the body [px], mean and range over the cameras")
    error.set_title("joint error [mm], mean over the joints")
    for axes in (size, error):
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("frame")
    figure.legend(*size.get_legend_handles_labels(), loc="outside lower center", ncols=len(rows))


COMPARISON: Final[Comparison[Filmed]] = Comparison(
    name="operators",
    columns=COLUMNS,
    compare=compare,
    plots={"operators.png": ((10.0, 3.6), draw)},
    experiment="operators",
    variants="operators",
)
