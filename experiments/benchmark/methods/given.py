"""Material of a capture for a method of this tree, and the form of its answer."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from experiments import memory
from experiments.benchmark.make import CONFIG, BenchmarkConfig
from experiments.config import AppConfig, structured
from pzcap.extras import reconstruct
from pzcap.io.capture import FrameSets, frame_sets, read_capture
from pzcap.progress import Report
from pzcap.scoring.records import CameraTrack, Results
from pzcap.types import Capture, PzcapError, Reconstruction
from sim import truth as truth_files
from sim.truth import Truth


@dataclass(frozen=True, slots=True, eq=False)
class Answered:
    """Answer of a method on one capture, with its time and memory."""

    results: Results | None  # None: it could not run
    seconds: float  # wall time of all frames; of those that are run together, CPU time of their own part
    memory_mib: float | None
    missing: str | None = None  # why it could not run


def attempted(answer: Callable[[], Answered]) -> Answered:
    """The ``answer`` of one method, or why it has none on this footage: others that are run with it may have one."""
    try:
        return answer()
    except PzcapError as error:
        return Answered(None, 0.0, None, str(error))


@dataclass(frozen=True, eq=False)
class Given:
    """One capture of a split, and all that was made of it."""

    job: Path  # what `make` left: capture/, truth/, given/
    config: AppConfig
    report: Report

    @cached_property
    def capture(self) -> Capture:
        """The footage."""
        return read_capture(self.job / "capture")

    @cached_property
    def sets(self) -> FrameSets:
        """Its frames, and its keyframes."""
        return frame_sets(self.capture)

    @cached_property
    def shot(self) -> BenchmarkConfig:
        """Configuration that it was shot by: for the same motion, filmed otherwise."""
        tree = json.loads((self.job / CONFIG).read_text(encoding="utf-8"))
        return structured(tree, BenchmarkConfig, f"{self.job / CONFIG}")

    @cached_property
    def truth(self) -> Truth:
        """The simulator's truth: for tracks that are given some of it."""
        return truth_files.load(self.job / "truth")

    @cached_property
    def ours(self) -> tuple[Reconstruction, float, float]:
        """Our reconstruction, from the footage alone; seconds and MiB."""
        return reconstructed(self.capture, self.config, self.report)

    def results(self, method: str, tracks: tuple[CameraTrack | None, ...] | None = None) -> Results:
        """Results of a ``method``: these tracks (none: no camera was found), and no body."""
        timecodes = self.sets.timecodes
        names = tuple(camera.name for camera in self.capture.cameras)
        size = self.truth.width, self.truth.height
        tracks = (None,) * len(names) if tracks is None else tracks
        return Results(method, self.capture.name, len(timecodes), timecodes, size, names, tracks, None)


def reconstructed(capture: Capture, config: AppConfig, report: Report) -> tuple[Reconstruction, float, float]:
    """Our reconstruction, the seconds that it took, and the most memory, MiB."""
    start = time.perf_counter()
    with memory.watched() as peak:
        found = reconstruct.reconstruct(capture, config.reconstruct, report)
    return found, time.perf_counter() - start, peak.mib
