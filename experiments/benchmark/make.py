"""Shoots the captures of a split, as jobs of a sweep: only what is missing, on whatever launcher is chosen.

    python -m experiments.benchmark make split=mini
    python -m experiments.benchmark make split=dev hydra/launcher=joblib hydra.launcher.n_jobs=2

leaves in outputs/benchmark/RELEASE/SPLIT

    footage/NAME    a capture folder (docs/capture.md): what every method is given
    given/NAME      cameras.csv, masks/ and panorama/: what some tracks are given besides
    truth/NAME      what `pzcap-score` scores against
    jobs/NAME       what the methods of this tree are run on, the simulator's own truth in it
    manifest.json   hashes

and says whether the footage is that of the release. The truth is in a folder of its own, to be handed out or not.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import hydra
import numpy as np
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from experiments import bound, footage
from experiments.benchmark.fingerprint import Fingerprint, compared, fingerprint, write_manifest
from experiments.benchmark.release import FOLDER, BenchmarkCapture, ReleaseConfig, captures_of, read_release, split_of
from experiments.config import AppConfig, default_tree, structured
from experiments.estimators import unfound
from experiments.plain_truth import keyframes_of, true_capture
from experiments.progress import Bars
from experiments.run import CONF
from experiments.score import no_report, true_bounds
from experiments.studies import jobs
from experiments.terminal import terminal
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.camera_set import calibrate_camera, calibrate_cameras
from pzcap.events import CameraCalibrated
from pzcap.io import results
from pzcap.io.capture import MANIFEST, read_capture
from pzcap.runtime import one_thread_each
from pzcap.scoring import files
from pzcap.scoring.tables import write_table
from pzcap.scoring.truth_files import write_truth
from pzcap.types import Capture, PzcapError, Reconstruction
from sim import truth as truth_files
from sim.truth import Truth

OUT: Final = Path("outputs/benchmark")
HANDED: Final = ("capture", "given", "plain_truth")
"""Folders of a job, and where each is handed out: footage, given, truth."""
PLACES: Final = ("footage", "given", "truth")
CONFIG: Final = "config.json"
"""Configuration of a job, in its folder."""


@dataclass(frozen=True, slots=True)
class BenchmarkConfig(AppConfig):
    """Everything that a capture of the benchmark can be told: what a run can, and this."""

    name: str = ""
    """Of the capture."""
    without_keyframes: bool = False
    """No pose is given."""
    gives_truth: bool = False
    """True cameras and masks are handed out."""


def make(release: str, split: str, arguments: Sequence[str], out: Path = OUT, freeze: bool = False) -> list[str]:
    """Shoot what is missing of a split; what differs from the frozen release, a line each.

    ``arguments`` are Hydra's. Raises AlreadyReported if a capture failed, PzcapError for what the user can mend.
    """
    path = Path(release) if release.endswith(".yaml") else FOLDER / f"{release}.yaml"
    config = read_release(path)
    captures = captures_of(config, split)
    folder = out / config.release / split
    _launch(config, split, captures, folder / "jobs", arguments)
    found = {capture.name: _publish(folder, capture.name) for capture in captures}
    write_manifest(folder / "manifest.json", config.release, split, found)
    _describe(folder / "captures.json", config, split, captures)
    frozen = path.with_name(f"{config.release}-{split}.json")
    if freeze:
        write_manifest(frozen, config.release, split, found)
    how, lines = compared(found, frozen)
    terminal(stderr=True).print(f"{folder}: {len(captures)} captures, {how}", highlight=False, soft_wrap=True)
    return lines


def _launch(
    config: ReleaseConfig, split: str, captures: Sequence[BenchmarkCapture], folder: Path, arguments: Sequence[str]
) -> None:
    gives_truth = f"gives_truth={str(split_of(config, split).gives_truth).lower()}"
    listed = [
        [*capture.overrides, f"name={capture.name}", gives_truth, f"hydra.sweep.subdir={capture.name}"]
        for capture in captures
    ]
    store = ConfigStore.instance()
    store.store(name="benchmark_base", node=default_tree(BenchmarkConfig))
    store.store(name="benchmark", node={
        "defaults": [
            "benchmark_base", {"experiment": "floor_exercise"}, "_self_", {"override hydra/job_logging": "none"},
            {"override hydra/hydra_logging": "none"}, {"override hydra/sweeper": "resuming"},
        ],
        "shoot": {"seed": "${seed}"},
        "hydra": {"sweep": {"dir": str(folder)}, "sweeper": {"listed": listed}},
    })  # fmt: skip
    before = sys.argv
    sys.argv = [before[0], "--multirun", *arguments]
    try:
        _job()
    finally:
        sys.argv = before


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="benchmark")
def _job(composed: DictConfig) -> None:
    aside = HydraConfig.get().runtime.choices["hydra/launcher"] != "basic"
    console = terminal(stderr=True, quiet=aside)
    work = partial(shoot, console=console)
    jobs.carry_out(Path(HydraConfig.get().runtime.output_dir), composed, HydraConfig.get().overrides.task, work)


def shoot(tree: dict[str, Any], folder: Path, console: Console) -> None:
    """One capture, all that is handed out of it, and what is not, into ``folder``."""
    config = structured(tree, BenchmarkConfig, "configuration")
    _write_json(folder / CONFIG, tree)
    with Bars(console) as bars:
        shot = footage.shot(config.shoot, Path(config.output.captures), bars.update, config.output.light_gb)
    for name in ("capture", "truth"):
        shutil.copytree(shot / name, folder / name)
    if config.without_keyframes:
        _forget_keyframes(folder / "capture")
    _rename(folder / "capture", config.name)
    capture, truth = read_capture(folder / "capture"), truth_files.load(folder / "truth")
    with Bars(console) as bars:
        calibrated = _calibrated(capture, config, bars)
    frames = np.arange(len(truth.timecodes))
    least = bound.bounds(calibrated, truth, frames, no_report)
    bounds = true_bounds(least, calibrated, truth, (frames, np.ones(len(frames), bool)))
    keyframes = keyframes_of(list(capture.keyframe_poses), truth)
    write_truth(true_capture(truth, config.name, keyframes, bounds), folder / "plain_truth")
    results.save(calibrated, folder / "given" / "panorama")
    if config.gives_truth:
        _give_truth(truth, folder / "given")


def _forget_keyframes(capture: Path) -> None:
    manifest = json.loads((capture / MANIFEST).read_text(encoding="utf-8"))
    if manifest["keyframes"]:
        (capture / manifest["keyframes"]).unlink()
    _write_json(capture / MANIFEST, manifest | {"keyframes": None})


def _rename(capture: Path, name: str) -> None:
    manifest = json.loads((capture / MANIFEST).read_text(encoding="utf-8"))
    _write_json(capture / MANIFEST, manifest | {"name": name})


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _calibrated(capture: Capture, config: AppConfig, bars: Bars) -> Reconstruction:
    """Our calibration of the cameras and their panoramas, and nothing of the motion."""
    found: list[CalibratedCamera | None] = [None] * len(capture.cameras)
    notes: list[str] = []
    one = partial(calibrate_camera, config=config.reconstruct.panzoom)
    threads = config.reconstruct.threads
    with one_thread_each(), ThreadPoolExecutor(threads) as pool:
        for event in calibrate_cameras(capture, one, pool, notes):
            if isinstance(event, CameraCalibrated):
                found[event.index] = event.calibrated
            else:
                bars.update(event.stage, event.done, event.total)
    return replace(
        unfound(capture, "exact"),
        references=tuple(None if one is None else one.reference for one in found),
        cameras=tuple(None if one is None else one.camera for one in found),
        panoramas=tuple(None if one is None else one.panorama for one in found),
        notes=tuple(notes),
    )


def _give_truth(truth: Truth, folder: Path) -> None:
    """True cameras as a perfect method would write them, and the silhouettes as pictures of black and white."""
    tracks = {name: camera.track for name, camera in zip(truth.camera_names, true_capture(truth).cameras, strict=True)}
    write_table(folder / files.CAMERAS, ("camera", *files.CAMERA_COLUMNS), files.camera_rows(tracks))
    for camera, name in enumerate(truth.camera_names):
        place = folder / "masks" / name
        place.mkdir(parents=True)
        for frame in range(len(truth.timecodes)):
            picture = np.where(truth.mask(camera, frame), np.uint8(255), np.uint8(0))
            written = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_BILEVEL, 1])[1]
            (place / f"{frame:06d}.png").write_bytes(bytes(written))


def _publish(folder: Path, name: str) -> Fingerprint:
    """Put what is handed out of a job where it is handed out, and return the footage's fingerprint."""
    job = folder / "jobs" / name
    for part, place in zip(HANDED, PLACES, strict=True):
        target = folder / place / name
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(job / part, target, copy_function=_linked)
    return fingerprint(folder / "footage" / name)


def _linked(source: str, target: str) -> str:
    """The same file in two places where the disk can have it so, else a copy."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
    return target


def _describe(path: Path, config: ReleaseConfig, split: str, captures: Sequence[BenchmarkCapture]) -> None:
    """Value of each axis that each capture has: for the board, and for whoever reads the split."""
    _write_json(
        path,
        {
            "release": config.release,
            "split": split,
            "axes": {axis: list(values) for axis, values in config.axes.items()},
            "units": config.units,
            "base": config.base,
            "captures": {one.name: {"seed": one.seed, **one.values} for one in captures},
        },
    )


def described(folder: Path) -> dict[str, Any]:
    """Manifest of a split as `make` wrote it. Raises PzcapError where it has not been made."""
    try:
        content: dict[str, Any] = json.loads((folder / "captures.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        command = f"python -m experiments.benchmark make split={folder.name}"
        raise PzcapError(f"{folder}: no split of the benchmark; make it first, {command}") from error
    return content
