"""Ours against self-calibration after Shum and Szeliski, Sinha and Pollefeys, and Wu and Radke, on the same captures.

    python -m experiments.compare self_calibration seed=0 hydra.run.dir=DIR      # conf/experiment/self_calibration.yaml
    python -m experiments.compare self_calibration capture=FOLDER                # with truth/ beside it

Three sets of frames of each camera:

empty    some of the sweep and the zoom run: nobody in the hall. All methods calibrate from these frames alone, but for
         ours, which has the whole sweep and the image of the calibration object, too.
athlete  some of the motion, as it was filmed. The mosaic methods calibrate from these frames alone; ours and Wu and
         Radke's find them by what they learnt from the empty hall.
masked   the same frames without the athlete: no features where the true masks, 6 px wider, show the body. (Ours is
given
         the frames with that part painted over.)

Self-calibration knows no reference pose: rotations, of all methods alike, are compared after the one rotation a camera
that brings them all nearest to the truth. A frame fails where it is not linked or found, its focal length is off by
more than 5 %, or its pan by more than a degree, or fewer than five of its camera's are left; medians are over the
others.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from experiments.comparisons.harness import Column, Comparison, Row, scored_capture
from experiments.comparisons.self_calibration.trial import CONDITIONS, METHODS, Errors
from experiments.comparisons.self_calibration.trial import compare as errors_of_all
from experiments.config import AppConfig
from experiments.progress import Bars
from experiments.report.style import COLOURS

NAMES: Final = {
    "ours": "ours", "shum_szeliski": "Shum-Szeliski", "sinha_pollefeys": "Sinha-Pollefeys", "wu_radke": "Wu-Radke"
}  # fmt: skip
PAN: Final = "pan_after_common_rotation.median"


def compare(config: AppConfig, folder: Path, console: Console) -> Sequence[Row[Any]]:
    """Every method on every set of frames."""
    del folder
    with Bars(console) as bars:
        capture, truth = scored_capture(config, bars.update)
    with Bars(console) as bars:
        found = errors_of_all(capture, truth, config, bars.update)
    return [
        Row(f"{method}.{condition}", f"{NAMES[method]}, {condition}", figures(found[method, condition]), condition)
        for condition in CONDITIONS
        for method in METHODS
    ]


def figures(cameras: Sequence[Errors]) -> dict[str, float | None]:
    """Medians over the frames of all cameras that did not fail; failures; seconds, all cameras together."""

    def median(name: str, scale: float = 1.0) -> float | None:
        values = np.concatenate([getattr(each, name)[~each.failed] for each in cameras])
        return scale * float(np.median(values)) if len(values) else None

    return {
        "focal.median": median("focal", 100.0),
        PAN: median("pan_rad", np.degrees(1.0)),
        "principal.median": median("principal_px"),
        "k1.median": median("k1"),
        "failures": float(sum(each.failed.sum() for each in cameras)),
        "frames": float(sum(len(each.failed) for each in cameras)),
        "seconds": sum(each.seconds for each in cameras),
    }


def draw(figure: Figure, rows: Sequence[Row[Any]]) -> None:
    """Focal and pan error of each method and set of frames, and the share that failed."""
    by_key = {row.key: row.figures for row in rows}
    panels = figure.subplots(1, 3)
    names = (("focal.median", "focal length [%]"), (PAN, "pan [deg], one common rotation removed"),
             ("failures", "frames that failed [%]"))  # fmt: skip
    for axes, (name, label) in zip(panels, names, strict=True):
        for n, method in enumerate(METHODS):
            found = [by_key[f"{method}.{condition}"] for condition in CONDITIONS]
            heights = [each[name] or 0.0 for each in found]
            if name == "failures":
                heights = [100.0 * h / max(each["frames"] or 1.0, 1.0) for h, each in zip(heights, found, strict=True)]
            axes.bar(np.arange(3) + 0.2 * (n - 1.5), heights, 0.18, color=COLOURS[n], label=NAMES[method])
        axes.set_xticks(np.arange(3), CONDITIONS)
        axes.set_title(label)
        if name != "failures":
            axes.set_yscale("log")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="self_calibration",
    columns=(
        Column("focal.median", "focal %", "%", "{:.2g}"),
        Column(PAN, "pan deg*", "deg", "{:.2g}"),
        Column("principal.median", "centre px", "px", "{:.2g}"),
        Column("k1.median", "k1", "1", "{:.2g}"),
        Column("failures", "failed", "frames", "{:.0f}"),
        Column("frames", "of", "frames", "{:.0f}", "higher"),
        Column("seconds", "s", "s", "{:.0f}"),
    ),
    compare=compare,
    plots={"self_calibration.png": ((11.0, 3.4), draw)},
    experiment="self_calibration",
    prefix="selfcal",
    variants="method, frames",
    note="* one common rotation a camera removed; medians over the frames that did not fail",
)
