"""Material of a capture for a method of this tree, and the form of its answer."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from experiments import memory
from experiments.benchmark.make import CONFIG, BenchmarkConfig
from experiments.config import AppConfig, structured
from pzcap.extras import reconstruct
from pzcap.io.capture import FrameSets, frame_sets, read_capture
from pzcap.progress import Report
from pzcap.scoring.records import CameraPoses, CameraTrack, Results
from pzcap.types import Camera, Capture, PzcapError, Reconstruction
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


def track_of(instants: Mapping[int, Camera], count: int) -> CameraTrack:
    """A track of cameras of some frames."""
    valid, focal = np.zeros(count, bool), np.ones(count)
    poses = CameraPoses(
        np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.zeros((count, 2)), np.zeros((count, 4))
    )
    for frame, camera in instants.items():
        valid[frame], focal[frame] = True, camera.focal_px
        poses.rotation[frame], poses.position_m[frame] = camera.world_T_cam[:3, :3], camera.world_T_cam[:3, 3]
        poses.principal_px[frame] = camera.principal_px
        poses.distortion[frame] = camera.k1, camera.k2, camera.p1, camera.p2
    return CameraTrack(valid, focal, None, None, poses)
