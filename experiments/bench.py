"""Time of each stage on one capture.

    python -m experiments.bench CAPTURE [--reconstruction FOLDER]

prints the median, the 95th percentile and the mean of every stage, and whether the median keeps the limit that is set
for it. With a reconstruction of that capture its cameras and panoramas are used, and calibration is not timed.

Threads are fixed: one pool of two, as in the pipeline, that shares out the four views of an instant; OpenBLAS and
OpenCV keep to one each. What Numba compiles is compiled before the clock starts.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import numpy as np
from rich.table import Table
from rich.text import Text

from experiments.errors import guard
from experiments.metrics import machine
from experiments.progress import Bars
from experiments.terminal import command_line, table, terminal
from pzcap import pipeline
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrate_camera, footage_of, taken_over
from pzcap.events import BodyTracked, FrameLocalised, FrameSegmented, Progress
from pzcap.io import results
from pzcap.io.capture import frame_sets, read_capture
from pzcap.runtime import one_thread_each
from pzcap.starting_poses import body_to_track, body_tracker
from pzcap.types import Capture, FrameSet, PzcapError
from pzcap.views import Expecting, ViewLocaliser, segment_views

COLD_EVERY: Final = 10  # frame sets
WARM: Final = 3  # frame sets before the clock starts

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(slots=True)
class Stage:
    """Durations of one step. ``limit`` as issue 3 sets it."""

    name: str
    per: str
    unit: str = "ms"
    limit: float | None = None
    samples: list[float] = field(default_factory=list)

    def time(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        start = time.perf_counter()
        result = work(*args, **kwargs)
        self.add(time.perf_counter() - start)
        return result

    def add(self, seconds: float) -> None:
        self.samples.append(seconds * (1000.0 if self.unit == "ms" else 1.0))


@dataclass(slots=True)
class Stages:
    """In the order in which they run."""

    match: Stage = field(default_factory=lambda: Stage("match sweep and zoom run", "camera", "s"))
    adjust: Stage = field(default_factory=lambda: Stage("joint adjustment and panorama", "camera", "s", 30.0))
    index: Stage = field(default_factory=lambda: Stage("prepare the panoramas for localisation", "capture"))
    start: Stage = field(default_factory=lambda: Stage("find keyframes in the keypoints", "capture"))
    decode: Stage = field(default_factory=lambda: Stage("decode", "frame set"))
    cold: Stage = field(default_factory=lambda: Stage("localise from nothing", "view", "ms", 250.0))
    follow: Stage = field(default_factory=lambda: Stage("localise from the frame before", "frame set", "ms", 15.0))
    separate: Stage = field(default_factory=lambda: Stage("foreground", "frame set"))
    track: Stage = field(default_factory=lambda: Stage("body (most of it at keyframes)", "frame set"))

    def all(self) -> list[Stage]:
        return [
            self.match, self.adjust, self.index, self.start, self.decode, self.cold, self.follow, self.separate,
            self.track,
        ]  # fmt: skip


def bench(capture: Capture, known: Sequence[CalibratedCamera] | None, config: pipeline.Config, bars: Bars) -> Stages:
    """Run every stage that ``capture`` has the material for, and time it.

    ``known`` is what is known of the cameras already, one each; None: calibrate them. Raises PzcapError where a camera
    is not complete.
    """
    stages = Stages()
    with one_thread_each():
        if known is None:
            known = [_calibrate(capture, number, config, stages, bars) for number in range(len(capture.cameras))]
        _decode(capture, stages, bars)
        with ThreadPoolExecutor(config.threads) as pool:
            _follow(capture, known, config, stages, pool, bars)
    return stages


def _calibrate(capture: Capture, number: int, config: pipeline.Config, stages: Stages, bars: Bars) -> CalibratedCamera:
    files = capture.cameras[number]
    if capture.calibration_object is None or files.reference is None or files.sweep is None:
        raise PzcapError(f"camera {files.name}: a benchmark needs its reference image and sweep, and the object")
    start = matched = time.perf_counter()

    def report(stage: str, done: int, total: int) -> None:
        nonlocal matched
        if stage.startswith("match"):
            matched = time.perf_counter()
        bars.update(f"camera {files.name}: {stage}", done, total)

    prepared = calibrate_camera(footage_of(capture, files), config.panzoom, report)
    stages.match.add(matched - start)
    stages.adjust.add(time.perf_counter() - matched)
    return prepared


def _decode(capture: Capture, stages: Stages, bars: Bars) -> None:
    """The recordings of the motion, and nothing else."""
    sets = frame_sets(capture)
    frames = iter(sets)
    for done in range(len(sets)):
        stages.decode.time(next, frames)
        bars.update("decode", done + 1, len(sets))


def _follow(
    capture: Capture, cameras: Sequence[CalibratedCamera], config: pipeline.Config, stages: Stages,
    pool: ThreadPoolExecutor, bars: Bars,
) -> None:  # fmt: skip
    """The motion by the pipeline's own loop, whose events say what each stage took; now and then a view is found from
    nothing, besides."""
    sets = frame_sets(capture)
    body = body_to_track(capture, sets, config.tracking, [])
    localise = stages.index.time(ViewLocaliser, cameras, config.panzoom, pool, capture.frame_rate)

    def localise_timed(frames: FrameSet, tracker: Expecting | None) -> FrameLocalised:
        if frames.index % COLD_EVERY == WARM:
            for localiser, image in zip(localise.localisers, frames.images, strict=True):
                if localiser is not None and image is not None:
                    stages.cold.time(localiser.localise, image, None)
        return localise(frames, tracker)

    segment, followed = partial(segment_views, cameras, config.foreground, config.panzoom, pool), False
    tracker = None
    if body is not None:
        starting = body_tracker(body, capture, sets, localise, segment, config.tracking, [])
        tracker = stages.start.time(_outcome, starting)
    for event in pipeline.follow(sets, localise_timed, segment, tracker):
        match event:
            case FrameLocalised(frames, found):
                if followed and frames.index >= WARM:
                    stages.follow.add(event.seconds)
                followed = all(one is not None and one.valid for one in found)  # a view that was lost is a cold start
            case FrameSegmented(frames) if frames.index >= WARM:
                stages.separate.add(event.seconds)
            case BodyTracked():
                stages.track.add(event.seconds)
            case Progress(_, done, total):
                bars.update("localise, segment, track", done, total)


def _outcome(steps: Generator[Any, None, T]) -> T:
    """The value that a generator returns in the end."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: T = end.value
            return found


# --------------------------------------------------------------------------------------------------------------


def stage_table(stages: Stages, title: str) -> Table:
    """Tabulate what was measured, a row a stage."""
    rows: list[tuple[str | Text, ...]] = []
    for stage in stages.all():
        if not stage.samples:
            continue
        median = float(np.median(stage.samples))
        figures = median, float(np.percentile(stage.samples, 95)), float(np.mean(stage.samples))
        cells = (stage.name, stage.per, str(len(stage.samples)), *(f"{f:.1f} {stage.unit}" for f in figures))
        if stage.limit is None:
            rows.append((*cells, "", ""))
        else:
            verdict = Text("yes", "green") if median <= stage.limit else Text("no", "red")
            rows.append((*cells, f"{stage.limit:g} {stage.unit}", verdict))
    return table(title, ("stage", "each", ">n", ">median", ">p95", ">mean", ">limit", "median within it"), rows)


def _ready(capture: Capture, folder: Path, method: str) -> list[CalibratedCamera]:
    """Cameras and panoramas of a reconstruction by the cameras of ``capture``."""
    found = taken_over(capture, results.load(folder), method, [])
    missing = [files.name for files, ready in zip(capture.cameras, found, strict=True) if ready is None]
    if missing:
        raise PzcapError(f"{folder}: camera {', '.join(missing)} was not calibrated; leave --reconstruction out")
    return [ready for ready in found if ready is not None]


def _job() -> None:
    parser = command_line("bench", __doc__)
    parser.add_argument("capture", type=Path, help="a capture folder, docs/capture.md")
    parser.add_argument("--reconstruction", type=Path, help="one of it, that a run left: do not calibrate")
    given = parser.parse_args()
    capture = read_capture(given.capture)
    about, load = machine(), os.getloadavg()[0]
    config = pipeline.Config(panzoom=PanZoomConfig())
    folder, method = given.reconstruction, config.panzoom.method
    prepared = None if folder is None else _ready(capture, folder, method)
    with Bars(terminal(stderr=True)) as bars:
        stages = bench(capture, prepared, config, bars)
    title = f"{capture.name}: {about['cpu']}, {about['cores']} cores, {config.threads} threads, load {load:.1f} before"
    terminal(width=max(terminal().width, 120)).print(stage_table(stages, title))


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_job)


if __name__ == "__main__":
    sys.exit(main())
