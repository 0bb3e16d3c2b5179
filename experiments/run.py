"""Shoot -> reconstruct -> score -> show, in one command.

    python -m experiments.run experiment=floor_exercise|pedestrian|clean seed=N hydra.run.dir=DIR
    python -m experiments.run capture=FOLDER              # footage of anyone's, docs/capture.md
    python -m experiments.run capture=FOLDER cameras=RESULTS    # filmed by the same cameras: not calibrated again
    python -m experiments.run estimator=module:function   # an estimator of anyone's, docs/estimators.md
    python -m experiments.run -m shoot.sensor.read_noise=0,2,8    # a sweep: runs what is missing,
    `experiments.studies.jobs`

leaves DIR/{metrics.json, recording.rrd, report.html, reconstruction/} and the link DIR/capture.
"""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from numba.core.event import install_timer
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.text import Text

from experiments import estimators, footage, memory
from experiments.config import AppConfig, build, default_tree, plain
from experiments.errors import flags_first, guard, reported
from experiments.metrics import format_value, meets_target, run_info, write_metrics
from experiments.progress import Bars
from experiments.score import Score, score
from experiments.silhouette_score import ForegroundScorer
from experiments.studies import jobs
from experiments.terminal import print_whole, table, terminal
from experiments.totals import metrics
from pzcap import events
from pzcap.extras import reconstruct
from pzcap.io import results
from pzcap.io.capture import read_capture
from pzcap.scoring.metric import Metric
from pzcap.types import Array, Capture, PzcapError, Reconstruction
from pzcap.viewer.drawing import outlines

if TYPE_CHECKING:
    from pzcap.viewer.recording import Recorder

CONF: Final = Path(__file__).parents[1] / "conf"
RESULTS: Final = ("metrics.json", "report.html", "recording.rrd")


@dataclass(slots=True)
class Reconstructed:
    """Result of the pipeline, and how long it took."""

    reconstruction: Reconstruction
    stage_s: dict[str, float]
    seconds: float  # of the pipeline alone, from the first decoded frame to the result
    peak: memory.Peak
    compiling_s: float = 0.0  # a first run compiles its kernels
    outlines: dict[tuple[int, int], list[Array]] = field(default_factory=dict)  # (frame set, camera)


def run(config: AppConfig, tree: dict[str, Any], folder: Path, console: Console) -> list[Metric]:
    """Everything from the shoot to the report, into ``folder``. PzcapError for what the user can mend."""
    start = time.perf_counter()
    if config.settings and config.estimator is None:
        raise PzcapError("settings are those of an estimator of one's own; say estimator=module:function, too")
    estimator = None if config.estimator is None else estimators.find(config.estimator, config.settings)
    if estimator is not None and config.cameras is not None:
        raise PzcapError("an estimator finds the cameras itself; leave out cameras=... or estimator=...")
    cameras = None if config.cameras is None else results.load(footage.reconstruction_in(Path(config.cameras)))
    _forget(folder)
    with Bars(console) as bars:
        shot = footage.capture_of(config, bars.update)
    capture = read_capture(shot)
    if not (folder / "capture").exists():
        (folder / "capture").symlink_to(shot.resolve(), target_is_directory=True)
    truth = footage.truth_beside(shot)

    name = f"{capture.name}, {config.estimator or config.method}, seed {config.seed}"
    with ExitStack() as stack:
        recorder = None
        if config.output.recording:
            from experiments.report import recording  # brings Rerun: half a second, of every start otherwise
            from pzcap.viewer.recording import Recorder

            recorder = stack.enter_context(
                Recorder(folder / "recording.rrd", capture, name=name, jpeg_quality=config.output.jpeg_quality)
            )
        foreground = None if truth is None else ForegroundScorer(truth, tuple(c.name for c in capture.cameras))
        if estimator is None:
            with Bars(console) as bars:
                done = _reconstruct(capture, config, cameras, bars, foreground, recorder)
        else:
            with console.status(Text(config.estimator or "")):
                done = _estimate(estimator, capture, config.estimator or "")
        reconstruction = done.reconstruction
        results.save(reconstruction, folder / "reconstruction")
        frames = len(reconstruction.timecodes)
        result: Score | None = None
        found: list[Metric] = []
        if truth is not None and foreground is not None:
            with Bars(console) as bars:
                errors = foreground.errors(frames)
                result = score(reconstruction, truth, errors, lambda done, total: bars.update("score", done, total))
            found = metrics(result)
        info = run_info(tree, config.seed, reconstruction.notes)
        if recorder is not None:
            with console.status("writing the recording"):
                recording.finish(recorder, reconstruction, truth, result)
                found += _speed(done, frames, recorder.busy_s / (time.perf_counter() - start))
                recording.summarise(recorder, reconstruction, found, info)
        else:
            found += _speed(done, frames, None)
    write_metrics(folder / "metrics.json", found, info)
    if config.output.report:
        from experiments.report.page import Material, write_report  # brings Matplotlib: half a second, likewise

        with console.status("writing the report"):
            material = Material(capture, reconstruction, truth, result, found, info, done.outlines, done.stage_s)
            write_report(folder / "report.html", material, _command())
    return found


def _command() -> str:
    """Command that makes this run again."""
    arguments = sys.argv[1:]
    if HydraConfig.initialized() and not OmegaConf.is_missing(HydraConfig.get().job, "num"):
        arguments = list(HydraConfig.get().overrides.task)  # a job of a sweep, perhaps in a process of its own
    return shlex.join(["python", "-m", "experiments.run", *arguments])


def _forget(folder: Path) -> None:
    """Remove what an earlier run left in ``folder``: a run that fails must not be mistaken for it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (*RESULTS, f"reconstruction/{results.MANIFEST}"):
        (folder / name).unlink(missing_ok=True)
    for partial in (*folder.glob("*.partial"), *folder.glob("reconstruction/*.partial")):  # of one that was killed
        partial.unlink()
    if (folder / "capture").is_symlink():  # else it is footage
        (folder / "capture").unlink()


def _reconstruct(
    capture: Capture,
    config: AppConfig,
    cameras: Reconstruction | None,
    bars: Bars,
    foreground: ForegroundScorer | None,
    recorder: Recorder | None,
) -> Reconstructed:
    """Drive the pipeline. Scoring and recording happen between its steps and are not in its time."""
    clock = _Clock(reconstruct.stages(capture, config.reconstruct, cameras))
    contours: dict[tuple[int, int], list[Array]] = {}
    stage_s = dict.fromkeys(("prepare", "panzoom", "foreground", "tracking"), 0.0)
    with memory.watched() as peak, install_timer("numba:compile", lambda _: None) as compiling:
        for event in clock:
            if recorder is not None:
                recorder.event(event)
            match event:
                case events.Progress(stage, done, total):
                    bars.update(stage, done, total)
                case events.CamerasReady(seconds):
                    stage_s["prepare"] = seconds
                case events.FrameLocalised():
                    stage_s["panzoom"] += event.seconds
                case events.BodyTracked():
                    stage_s["tracking"] += event.seconds
                case events.FrameSegmented(frames, _, silhouettes):
                    stage_s["foreground"] += event.seconds
                    for camera, silhouette in enumerate(silhouettes):
                        if silhouette is None or not silhouette.valid:
                            continue
                        contours[frames.index, camera] = outlines(silhouette.probability)
                        if foreground is not None:
                            foreground.add(frames.index, frames.timecode, camera, silhouette.probability)
                case events.Finished(reconstruction):
                    compiling_s = compiling.duration if compiling.done else 0.0
                    return Reconstructed(reconstruction, stage_s, clock.seconds, peak, compiling_s, contours)
                case _:
                    pass
    raise AssertionError("the pipeline ends with Finished")


def _estimate(estimator: estimators.Estimator, capture: Capture, name: str) -> Reconstructed:
    """Let an estimator of anyone's do what the pipeline does."""
    start = time.perf_counter()
    with memory.watched() as peak:
        reconstruction = estimators.estimate(estimator, capture, name)
    return Reconstructed(reconstruction, {}, time.perf_counter() - start, peak)


class _Clock:
    """Iterates over something and sums up the time that it took, without the time that its user took."""

    def __init__(self, steps: Iterator[Any]) -> None:
        self._steps, self.seconds = steps, 0.0

    def __iter__(self) -> Iterator[Any]:
        while True:
            start = time.perf_counter()
            try:
                step = next(self._steps)
            except StopIteration:
                return
            finally:
                self.seconds += time.perf_counter() - start
            yield step


def _speed(done: Reconstructed, frames: int, log_share: float | None) -> list[Metric]:
    return [
        *(Metric(f"speed.{stage}", 1000.0 * seconds / frames, "ms/frame") for stage, seconds in done.stage_s.items()),
        # the cameras are prepared once a hall, whatever is filmed there: that is speed.prepare
        Metric("speed.fps", frames / (done.seconds - done.stage_s.get("prepare", 0.0)), "frame sets/s", "higher"),
        Metric("speed.compiling", done.compiling_s, "s"),
        Metric("speed.log_share", None if log_share is None else 100.0 * log_share, "%"),
        Metric("memory.peak", done.peak.mib, "MiB"),
    ]


def print_table(console: Console, title: str, found: list[Metric]) -> None:
    """The metrics, and which of them miss their target."""
    verdicts = {True: Text("reached", "green"), False: Text("missed", "red"), None: Text()}
    rows = [
        (metric.key, format_value(metric), metric.unit, verdicts[meets_target(metric)])
        for metric in found
        if metric.value is not None
    ]
    print_whole(console, table(title, ("metric", ">value", "unit", "target"), rows))


ConfigStore.instance().store(name="base", node=default_tree())


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
def _job(composed: DictConfig) -> None:
    # jobs side by side would write over each other's bars: what a sweep says of each is enough
    aside = HydraConfig.get().runtime.choices["hydra/launcher"] != "basic"
    out, err = terminal(quiet=aside), terminal(stderr=True, quiet=aside)
    folder = Path(HydraConfig.get().runtime.output_dir)

    def work(tree: dict[str, Any], here: Path) -> tuple[AppConfig, list[Metric]]:
        config = build(tree)
        return config, run(config, tree, here, err)

    if OmegaConf.is_missing(HydraConfig.get().job, "num"):
        with reported(), jobs.alone(folder):
            config, found = work(plain(composed), folder)
    else:  # a job of a sweep
        result = jobs.carry_out(folder, composed, HydraConfig.get().overrides.task, work)
        if result is None:
            return
        config, found = result
    what = config.capture or HydraConfig.get().runtime.choices["experiment"]
    print_table(out, f"{what}, {config.estimator or config.method}, seed {config.seed}", found)
    shown = os.path.relpath(folder) if folder.is_relative_to(Path.cwd()) else folder
    for name in RESULTS:
        if (folder / name).exists():
            out.print(f"{shown}/{name}", highlight=False, soft_wrap=True)


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    command: Callable[[], object] = _job
    sys.argv[1:] = flags_first(sys.argv[1:])
    return guard(command)


if __name__ == "__main__":
    sys.exit(main())
