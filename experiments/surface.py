"""How the error of pan and zoom grows with noise and with the zoom, by one command.

    python -m experiments.surface                              # noise 0, 2, 4, 8 grey levels; zoom 1x, 2x, 3x, 4x
    python -m experiments.surface --noise 0 8 --zoom 1 4 seed=3    # all but the options: as of experiments.run
    python -m experiments.surface --folder outputs/surface_paper method=paper

leaves FOLDER/{surface.html, surface.png, surface.csv, surface.json} and a folder a job. A job whose metrics.json is
there, made with the same configuration, is not run again: what was killed goes on where it was.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from omegaconf import OmegaConf
from rich.console import Console

from experiments import plots
from experiments.config import AppConfig, build
from experiments.errors import guard, report
from experiments.metrics import read_metrics
from experiments.run import CONF, run
from pzcap.types import Array

NOISE: Final = (0.0, 2.0, 4.0, 8.0)
ZOOM: Final = (1.0, 2.0, 3.0, 4.0)
SHORT: Final = (
    # Two thirds of a second, swept in steps twice as wide as usual: one or two minutes of one core's time a job.
    "shoot.motion_frames=20",
    "shoot.zoom_frames=14",
    "shoot.operator.sweep_step_deg=4.1",
    # Who films stays on the trunk, and so at the end of the lens's range.
    "shoot.operator.whole_body=false",
    "shoot.operator.body_height=3.0",
    "reconstruct.panzoom.zoom_range=[0.5,5.0]",
    "output.recording=false",
    "output.report=false",
)
"""What all jobs have in common; overrides of the command come after, and win."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One job. Values are RMS over all cameras and frames; None where the job failed or the number is not known."""

    noise: float  # grey levels
    zoom: float  # the lens's longest focal length, in reference focal lengths
    pan_deg: float | None
    pan_bound_deg: float | None  # Cramer-Rao
    focal_percent: float | None
    focal_bound_percent: float | None
    lost: float | None  # frames


@dataclass(frozen=True, slots=True)
class _Job:
    noise: float
    zoom: float
    folder: Path
    config: AppConfig
    tree: dict[str, Any]

    @property
    def name(self) -> str:
        return f"noise {self.noise:g}, zoom {self.zoom:g}x"


def jobs(noise: Sequence[float], zoom: Sequence[float], folder: Path, overrides: Sequence[str]) -> list[_Job]:
    """The jobs of a grid. PzcapError and Hydra's own errors for overrides that do not fit."""
    found = []
    for longest in zoom:
        for level in noise:
            here = (f"shoot.sensor.read_noise={level}", f"shoot.optics.zoom_max={longest}")
            GlobalHydra.instance().clear()
            with initialize_config_dir(str(CONF), version_base="1.3"):
                composed = compose("config", overrides=[*SHORT, *overrides, *here])
            tree: dict[str, Any] = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)  # type: ignore[assignment]
            found.append(_Job(level, longest, folder / f"noise{level:g}_zoom{longest:g}", build(tree), tree))
    return found


def done(job: _Job) -> bool:
    """Whether the job has been run to its end with this very configuration."""
    path = job.folder / "metrics.json"
    if not path.is_file():
        return False
    return bool(read_metrics(path)[1]["config"] == json.loads(json.dumps(job.tree)))


def cell(job: _Job) -> Cell:
    """What the job's metrics.json says."""
    path = job.folder / "metrics.json"
    values = {metric.key: metric.value for metric in read_metrics(path)[0]} if path.is_file() else {}

    def bound(what: str) -> float | None:
        error, ratio = values.get(f"panzoom.{what}.rms"), values.get(f"panzoom.bound_ratio.{what}")
        return error / ratio if error is not None and ratio else None

    return Cell(
        noise=job.noise,
        zoom=job.zoom,
        pan_deg=values.get("panzoom.pan.rms"),
        pan_bound_deg=bound("pan"),
        focal_percent=values.get("panzoom.focal.rms"),
        focal_bound_percent=bound("focal"),
        lost=values.get("panzoom.lost"),
    )


def surface(
    noise: Sequence[float],
    zoom: Sequence[float],
    folder: Path,
    overrides: Sequence[str],
    console: Console,
    work: Callable[[AppConfig, dict[str, Any], Path, Console], object] = run,
) -> bool:
    """Run the jobs that are not done, and show all; whether none failed. A job that fails leaves a hole."""
    grid = jobs(noise, zoom, folder, overrides)
    failed = 0
    for number, job in enumerate(grid):
        if done(job):
            continue
        console.print(f"{job.name} ({number + 1} of {len(grid)})", highlight=False)
        try:
            work(job.config, job.tree, job.folder, console)
        except Exception as error:
            if not report(error):
                raise
            failed += 1
    show([cell(job) for job in grid], folder, overrides)
    return failed == 0


def show(cells: Sequence[Cell], folder: Path, overrides: Sequence[str]) -> None:
    """Write the table and the pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [asdict(one) for one in cells]
    (folder / "surface.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    with (folder / "surface.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Cell)])
        writer.writeheader()
        writer.writerows(rows)

    def draw(figure: Figure) -> None:
        _draw(figure, cells)

    size = 11.5, 8.2
    with mpl.rc_context(plots.STYLE):
        figure = Figure(figsize=size)
        draw(figure)
        figure.savefig(folder / "surface.png", dpi=130, metadata={"Software": None})
    environment = Environment(
        loader=PackageLoader("experiments"), autoescape=select_autoescape(), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    page = environment.get_template("surface.html.j2").render(
        plot=plots.svg(*size, draw),
        rows=[{key: _text(value) for key, value in row.items()} for row in rows],
        bounded=any(one.pan_bound_deg is not None or one.focal_bound_percent is not None for one in cells),
        missing=sum(one.pan_deg is None for one in cells),
        overrides=" ".join([*SHORT, *overrides]),
    )
    (folder / "surface.html").write_text(page, encoding="utf-8")


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _draw(figure: Figure, cells: Sequence[Cell]) -> None:
    """A row a quantity: the error over noise and zoom with the bound beneath it, and the same as curves."""
    noise = sorted({one.noise for one in cells})
    zoom = sorted({one.zoom for one in cells})
    rows = (
        ("pan_deg", "pan_bound_deg", "pan error, RMS [deg]"),
        ("focal_percent", "focal_bound_percent", "focal length error, RMS [%]"),
    )
    for row, (key, bound_key, label) in enumerate(rows):
        error, bound, lost = (_grid(cells, noise, zoom, name) for name in (key, bound_key, "lost"))
        if min(len(noise), len(zoom)) > 1:
            _surfaces(figure.add_subplot(2, 2, 2 * row + 1, projection="3d"), noise, zoom, error, bound, label)
        _curves(figure.add_subplot(2, 2, 2 * row + 2), noise, zoom, error, bound, lost, label)


def _grid(cells: Sequence[Cell], noise: list[float], zoom: list[float], name: str) -> Array:
    """(zoom, noise), NaN where nothing is known: matplotlib leaves that out."""
    values = np.full((len(zoom), len(noise)), np.nan)
    for one in cells:
        value = getattr(one, name)
        if value is not None and value > 0:
            values[zoom.index(one.zoom), noise.index(one.noise)] = value
    return values


def _surfaces(plot: Any, noise: list[float], zoom: list[float], error: Array, bound: Array, label: str) -> None:
    x, y = np.meshgrid(noise, zoom)
    if np.isfinite(error).any():
        plot.plot_surface(x, y, np.log10(error), color=plots.COLOURS[0], alpha=0.75, edgecolor="white", lw=0.6)
    if np.isfinite(bound).any():
        plot.plot_wireframe(x, y, np.log10(bound), color=plots.KEY, lw=1.0)
    plot.set(xlabel="read noise [grey levels]", ylabel="zoom", title=label, xticks=noise, yticks=zoom)
    plot.invert_xaxis()
    low, high = plot.get_zlim()
    ticks: Array = np.arange(np.ceil(2 * low), np.floor(2 * high) + 1) / 2
    plot.set_zticks(ticks, [f"{10**tick:.2g}" for tick in ticks])


def _curves(
    plot: Axes, noise: list[float], zoom: list[float], error: Array, bound: Array, lost: Array, label: str
) -> None:
    for number, longest in enumerate(zoom):
        colour = mpl.colormaps["viridis"](0.85 * number / max(len(zoom) - 1, 1))
        plot.plot(noise, error[number], "o-", color=colour, ms=4, label=f"{longest:g}x")
        holes = np.where(lost[number] > 0, error[number], np.nan)
        plot.plot(noise, holes, "o", color=colour, ms=8, mfc="none", mew=1.2)
        plot.plot(noise, bound[number], "--", color=colour, lw=1.2)
    if (lost > 0).any():
        plot.plot([], [], "o", color=plots.MUTED, ms=8, mfc="none", mew=1.2, label="with frames lost")
    if np.isfinite(bound).any():
        plot.plot([], [], "--", color=plots.MUTED, lw=1.2, label="Cramér-Rao bound")
    plot.set(xlabel="read noise [grey levels]", ylabel=label, yscale="log", xticks=noise)
    if np.isfinite(error).any():
        plot.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)


def _options(arguments: Sequence[str]) -> Mapping[str, Any]:
    parser = argparse.ArgumentParser("python -m experiments.surface", description=__doc__.partition("\n")[0])
    parser.add_argument("--noise", type=float, nargs="+", default=NOISE, help="read noise, grey levels")
    parser.add_argument("--zoom", type=float, nargs="+", default=ZOOM, help="the lens's longest focal length")
    parser.add_argument("--folder", type=Path, default=Path("outputs/surface"), help="where all of it goes")
    options, overrides = parser.parse_known_args(arguments)
    return {**vars(options), "overrides": overrides}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit status 0, or 1 with a line on stderr for each job that failed."""
    options = _options(sys.argv[1:] if arguments is None else arguments)
    complete = True

    def command() -> None:
        nonlocal complete
        complete = surface(**options, console=Console(stderr=True))
        for name in ("surface.html", "surface.png", "surface.csv", "surface.json"):
            print(options["folder"] / name)

    return guard(command) or int(not complete)


if __name__ == "__main__":
    sys.exit(main())
