"""Errors of a reconstruction against the truth, frame by frame. `experiments.totals` sums them up to metrics.

What files can say is scored by `pzcap.scoring`, which scores files too; here stands what only a reconstruction knows:
reference pose, panorama, bound, silhouettes. Nothing is aligned before it is compared, except where a metric's name
says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments import bound
from experiments.plain_truth import true_capture
from experiments.silhouette_score import ForegroundErrors
from pzcap.export.tables import body_track, camera_track, results_of
from pzcap.geometry import camera as geometry
from pzcap.scoring import body_errors as scoring_body
from pzcap.scoring import camera_errors as scoring_cameras
from pzcap.scoring import score as scoring
from pzcap.scoring.body_errors import BodyErrors
from pzcap.scoring.records import Series, TrueCapture, by_timecode, within
from pzcap.types import Array, Mask, Motion, Panorama, PzcapError, Reconstruction
from sim.truth import Truth


@dataclass(frozen=True, slots=True, eq=False)
class CameraErrors(scoring_cameras.CameraErrors):
    """Errors of one camera. None where the stage did not run."""

    refined_pan_rad: Series | None = None  # estimated minus true, after camera refinement
    refined_focal: Series | None = None  # estimated over true, minus 1, after camera refinement
    sweep_pan_rad: Array | None = None  # (M,) a frame of the sweep, one common offset removed
    position_m: float | None = None  # distance of the reference camera's centre from the true one
    reference_px: float | None = None  # RMS residual of the calibration object
    readout_s: float | None = None  # estimated minus true
    clock_s: float | None = None  # estimated minus true in the middle of the take; what all cameras share is nobody's


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Errors of a reconstruction."""

    truth_frames: NDArray[np.int64]  # (F,) index into the truth of each frame set
    cameras: tuple[CameraErrors, ...]
    foreground: tuple[ForegroundErrors, ...] | None
    body: BodyErrors | None
    plain: scoring.Errors  # what files alone would give
    lost: int | None  # recorded views without a valid estimate; None: the body alone was estimated
    own_world: bool = False  # no calibration object: nothing but what is aligned can be compared


def no_report(_done: int, _total: int) -> None:
    """Ignore the progress."""


def score(
    reconstruction: Reconstruction,
    truth: Truth,
    foreground: tuple[ForegroundErrors, ...] | None,
    report: Callable[[int, int], None] = no_report,
) -> Score:
    """Compare ``reconstruction`` with ``truth``, frame by frame through their timecodes.

    Frame sets whose timecode the truth does not know are not scored; ``truth_frames`` has the nearest frame there.
    ``report(done, total)`` is called for every view whose bound is computed. Raises PzcapError if the truth is of
    another capture: it lacks a camera or all timecodes.
    """
    frames, known = frames_of(truth, reconstruction)
    bounds = true_bounds(bound.bounds(reconstruction, truth, frames, report), reconstruction, truth, (frames, known))
    plain_truth = true_capture(truth, bounds=bounds)
    plain = scoring.score(results_of(reconstruction), plain_truth)
    cameras = tuple(
        _with_calibration(errors, reconstruction, number, truth, plain_truth, (frames, known))
        for number, errors in enumerate(plain.cameras)
    )
    seen = [one for one in reconstruction.references if one is not None]
    own_world = bool(seen) and not any(len(one.points_m) for one in seen)
    return Score(frames, cameras, foreground, plain.body, plain, plain.lost, own_world)


def frames_of(truth: Truth, reconstruction: Reconstruction) -> tuple[NDArray[np.int64], Mask]:
    """Index into the truth of each frame set (F,), or of the nearest, and which frame sets the truth knows (F,).

    Raises PzcapError if the truth is of another capture: it lacks a camera or all timecodes.
    """
    frames, known = by_timecode(reconstruction.timecodes, truth.timecodes)
    unknown = [name for name in reconstruction.camera_names if name not in truth.camera_names]
    if unknown:
        raise PzcapError(f"the truth beside the capture knows no '{unknown[0]}'; it is of another capture, remove it")
    return frames, known


def body_errors(motion: Motion, truth: Truth, frames: NDArray[np.int64]) -> BodyErrors:
    """Compare a motion with the truth in its ``frames`` (F,), as of `frames_of`."""
    return scoring_body.body_errors(body_track(motion), true_capture(truth), frames, np.ones(len(frames), bool))


def true_bounds(
    least: Sequence[bound.Bound | None],
    reconstruction: Reconstruction,
    truth: Truth,
    matched: tuple[NDArray[np.int64], Mask],
) -> list[tuple[Series, Series] | None]:
    """Bounds a camera of ``reconstruction``, by the frames of the truth and a camera of the truth."""
    frames, known = matched
    found: list[tuple[Series, Series] | None] = [None] * len(truth.camera_names)
    for name, one in zip(reconstruction.camera_names, least, strict=True):
        if one is not None:
            found[truth.camera_names.index(name)] = (
                _scattered(one.pan_rad, frames, known, len(truth.timecodes)),
                _scattered(one.log_focal, frames, known, len(truth.timecodes)),
            )
    return found


def _scattered(series: Series, frames: NDArray[np.int64], known: Mask, count: int) -> Series:
    values, valid = np.zeros(count), np.zeros(count, bool)
    values[frames[known]], valid[frames[known]] = series.values[known], series.valid[known]
    return Series(values, valid)


def _with_calibration(
    errors: scoring_cameras.CameraErrors,
    reconstruction: Reconstruction,
    number: int,
    truth: Truth,
    plain_truth: TrueCapture,
    matched: tuple[NDArray[np.int64], Mask],
) -> CameraErrors:
    """``errors`` with those of what was found out before the motion, and of what the body has corrected since."""
    found: dict[str, Any] = {field.name: getattr(errors, field.name) for field in fields(errors)}
    frames, known = matched
    true = truth.camera_names.index(reconstruction.camera_names[number])
    reference, panorama = reconstruction.references[number], reconstruction.panoramas[number]
    if reference is not None and len(reference.points_m):
        offset = reference.camera.world_T_cam[:3, 3] - truth.reference_world_T_cam[true, :3, 3]
        found["position_m"] = float(np.linalg.norm(offset))
        found["reference_px"] = float(np.sqrt(np.mean(np.sum(reference.residuals_px**2, axis=1))))
    if panorama is not None:
        found["sweep_pan_rad"] = sweep_errors(panorama, truth, true)
    head = reconstruction.cameras[number]
    if head is not None and reconstruction.motion is not None:
        middle_s = float(frames[known].mean() / truth.frame_rate)
        found["readout_s"] = head.readout_s - float(truth.readout_s[true])
        found["clock_s"] = head.clock_s - float(truth.clock_offset_s[true] + truth.clock_drift[true] * middle_s)
    refined, there = reconstruction.refined[number], plain_truth.cameras[true]
    if refined is not None:
        track = within(camera_track(refined, None), known)
        found["refined_pan_rad"], found["refined_focal"] = scoring_cameras.pan_and_focal(track, there, frames)
    if errors.pan_bound_rad is None and there.pan_bound_rad is not None and there.focal_bound is not None:
        for name, one in (("pan_bound_rad", there.pan_bound_rad), ("focal_bound", there.focal_bound)):
            found[name] = Series(one.values[frames], one.valid[frames] & known)
    return CameraErrors(**found)


def sweep_errors(panorama: Panorama, truth: Truth, true: int) -> Array:
    """Errors of pan (M,) of the sweep's frames that were used, rad, one common offset removed.

    Where some were left out, nobody has noted which: the true frame is the one that stands nearest, frames being a
    thousand times further apart than their errors.
    """
    frames = truth.sweep_pan_rad[true]
    if len(panorama.sweep_pan_rad) != len(frames):
        frames = frames[np.abs(geometry.wrapped(panorama.sweep_pan_rad[:, None] - frames)).argmin(axis=1)]
    sweep = geometry.wrapped(panorama.sweep_pan_rad - frames)
    return geometry.wrapped(sweep - np.angle(np.mean(np.exp(1j * sweep))))
