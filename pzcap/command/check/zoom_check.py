"""Zoom run: its range, that it goes one way, that the head was locked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.command.check.findings import Finding, Level, graded
from pzcap.command.check.sweep_check import Sweep
from pzcap.command.check.views import best, relate, view
from pzcap.io.video import VideoReader
from pzcap.types import Array

_FRAMES: Final = 15


@dataclass(frozen=True, slots=True)
class ZoomRun:
    """Focal lengths of a zoom run, in those of the sweep; None where it does not fit the sweep."""

    widest: float | None
    longest: float | None


def check_zoom(camera: str, path: Path, sweep: Sweep) -> tuple[ZoomRun, list[Finding]]:
    """The zoom run of a camera, and what there is to say about it."""
    reader = VideoReader(path)
    some = set(np.linspace(0, reader.frame_count - 1, min(reader.frame_count, 40)).round().astype(int).tolist())
    views = [view(image) for number, (_, image) in enumerate(reader) if number in some]
    relations = [relate(one, other) for one, other in pairwise(views)]
    scales = np.cumprod(np.array([1.0, *(float(relation.scale) if relation.found else 1.0 for relation in relations)]))
    found = list(_course(scales, [relation.found for relation in relations], reader.frame_count))
    # where in the sweep: the picture of the sweep's own focal length fits best
    places = [(k, *best(views[k], sweep.keys)) for k in range(0, len(views), max(1, len(views) // 6))]
    k, _, relation = max(places, key=lambda place: place[2].inliers)
    run = ZoomRun(None, None)
    if relation.found:
        factor = 1.0 / relation.scale / scales[k]  # of the first frame's focal length, in those of the sweep
        run = ZoomRun(float(factor * scales.min()), float(factor * scales.max()))
        found.append((Level.OK, f"goes from {run.widest:.2f} to {run.longest:.2f} times the focal length of the sweep"))
        if not 0.97 * scales.min() <= 1 / factor <= 1.03 * scales.max():
            found.append(
                (Level.WARN, "does not pass through the focal length of the sweep; begin wider, or end longer")
            )
    else:
        found.append(
            (Level.FAIL, "none of its pictures fits the sweep; is it of this camera, before the head was moved?")
        )
    return run, [Finding(level, camera, "zoom", text) for level, text in found]


def _course(scales: Array, known: list[bool], frames: int) -> Iterator[tuple[Level, str]]:
    if frames < _FRAMES:
        yield Level.WARN, f"has {frames} frames; 15 or more are good: zoom more slowly"
    lost = 1.0 - float(np.mean(known)) if known else 1.0
    if lost > 0.3:
        yield (
            Level.WARN,
            f"{100 * lost:.0f} % of its pictures cannot be laid to the next; zoom more slowly, keep it sharp",
        )
    steps = np.diff(np.log(scales))
    back = float(np.abs(steps[steps < 0]).sum()) if steps.sum() >= 0 else float(steps[steps > 0].sum())
    yield (
        graded(back, 0.05, 0.3),
        f"zooms by a factor of {scales.max() / scales.min():.2f}"
        + ("; goes back on the way: zoom one way throughout" if back > 0.05 else ""),
    )
