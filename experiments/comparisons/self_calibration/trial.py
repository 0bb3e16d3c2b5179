"""Every method on the same frames, and its errors."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.comparisons.self_calibration.baselines import (
    Frames,
    Library,
    Pair,
    Shots,
    ZoomModel,
    link,
    shum_szeliski,
    sinha_pollefeys,
    wu_radke,
)
from experiments.comparisons.self_calibration.material import Footage, hall_footage, motion_footage, shots_of
from experiments.config import AppConfig
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.camera_set import calibrate_camera, footage_of
from pzcap.geometry.camera import of_frame
from pzcap.localisation import localise
from pzcap.progress import Report
from pzcap.types import Array, Capture, Mask, PzcapError
from sim.truth import Truth

FAILED_FOCAL, FAILED_PAN_RAD = 0.05, np.deg2rad(1.0)
LEAST_FRAMES = 5  # of a camera: the common rotation would suit fewer by itself
METHODS: Final = ("ours", "shum_szeliski", "sinha_pollefeys", "wu_radke")
CONDITIONS: Final = ("empty", "athlete", "masked")


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """A method's errors on some frames of one camera; meaningless where ``failed``."""

    focal: Array  # (F,) relative
    pan_rad: Array  # (F,) after removing one common rotation
    principal_px: Array  # (F,) distance
    k1: Array  # (F,) absolute
    failed: Mask  # (F,)
    seconds: float


def errors_of(found: Frames, true: Frames, seconds: float) -> Errors:
    """Compare after the common rotation that suits most frames best."""
    focal = found.focal_px / true.focal_px - 1.0
    good = found.valid & (np.abs(focal) < FAILED_FOCAL)
    pan = np.full(len(good), np.inf)
    for _ in range(2):  # once more without what the first shows to be far off
        if good.sum() < LEAST_FRAMES:
            break
        turns = true.rotation[good] @ found.rotation[good].transpose(0, 2, 1)
        common = Rotation.from_matrix(turns).mean().as_matrix()
        apart = (common @ found.rotation) @ true.rotation.transpose(0, 2, 1)
        pan = np.abs(Rotation.from_matrix(apart).as_rotvec()[:, 2])  # about the world's vertical
        good &= pan < FAILED_PAN_RAD
    if good.sum() < LEAST_FRAMES:
        good[:] = False
    principal = np.hypot(*(found.lens[:, 1:3] - true.lens[:, 1:3]).T)
    return Errors(np.abs(focal), pan, principal, np.abs(found.lens[:, 3] - true.lens[:, 3]), ~good, seconds)


def ours(prepared: CalibratedCamera, config: AppConfig, footage: Footage, masked: bool) -> Frames:
    """Pan and zoom of the frames on the panorama of the empty hall.

    Twice, since ours starts from the frame before, as a rule a thirtieth of a second off, and that is left out here.
    """
    localiser = localise.Localiser(prepared.panorama, prepared.camera, config.reconstruct.panzoom)
    rotation, lens, valid = [], [], []
    last = None
    for image, mask in zip(footage.images, footage.masks, strict=True):
        shown = image
        if masked and mask is not None:
            shown = np.asarray(cv2.inpaint(image, mask.astype(np.uint8), 3, cv2.INPAINT_TELEA), np.uint8)
        found = localiser.localise(shown, last)
        found = localiser.localise(shown, found) if found.valid else found
        last = found if found.valid else None
        camera = of_frame(prepared.camera, found)
        rotation.append(camera.world_T_cam[:3, :3])
        lens.append([np.log(camera.focal_px), *camera.principal_px, camera.k1])
        valid.append(found.valid)
    return Frames(np.array(rotation), np.array(lens), np.array(valid))


def corrected(hall: Shots, calibrated: Frames, model: ZoomModel, filmed: Shots) -> Frames:
    """Wu and Radke's frames, one after the other, by a library made of those of the hall."""
    library = Library(hall, calibrated, model)
    rotation, lens, valid = zip(*(library.locate(each) for each in filmed.found), strict=True)
    return Frames(np.array(rotation), np.array(lens), np.array(valid))


def compare(
    capture: Capture, truth: Truth, config: AppConfig, report_step: Report
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

    steps = itertools.count(1)
    for files, motion in zip(capture.cameras, motions, strict=True):
        if files.sweep is None or files.zoom is None or files.reference is None or capture.calibration_object is None:
            raise PzcapError(
                f"camera {files.name}: the comparison needs its reference image, sweep, zoom run and the object"
            )
        hall, sweep = hall_footage(files, truth, truth.camera_names.index(files.name))

        started = time.perf_counter()
        prepared = calibrate_camera(footage_of(capture, files), config.reconstruct.panzoom)
        spent = time.perf_counter() - started
        for condition, shown in (("empty", hall), ("athlete", motion), ("masked", motion)):
            work = partial(ours, prepared, config, shown, condition == "masked")
            timed("ours", condition, shown.true, work, spent)
        report_step(f"camera {files.name}: compare", next(steps), total)

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
        report_step(f"camera {files.name}: compare", next(steps), total)

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
            report_step(f"camera {files.name}: compare", next(steps), total)
    return result


def _mosaic(method: Callable[[Shots, Sequence[Pair]], Frames], shots: Shots, pairs: Sequence[Pair]) -> Frames:
    if not pairs:
        raise PzcapError("self-calibration: no three frames show the same")
    return method(shots, pairs)
