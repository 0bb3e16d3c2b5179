"""Worth of a detector's keypoints: the body without them, with them, and from them alone.

    python -m experiments.compare keypoints seed=0           # conf/experiment/keypoints.yaml shoots with a detector
    python -m experiments.compare keypoints capture=CAPTURE  # with keypoints, and the truth beside it

How far off the joints are, and how many frames are lost. The cameras are estimated, and are the same for all three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from experiments.comparisons.harness import LOST, MEAN, P95, Column, Comparison, Row, body, on_keypoints
from experiments.comparisons.triangulation import triangulate
from experiments.config import AppConfig
from experiments.progress import Bars


def compare(config: AppConfig, folder: Path, console: Console) -> Sequence[Row[Any]]:
    """Each way to the body. Raises PzcapError where no camera has keypoints."""
    del folder
    with Bars(console) as bars:
        capture, truth, pixels, joined = on_keypoints(config, bars.update)
    ways = {
        "without": ("without keypoints", pixels),
        "with": ("with keypoints", joined),
        "alone": ("keypoints alone", replace(pixels, motion=triangulate(capture, pixels))),
    }
    return [Row(key, label, body(each, truth)) for key, (label, each) in ways.items()]


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="keypoints",
    columns=(
        MEAN,
        P95,
        Column("body.mpjpe.max", "max mm", "mm", "{:.0f}"),
        Column("body.mpjpe.inverted", "inverted mm", "mm", "{:.1f}"),
        LOST,
    ),
    compare=compare,
    takes_cameras=True,
    experiment="keypoints",
    variants="the body",
)
