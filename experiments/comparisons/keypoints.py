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

from experiments.comparisons.harness import Column, Comparison, Row, body, scored_with_keypoints, without_keypoints
from experiments.comparisons.triangulation import triangulate
from experiments.config import AppConfig
from experiments.progress import Bars
from pzcap.pipeline import reconstruct


def compare(config: AppConfig, folder: Path, console: Console) -> Sequence[Row[Any]]:
    """Each way to the body. Raises PzcapError where no camera has keypoints."""
    del folder
    with Bars(console) as bars:
        capture, truth = scored_with_keypoints(config, bars.update)
        without = reconstruct(without_keypoints(capture), config.reconstruct, bars.update)
        joined = reconstruct(capture, config.reconstruct, bars.update, without)
        alone = replace(without, motion=triangulate(capture, without))
    ways = {
        "without": ("without keypoints", without),
        "with": ("with keypoints", joined),
        "alone": ("keypoints alone", alone),
    }
    return [Row(key, label, body(found, truth)) for key, (label, found) in ways.items()]


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="keypoints",
    about=__doc__ or "",
    columns=(
        Column("body.mpjpe.mean", "mean mm", "mm", "{:.1f}"),
        Column("body.mpjpe.p95", "p95 mm", "mm", "{:.1f}"),
        Column("body.mpjpe.max", "max mm", "mm", "{:.0f}"),
        Column("body.mpjpe.inverted", "inverted mm", "mm", "{:.1f}"),
        Column("body.lost", "lost", "frames", "{:.0f}"),
    ),
    compare=compare,
    plots={},
    experiment="keypoints",
    variants="the body",
)
