"""What a detector's keypoints are worth: the body without them, with them, and from them alone.

    python -m experiments.comparisons.keypoints CAPTURE      # with keypoints, and the truth beside it
    python -m experiments.run experiment=floor_exercise shoot.detector.enabled=true    # shoots one

prints how far off the joints are (mm: mean, 95th percentile, largest, mean of an inverted body) and how many frames are
lost. The cameras are estimated, and are the same for all three.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

from rich.table import Table

from experiments.comparisons.triangulation import triangulate
from experiments.errors import guard
from experiments.footage import capture_in, truth_beside
from experiments.metrics import Metric, format_value
from experiments.progress import Bars
from experiments.score import score
from experiments.terminal import terminal
from experiments.totals import metrics
from pzcap.io.capture import read_capture
from pzcap.pipeline import Config, reconstruct
from pzcap.types import Capture, PzcapError, Reconstruction
from sim.truth import Truth

SHOWN: Final = ("body.mpjpe.mean", "body.mpjpe.p95", "body.mpjpe.max", "body.mpjpe.inverted", "body.lost")


def compare(capture: Capture, truth: Truth, bars: Bars) -> Iterator[tuple[str, dict[str, Metric]]]:
    """Name and scores of each way to the body."""
    plain = replace(capture, cameras=tuple(replace(camera, keypoints=None) for camera in capture.cameras))
    without = reconstruct(plain, Config(), bars.update)
    yield "without keypoints", body(without, truth)
    yield "with keypoints", body(reconstruct(capture, Config(), bars.update, without), truth)
    yield "keypoints alone", body(replace(without, motion=triangulate(capture, without)), truth)


def body(reconstruction: Reconstruction, truth: Truth) -> dict[str, Metric]:
    """The scores of the body alone."""
    bodily = replace(reconstruction, tracks=(None,) * len(reconstruction.tracks))
    return {metric.key: metric for metric in metrics(score(bodily, truth, None))}


def _command() -> None:
    parser = argparse.ArgumentParser(
        prog="experiments.comparisons.keypoints", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("capture", type=Path, help="a capture with keypoints, and the truth beside it")
    folder = capture_in(parser.parse_args().capture)
    capture, truth = read_capture(folder), truth_beside(folder)
    if truth is None:
        raise PzcapError(f"{folder}: no truth lies beside it to compare with; shoot one (shoot.detector.enabled=true)")
    if not any(camera.keypoints for camera in capture.cameras):
        raise PzcapError(f"{folder}: no camera has keypoints; name them in capture.json (docs/capture.md)")
    title = f"{capture.name}: joint errors in mm, and frames lost"
    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("the body")
    for key in SHOWN:
        table.add_column(key.rpartition(".")[2], justify="right")
    with Bars(terminal(stderr=True)) as bars:
        for name, found in compare(capture, truth, bars):
            table.add_row(name, *(format_value(found[key]) for key in SHOWN))
    terminal().print(table)


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_command)


if __name__ == "__main__":
    sys.exit(main())
