"""Ours against self-calibration after Shum and Szeliski, Sinha and Pollefeys, and Wu and Radke, on the same captures.

    python -m experiments.self_calibration seed=0 hydra.run.dir=DIR      # conf/experiment/self_calibration.yaml
    python -m experiments.self_calibration capture=FOLDER                # with truth/ beside it

prints a table and leaves DIR/{metrics.json, self_calibration.png}. Three sets of frames of each camera:

empty    some of the sweep and the zoom run: nobody in the hall. All methods calibrate from these frames alone, but for
         ours, which has the whole sweep and the image of the calibration object, too.
athlete  some of the motion, as it was filmed. The mosaic methods calibrate from these frames alone; ours and Wu and
         Radke's find them by what they learnt from the empty hall.
masked   the same frames without the athlete: no features where the true masks, 6 px wider, have him. (Ours is given
         the frames with that part painted over.)

Self-calibration knows no reference pose: rotations, of all methods alike, are compared after the one rotation a camera
that brings them all nearest to the truth. A frame fails where it is not linked or found, its focal length is off by
more than 5 %, or its pan by more than a degree, or fewer than five of its camera's are left; medians are over the
others.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from experiments import footage
from experiments.command import command
from experiments.config import AppConfig
from experiments.metrics import Metric, run_info, write_metrics
from experiments.plots import COLOURS, STYLE
from experiments.progress import Bars
from pzcap import features, panzoom
from pzcap.calibration import Prepared, prepare
from pzcap.camera import at
from pzcap.capture import frame_sets, read_capture, read_image
from pzcap.rotations import Frames, Pair
from pzcap.selfcalibration import Library, Shots, ZoomModel, link, shum_szeliski, sinha_pollefeys, wu_radke
from pzcap.sweep import grey
from pzcap.types import Array, CameraFiles, Capture, Image, Mask, PzcapError
from pzcap.video import VideoReader
from sim.truth import Truth

SWEEP_EVERY, ZOOM_EVERY, MOTION_EVERY = 6, 2, 7
FEATURES, THRESHOLD = 800, 2e-4
MASK_MARGIN_PX = 6
FAILED_FOCAL, FAILED_PAN_RAD = 0.05, np.deg2rad(1.0)
LEAST_FRAMES = 5  # of a camera: the common rotation would suit fewer by itself
METHODS: Final = ("ours", "shum_szeliski", "sinha_pollefeys", "wu_radke")
NAMES: Final = {
    "ours": "ours", "shum_szeliski": "Shum-Szeliski", "sinha_pollefeys": "Sinha-Pollefeys", "wu_radke": "Wu-Radke"
}  # fmt: skip
CONDITIONS: Final = ("empty", "athlete", "masked")
PLOT: Final = "self_calibration.png"


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """A method's errors on some frames of one camera; meaningless where ``failed``."""

    focal: Array  # (F,) relative
    pan_rad: Array  # (F,) after removing one common rotation
    principal_px: Array  # (F,) distance
    k1: Array  # (F,) absolute
    failed: Mask  # (F,)
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """Frames of one camera, and how they were truly taken."""

    images: tuple[Image, ...]
    masks: tuple[Mask | None, ...]  # what is to be left out
    true: Frames


def errors_of(found: Frames, true: Frames, seconds: float) -> Errors:
    """Compare after the common rotation that suits most frames best."""
    focal = found.focal_px / true.focal_px - 1.0
    good = found.valid & (np.abs(focal) < FAILED_FOCAL)
    pan = np.full(len(good), np.inf)
    for _ in range(2):  # once more without what the first shows to be far off
        if good.sum() < LEAST_FRAMES:
            break
        u, _, vt = np.linalg.svd(np.einsum("fij,fkj->ik", true.rotation[good], found.rotation[good]))
        common = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        apart = (common @ found.rotation) @ true.rotation.transpose(0, 2, 1)
        pan = np.abs(Rotation.from_matrix(apart).as_rotvec()[:, 2])  # about the world's vertical
        good &= pan < FAILED_PAN_RAD
    if good.sum() < LEAST_FRAMES:
        good[:] = False
    principal = np.hypot(*(found.lens[:, 1:3] - true.lens[:, 1:3]).T)
    return Errors(np.abs(focal), pan, principal, np.abs(found.lens[:, 3] - true.lens[:, 3]), ~good, seconds)


# --------------------------------------------------------------------------------------------------------------
# Footage and truth


def hall_footage(files: CameraFiles, truth: Truth, camera: int) -> tuple[Footage, int]:
    """Frames of the sweep, then of the zoom run; and how many are of the sweep."""
    assert files.sweep is not None
    assert files.zoom is not None
    images, rotations, focals = [], [], []
    reference = truth.reference_world_T_cam[camera, :3, :3]
    middle = int(np.argmax(np.abs(truth.sweep_pan_rad[camera]) % np.pi > 1.0))
    turned = Rotation.from_matrix(truth.sweep_world_T_cam[camera, middle, :3, :3] @ reference.T).as_rotvec()
    axis = turned / np.linalg.norm(turned) * np.sign(np.sin(truth.sweep_pan_rad[camera, middle]))
    for number, (_, image) in enumerate(VideoReader(files.sweep)):
        if number % SWEEP_EVERY == 0:
            images.append(image)
            rotations.append(truth.sweep_world_T_cam[camera, number, :3, :3])
            focals.append(truth.reference_focal_px[camera])
    count = len(images)
    zoomed = Rotation.from_rotvec(axis * truth.zoom_pan_rad[camera]).as_matrix() @ reference
    for number, (_, image) in enumerate(VideoReader(files.zoom)):
        if number % ZOOM_EVERY == 0:
            images.append(image)
            rotations.append(zoomed)
            focals.append(truth.zoom_focal_px[camera, number])
    return Footage(tuple(images), (None,) * len(images), _true(truth, camera, rotations, focals)), count


def motion_footage(capture: Capture, truth: Truth) -> list[Footage]:
    """Frames of the motion of each camera, and the true masks."""
    sets = frame_sets(capture)
    every = max(1, min(MOTION_EVERY, len(truth.timecodes) // 8))
    taken: list[list[tuple[Image, int]]] = [[] for _ in capture.cameras]
    for frames in sets:
        if frames.index % every == 0 and frames.timecode in truth.timecodes:
            at_frame = truth.timecodes.index(frames.timecode)
            for row, image in zip(taken, frames.images, strict=True):
                if image is not None:
                    row.append((image, at_frame))
    result = []
    kernel = np.ones((2 * MASK_MARGIN_PX + 1,) * 2, np.uint8)
    for files, row in zip(capture.cameras, taken, strict=True):
        camera = truth.camera_names.index(files.name)
        indices = [frame for _, frame in row]
        masks = [cv2.dilate(truth.mask(camera, frame).astype(np.uint8), kernel) > 0 for frame in indices]
        true = _true(
            truth, camera, list(truth.world_T_cam[camera, indices, :3, :3]), list(truth.focal_px[camera, indices])
        )
        result.append(Footage(tuple(image for image, _ in row), tuple(masks), true))
    return result


def _true(truth: Truth, camera: int, rotations: Sequence[Array], focals: Sequence[float]) -> Frames:
    """k1 is linear in log focal; its line is drawn through the motion's frames and the reference."""
    logs = np.append(np.log(truth.focal_px[camera]), np.log(truth.reference_focal_px[camera]))
    line = np.polyfit(logs, np.append(truth.k1[camera], truth.reference_k1[camera]), 1)
    log_focal = np.log(np.array(focals))
    principal = np.tile(truth.reference_principal_px[camera], (len(log_focal), 1))
    lens = np.column_stack([log_focal, principal, np.polyval(line, log_focal)])
    return Frames(np.array(rotations), lens, np.ones(len(lens), bool))


def shots_of(footage: Footage, masked: bool, sweep: int = 0, full_turn: bool = False) -> Shots:
    """The features of the frames, of which the first ``sweep`` pan in order and the others, if any pan, zoom."""
    found = []
    for image, mask in zip(footage.images, footage.masks, strict=True):
        allowed = None if mask is None or not masked else np.where(mask, 0, 255).astype(np.uint8)
        found.append(features.detect(grey(image), THRESHOLD, FEATURES, allowed))
    height, width = footage.images[0].shape[:2]
    zoom = tuple(range(sweep, len(found))) if sweep else ()
    return Shots(tuple(found), width, height, tuple(range(sweep)), full_turn and sweep > 0, zoom)


# --------------------------------------------------------------------------------------------------------------
# The methods


def ours(prepared: Prepared, config: AppConfig, footage: Footage, masked: bool) -> Frames:
    """Pan and zoom of the frames on the panorama of the empty hall.

    Twice, since ours starts from the frame before, as a rule a thirtieth of a second off, and that is left out here.
    """
    localiser = panzoom.Localiser(prepared.panorama, prepared.camera, config.reconstruct.panzoom)
    rotation, lens, valid = [], [], []
    last = None
    for image, mask in zip(footage.images, footage.masks, strict=True):
        shown = image
        if masked and mask is not None:
            shown = np.asarray(cv2.inpaint(image, mask.astype(np.uint8), 3, cv2.INPAINT_TELEA), np.uint8)
        found = localiser.localise(shown, last)
        found = localiser.localise(shown, found) if found.valid else found
        last = found if found.valid else None
        camera = at(prepared.camera, found.pan_rad, found.tilt_rad, found.focal_px)
        rotation.append(camera.world_T_cam[:3, :3])
        lens.append([np.log(camera.focal_px), *camera.principal_px, camera.k1])
        valid.append(found.valid)
    return Frames(np.array(rotation), np.array(lens), np.array(valid))


def corrected(hall: Shots, calibrated: Frames, model: ZoomModel, filmed: Shots) -> Frames:
    """Wu and Radke's frames, one after the other, by a library made of those of the hall."""
    library = Library(hall, calibrated, model)
    located = [library.locate(each) for each in filmed.found]
    return Frames(
        np.array([rotation for rotation, _, _ in located]),
        np.array([lens for _, lens, _ in located]),
        np.array([valid for _, _, valid in located]),
    )


def compare(
    capture: Capture, truth: Truth, config: AppConfig, report_step: Callable[[str, int, int], None]
) -> dict[tuple[str, str], list[Errors]]:
    """(method, condition) -> errors a camera."""
    result: dict[tuple[str, str], list[Errors]] = {(m, c): [] for m in METHODS for c in CONDITIONS}
    motions = motion_footage(capture, truth)
    total = len(capture.cameras) * len(METHODS)

    def timed(method: str, condition: str, true: Frames, work: Callable[[], Frames], before_s: float = 0.0) -> None:
        started = time.perf_counter()
        try:
            found = work()
        except PzcapError:
            found = Frames(np.tile(np.eye(3), (len(true.valid), 1, 1)), true.lens, np.zeros(len(true.valid), bool))
        result[method, condition].append(errors_of(found, true, before_s + time.perf_counter() - started))

    done = 0
    for files, motion in zip(capture.cameras, motions, strict=True):
        if files.sweep is None or files.zoom is None or files.reference is None or capture.calibration_object is None:
            raise PzcapError(
                f"camera {files.name}: the comparison needs its reference image, sweep, zoom run and the object"
            )
        hall, sweep = hall_footage(files, truth, truth.camera_names.index(files.name))

        started = time.perf_counter()
        prepared = prepare(
            read_image(files.reference), capture.calibration_object, VideoReader(files.sweep), VideoReader(files.zoom),
            capture.full_turn, config.reconstruct.panzoom,
        )  # fmt: skip
        spent = time.perf_counter() - started
        for condition, shown in (("empty", hall), ("athlete", motion), ("masked", motion)):
            work = partial(ours, prepared, config, shown, condition == "masked")
            timed("ours", condition, shown.true, work, spent)
        done += 1
        report_step(f"camera {files.name}: compare", done, total)

        shots = shots_of(hall, False, sweep, capture.full_turn)
        started = time.perf_counter()
        pairs = link(shots)
        spent = time.perf_counter() - started
        timed("shum_szeliski", "empty", hall.true, partial(shum_szeliski, shots, pairs), spent)
        timed("sinha_pollefeys", "empty", hall.true, partial(sinha_pollefeys, shots, pairs), spent)
        started = time.perf_counter()
        calibrated, model = wu_radke(shots, pairs)
        spent += time.perf_counter() - started
        result["wu_radke", "empty"].append(errors_of(calibrated, hall.true, spent))
        done += 1
        report_step(f"camera {files.name}: compare", done, total)

        for condition in ("athlete", "masked"):
            filmed = shots_of(motion, condition == "masked")
            timed("wu_radke", condition, motion.true, partial(corrected, shots, calibrated, model, filmed), spent)
            started = time.perf_counter()
            try:
                linked = link(filmed)
            except PzcapError:
                linked = []
            matching = time.perf_counter() - started
            for method, mosaic in (("shum_szeliski", shum_szeliski), ("sinha_pollefeys", sinha_pollefeys)):
                timed(method, condition, motion.true, partial(_mosaic, mosaic, filmed, linked), matching)
            done += 1
            report_step(f"camera {files.name}: compare", done, total)
    return result


def _mosaic(method: Callable[[Shots, Sequence[Pair]], Frames], shots: Shots, pairs: Sequence[Pair]) -> Frames:
    if not pairs:
        raise PzcapError("self-calibration: no three frames show the same")
    return method(shots, pairs)


# --------------------------------------------------------------------------------------------------------------
# What comes out


def metrics_of(result: dict[tuple[str, str], list[Errors]]) -> list[Metric]:
    """Medians over the frames of all cameras that did not fail; failures; seconds, all cameras together."""

    def rows() -> Iterator[Metric]:
        for (method, condition), cameras in result.items():
            key = f"selfcal.{method}.{condition}"
            good = [~each.failed for each in cameras]

            def median(name: str, cameras: list[Errors] = cameras, good: list[Mask] = good) -> float | None:
                values = np.concatenate([getattr(e, name)[g] for e, g in zip(cameras, good, strict=True)])
                return float(np.median(values)) if len(values) else None

            focal, pan = median("focal"), median("pan_rad")
            yield Metric(f"{key}.focal.median", None if focal is None else 100.0 * focal, "%")
            yield Metric(
                f"{key}.pan_after_common_rotation.median", None if pan is None else float(np.degrees(pan)), "deg"
            )
            yield Metric(f"{key}.principal.median", median("principal_px"), "px")
            yield Metric(f"{key}.k1.median", median("k1"), "1")
            yield Metric(f"{key}.failures", float(sum(each.failed.sum() for each in cameras)), "frames")
            yield Metric(f"{key}.frames", float(sum(len(each.failed) for each in cameras)), "frames", "higher")
            yield Metric(f"{key}.seconds", sum(each.seconds for each in cameras), "s")

    return list(rows())


def print_comparison(console: Console, title: str, found: Sequence[Metric]) -> None:
    """A row a method and set of frames."""
    by_key = {metric.key: metric.value for metric in found}
    table = Table(title=title, title_justify="left", header_style="bold", box=box.SIMPLE, padding=(0, 0))
    for name in ("method", "frames"):
        table.add_column(name, no_wrap=True)
    for name in ("focal %", "pan deg*", "centre px", "k1", "failed", "s"):
        table.add_column(name, justify="right", no_wrap=True)
    for condition in CONDITIONS:
        for method in METHODS:
            key = f"selfcal.{method}.{condition}"
            values = [
                by_key[f"{key}.{name}"]
                for name in ("focal.median", "pan_after_common_rotation.median", "principal.median", "k1.median")
            ]
            failed, count, seconds = (by_key[f"{key}.{name}"] or 0.0 for name in ("failures", "frames", "seconds"))
            cells = ["–" if value is None else f"{value:.2g}" for value in values]
            table.add_row(NAMES[method], condition, *cells, f"{failed:.0f}/{count:.0f}", f"{seconds:.0f}")
        table.add_section()
    console.print(table)
    console.print("* one common rotation a camera removed; medians over the frames that did not fail")


def plot(path: Path, found: Sequence[Metric]) -> None:
    """Focal and pan error of each method and set of frames, and the share that failed."""
    by_key = {metric.key: metric.value for metric in found}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 3.4), dpi=140)
        panels = figure.subplots(1, 3)
        names = (("focal.median", "focal length [%]"), ("pan_after_common_rotation.median", "pan [deg], one common "
                 "rotation removed"), ("failures", "frames that failed [%]"))  # fmt: skip
        for axes, (name, label) in zip(panels, names, strict=True):
            for n, method in enumerate(METHODS):
                keys = [f"selfcal.{method}.{condition}" for condition in CONDITIONS]
                values = [by_key[f"{key}.{name}"] for key in keys]
                heights = [0.0 if value is None else value for value in values]
                if name == "failures":
                    heights = [
                        100.0 * h / max(by_key[f"{k}.frames"] or 1.0, 1.0) for h, k in zip(heights, keys, strict=True)
                    ]
                axes.bar(np.arange(3) + 0.2 * (n - 1.5), heights, 0.18, color=COLOURS[n], label=NAMES[method])
            axes.set_xticks(np.arange(3), CONDITIONS)
            axes.set_title(label)
            if name != "failures":
                axes.set_yscale("log")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        figure.savefig(path)


def run_comparison(config: AppConfig, tree: dict[str, Any], folder: Path, console: Console) -> list[Metric]:
    """Everything from the shoot to the plot, into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with Bars(console) as bars:
        shot = (
            footage.shoot(config, bars)
            if config.capture is None
            else footage.capture_in(Path(config.capture).resolve())
        )
    capture = read_capture(shot)
    truth = footage.truth_beside(shot)
    if truth is None:
        raise PzcapError(f"{shot}: a comparison needs the truth; give a capture with truth/ beside it, or none")
    with Bars(console) as bars:
        found = metrics_of(compare(capture, truth, config, bars.update))
    write_metrics(folder / "metrics.json", found, run_info(tree, config.seed))
    plot(folder / PLOT, found)
    return found


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return command("self_calibration", run_comparison, print_comparison)


if __name__ == "__main__":
    sys.exit(main())
