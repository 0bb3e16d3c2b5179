"""Where the time goes, stage by stage, on one capture.

    python -m experiments.bench CAPTURE [--reconstruction FOLDER]

prints the median, the 95th percentile and the mean of every stage, and whether the median keeps the limit that is set
for it. With a reconstruction of that capture its cameras and panoramas are used, and calibration is not timed.

Threads are fixed: one pool of two, as in the pipeline, that shares out the four views of an instant; OpenBLAS and
OpenCV keep to one each. What Numba compiles is compiled before the clock starts.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, ParamSpec, TypeVar

import cv2
import numpy as np
from rich.table import Table
from rich.text import Text

from experiments.errors import guard
from experiments.metrics import machine
from experiments.progress import Bars
from experiments.terminal import terminal
from pzcap import pipeline
from pzcap.body import skeleton
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrate_camera, footage_of, taken_over
from pzcap.geometry.camera import at
from pzcap.io import results
from pzcap.io.capture import frame_sets, read_capture
from pzcap.localisation.localise import Localiser, predicted
from pzcap.segmentation import foreground
from pzcap.tracking.camera_refinement import camera_prior
from pzcap.tracking.tracker import Tracker, TrackInput, ViewInput
from pzcap.types import Capture, FrameSet, Image, Localisation, PzcapError, Silhouette

COLD_EVERY: Final = 10  # frame sets
WARM: Final = 3  # frame sets before the clock starts

P = ParamSpec("P")
T = TypeVar("T")
Found = list[Localisation | None]


@dataclass(slots=True)
class Stage:
    """How long one step took, each time. ``limit`` as issue 3 sets it."""

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
    index: Stage = field(default_factory=lambda: Stage("prepare the panorama for localisation", "camera"))
    decode: Stage = field(default_factory=lambda: Stage("decode", "frame set"))
    cold: Stage = field(default_factory=lambda: Stage("localise from nothing", "view", "ms", 250.0))
    follow: Stage = field(default_factory=lambda: Stage("localise from the frame before", "frame set", "ms", 15.0))
    separate: Stage = field(default_factory=lambda: Stage("foreground", "frame set"))
    track: Stage = field(default_factory=lambda: Stage("body (most of it at keyframes)", "frame set"))

    def all(self) -> list[Stage]:
        return [
            self.match, self.adjust, self.index, self.decode, self.cold, self.follow, self.separate, self.track,
        ]  # fmt: skip


def bench(capture: Capture, prepared: Sequence[CalibratedCamera] | None, config: pipeline.Config, bars: Bars) -> Stages:
    """Run every stage that ``capture`` has the material for, and time it.

    ``prepared`` is what is known of the cameras already, one each; None: calibrate them. Raises PzcapError where a
    camera is not complete.
    """
    cv2.setNumThreads(1)
    stages = Stages()
    if prepared is None:
        prepared = [_calibrate(capture, number, config, stages, bars) for number in range(len(capture.cameras))]
    localisers = [stages.index.time(Localiser, known.panorama, known.camera, config.panzoom) for known in prepared]
    _decode(capture, stages, bars)
    with ThreadPoolExecutor(config.threads) as pool:
        _follow(capture, prepared, localisers, config, stages, pool, bars)
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
    capture: Capture,
    prepared: Sequence[CalibratedCamera],
    localisers: Sequence[Localiser],
    config: pipeline.Config,
    stages: Stages,
    pool: ThreadPoolExecutor,
    bars: Bars,
) -> None:
    """The motion, frame set by frame set, each view found from the frame before and, now and then, from nothing."""
    sets = frame_sets(capture)
    tracker = None
    if capture.subject is not None and sets.keyframes:
        model, rate = skeleton.build(capture.subject), float(capture.frame_rate)
        tracker = Tracker(model, sets.keyframes, rate, config.tracking)
    before: Found = [None] * len(prepared)
    last: Found = [None] * len(prepared)

    def localise(number: int, image: Image | None, prior: Localisation | None) -> Localisation | None:
        return None if image is None else localisers[number].localise(image, prior)

    def separate(number: int, image: Image | None, found: Localisation | None) -> Silhouette | None:
        if image is None or found is None or not found.valid:
            return None
        known = prepared[number]
        camera = at(known.camera, found.pan_rad, found.tilt_rad, found.focal_px)
        expected = None if tracker is None else tracker.expect(frames.index, camera)
        return foreground.separate(image, known.panorama, known.camera, found, config.foreground, expected)

    def views(work: Callable[[int, Image | None, Localisation | None], T], frames: FrameSet, found: Found) -> list[T]:
        return list(pool.map(work, range(len(prepared)), frames.images, found))

    for frames in sets:
        warm = frames.index >= WARM
        if frames.index % COLD_EVERY == WARM:
            for number, image in enumerate(frames.images):
                stages.cold.time(localise, number, image, None)
        prior = [predicted(*pair) for pair in zip(before, last, strict=True)]
        # a view that was lost is a cold start
        timed = stages.follow if warm and all(found is not None for found in prior) else Stage("", "")
        before = last
        last = [
            found if found is not None and found.valid else None for found in timed.time(views, localise, frames, prior)
        ]
        timed = stages.separate if warm else Stage("", "")
        silhouettes = timed.time(views, separate, frames, last)
        if tracker is not None:
            stages.track.time(tracker.push, _given(frames, prepared, last, silhouettes, config))
        bars.update("localise, separate, track", frames.index + 1, len(sets))
    if tracker is not None:
        stages.track.time(tracker.finish)


def _given(
    frames: FrameSet, prepared: Sequence[CalibratedCamera], found: Found, silhouettes: Sequence[Silhouette | None],
    config: pipeline.Config,
) -> TrackInput:  # fmt: skip
    views: list[ViewInput | None] = []
    for known, image, place, silhouette in zip(prepared, frames.images, found, silhouettes, strict=True):
        if image is None or place is None or silhouette is None or not silhouette.valid:
            views.append(None)
            continue
        camera = at(known.camera, place.pan_rad, place.tilt_rad, place.focal_px)
        prior = camera_prior(config.panzoom, known.camera, place)
        views.append(ViewInput(image, camera, silhouette, camera_prior=prior))
    return TrackInput(frames.index, tuple(views))


# --------------------------------------------------------------------------------------------------------------


def table(stages: Stages, title: str) -> Table:
    """What was measured, a row a stage."""
    result = Table(title=title, title_justify="left", header_style="bold")
    for name in ("stage", "each"):
        result.add_column(name)
    for name in ("n", "median", "p95", "mean", "limit"):
        result.add_column(name, justify="right")
    result.add_column("median within it")
    for stage in stages.all():
        if not stage.samples:
            continue
        median = float(np.median(stage.samples))
        figures = median, float(np.percentile(stage.samples, 95)), float(np.mean(stage.samples))
        verdict = "" if stage.limit is None else Text("yes", "green") if median <= stage.limit else Text("no", "red")
        limit = "" if stage.limit is None else f"{stage.limit:g} {stage.unit}"
        result.add_row(
            stage.name, stage.per, str(len(stage.samples)), *(f"{f:.1f} {stage.unit}" for f in figures), limit, verdict
        )
    return result


def _ready(capture: Capture, folder: Path, method: str) -> list[CalibratedCamera]:
    """Cameras and panoramas of a reconstruction by the cameras of ``capture``."""
    found = taken_over(capture, results.load(folder), method, [])
    missing = [files.name for files, ready in zip(capture.cameras, found, strict=True) if ready is None]
    if missing:
        raise PzcapError(f"{folder}: camera {', '.join(missing)} was not calibrated; leave --reconstruction out")
    return [ready for ready in found if ready is not None]


def _job() -> None:
    parser = argparse.ArgumentParser(prog="python -m experiments.bench", description="Where the time goes.")
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
    terminal(width=max(terminal().width, 120)).print(table(stages, title))


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_job)


if __name__ == "__main__":
    sys.exit(main())
