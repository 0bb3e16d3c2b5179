"""The frames of a recording that a reviewer should see first: the worst by each metric, read back from its errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments.metrics import TARGETS
from experiments.recordings import opened
from pzcap.types import Array
from pzcap.viewer.columns import TIMELINE

PER_KIND: Final = 3
APART: Final = 10  # frames: the neighbours of a bad one are bad in the same way

Purpose = Literal["calibration", "tracking"]


class Kind(NamedTuple):
    """One error over time: where it stands, and the metric whose target it is judged by."""

    entity: str
    what: str
    unit: str
    metric: str
    purpose: Purpose  # of the layout in which it is best seen

    def severity(self, values: Array) -> Array:
        """Times the target; of what should be 1, such as an IoU, by what is missing."""
        target = TARGETS[self.metric]
        return (1.0 - values) / (1.0 - target) if self.unit == "1" else np.abs(values) / target


KINDS: Final = (
    Kind("/error/mpjpe", "joints", "mm", "body.mpjpe.mean", "tracking"),
    Kind("/error/iou", "silhouette IoU", "1", "foreground.iou", "tracking"),
    Kind("/error/outline", "outline", "px", "foreground.outline", "tracking"),
    Kind("/error/pan", "pan", "deg", "panzoom.pan.rms", "calibration"),
    Kind("/error/focal", "focal length", "%", "panzoom.focal.rms", "calibration"),
    Kind("/error/reprojection", "scene points", "px", "panzoom.reprojection.rms", "calibration"),
)


class Series(NamedTuple):
    """A number at some frames."""

    frames: NDArray[np.int64]  # (N,), ascending
    values: Array  # (N,)


@dataclass(frozen=True, slots=True)
class Bookmark:
    """A frame to look at, and why."""

    frame: int
    kind: Kind
    camera: str | None
    value: float
    severity: float  # times its target; of a comparison, how much the two differ in that

    @property
    def text(self) -> str:
        where = "" if self.camera is None else f", camera {self.camera}"
        unit = "" if self.kind.unit == "1" else f" {self.kind.unit}"
        return f"{self.kind.what}{where}: {self.value:.3g}{unit} ({self.severity:.1f}x)"


def errors(recording: Path) -> dict[tuple[Kind, str | None], Series]:
    """(Kind, camera) -> its series, of everything that the recording knows the error of.

    Raises PzcapError if it is damaged.
    """
    content = [f"{kind.entity}/**" for kind in KINDS]
    found: dict[tuple[Kind, str | None], list[tuple[int, float]]] = {}
    with opened(recording) as reader:
        for chunk in reader.store().stream().filter(content=content, components="Scalars:scalars").to_chunks():
            kind = next(kind for kind in KINDS if f"{chunk.entity_path}/".startswith(f"{kind.entity}/"))
            camera = chunk.entity_path[len(kind.entity) + 1 :].replace("\\", "") or None
            batch = chunk.to_record_batch()
            rows = zip(batch[TIMELINE].to_pylist(), batch["Scalars:scalars"].to_pylist(), strict=True)
            found.setdefault((kind, camera), []).extend((int(frame), float(value[0])) for frame, value in rows)
    columns = {key: zip(*sorted(rows), strict=True) for key, rows in found.items()}
    return {key: Series(np.array(frames, np.int64), np.array(values)) for key, (frames, values) in columns.items()}


def worst(found: Mapping[tuple[Kind, str | None], Series]) -> list[Bookmark]:
    """A few of each kind, the gravest first."""
    marks = [
        Bookmark(int(series.frames[at]), kind, camera, float(series.values[at]), float(severity[at]))
        for (kind, camera), series in found.items()
        for severity in [kind.severity(series.values)]
        for at in range(len(series.frames))
    ]
    return _thinned(marks)


def differing(
    first: Mapping[tuple[Kind, str | None], Series], second: Mapping[tuple[Kind, str | None], Series]
) -> list[Bookmark]:
    """Frames at which two runs differ most; the value is by how much the second is above the first."""
    marks = []
    for kind, camera in first.keys() & second.keys():
        one, other = first[kind, camera], second[kind, camera]
        frames, here, there = np.intersect1d(one.frames, other.frames, return_indices=True)
        apart = np.abs(kind.severity(other.values[there]) - kind.severity(one.values[here]))
        above = np.abs(other.values[there]) - np.abs(one.values[here])
        marks += [
            Bookmark(int(frame), kind, camera, float(value), float(grave))
            for frame, value, grave in zip(frames, above, apart, strict=True)
        ]
    return _thinned(marks)


def _thinned(marks: list[Bookmark]) -> list[Bookmark]:
    ranked = sorted(marks, key=lambda mark: (-mark.severity, mark.frame, mark.camera or ""))
    kept = [mark for kind in KINDS for mark in _few(mark for mark in ranked if mark.kind == kind)]
    return sorted(kept, key=lambda mark: -mark.severity)


def _few(ranked: Iterator[Bookmark]) -> list[Bookmark]:
    kept: list[Bookmark] = []
    for mark in ranked:
        if len(kept) == PER_KIND:
            break
        if all(abs(mark.frame - other.frame) >= APART for other in kept):
            kept.append(mark)
    return kept
