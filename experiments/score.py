"""The reconstruction against the truth: errors a frame, and the metrics they sum up to.

Nothing is aligned before it is compared, except where a metric's name says so. True cameras are projected here from the
truth's own numbers, so that a bug in `pzcap.camera` shows and does not cancel out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from experiments import bound
from experiments.metrics import Direction, Metric
from experiments.silhouettes import ForegroundErrors, Series
from pzcap import camera as camera_model
from pzcap.types import PARENTS, Array, Mask, Motion, Panorama, PanZoomCamera, PanZoomTrack, PzcapError, Reconstruction
from sim.truth import Truth

LOST_M: Final = 0.1
"""A joint further off than this is lost."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraErrors:
    """What is wrong with one camera. None where the stage did not run."""

    pan_rad: Series | None = None  # estimated minus true
    focal: Series | None = None  # the same, relative to the true focal length
    pan_sigma_rad: Series | None = None  # what the estimate itself believes
    focal_sigma: Series | None = None
    pan_bound_rad: Series | None = None  # the least standard deviation possible, from experiments.bound
    focal_bound: Series | None = None
    normalised: Array | None = None  # (F, 2) errors of pan and log focal, uncorrelated, in units of their own sigma
    nees: Series | None = None  # mean square of these two: 1 on average if the covariance is honest
    reprojection_px: Series | None = None  # RMS over the static scene points in the image
    reprojection_points_px: Array | None = None  # (N,) the same distances, of all frames
    sweep_pan_rad: Array | None = None  # (M,) a frame of the sweep, one common offset removed
    position_m: float | None = None  # distance of the reference camera's centre from the true one
    reference_px: float | None = None  # RMS residual of the calibration object


@dataclass(frozen=True, slots=True, eq=False)
class BodyErrors:
    joints_m: Array  # (F, 16) distance of each joint from the truth
    limbs: Array  # (15,) length of each limb, joint to joint, relative to the true one; empty where nothing is valid
    valid: Mask  # (F,) the tracker gave an estimate
    keyframe: Mask  # (F,) a person posed it: not scored
    inverted: Mask  # (F,) head below the pelvis
    airborne: Mask  # (F,) no contact with the floor

    @property
    def scored(self) -> Mask:
        return self.valid & ~self.keyframe


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Everything that can be said about a reconstruction with the truth at hand."""

    truth_frames: NDArray[np.int64]  # (F,) index into the truth of each frame set
    cameras: tuple[CameraErrors, ...]
    foreground: tuple[ForegroundErrors, ...] | None
    body: BodyErrors | None
    lost: int  # recorded views without a valid estimate


def no_report(_done: int, _total: int) -> None:
    """For whoever does not want to hear how far it is."""


def score(
    reconstruction: Reconstruction,
    truth: Truth,
    foreground: tuple[ForegroundErrors, ...] | None,
    report: Callable[[int, int], None] = no_report,
) -> Score:
    """Compare ``reconstruction`` with ``truth``, frame by frame through their timecodes.

    Where a recording that bounded the truth's range was not brought, frame sets lie beyond it: those are not scored,
    and stand at the truth's nearest frame. ``report(done, total)`` hears of every view whose bound is known. Raises
    PzcapError if the truth is of another capture: it lacks a camera or all timecodes.
    """
    frames, known = frames_of(truth, reconstruction)
    if not known.all():
        reconstruction = _within(reconstruction, known)
    least = bound.bounds(reconstruction, truth, frames, report)
    lost, cameras = 0, []
    for number, name in enumerate(reconstruction.camera_names):
        true, track = truth.camera_names.index(name), reconstruction.tracks[number]
        errors = _camera_errors(reconstruction, number, truth, true, frames)
        cameras.append(_with_bound(errors, least[number], known))
        found = np.zeros(len(frames), bool) if track is None else track.valid
        lost += int(np.sum(truth.recorded[true, frames] & known & ~found))  # a frame that was dropped is nobody's loss
    motion = reconstruction.motion
    body = None if motion is None else body_errors(motion, truth, frames)
    return Score(frames, tuple(cameras), foreground, body, lost)


def frames_of(truth: Truth, reconstruction: Reconstruction) -> tuple[NDArray[np.int64], Mask]:
    """Index into the truth of each frame set (F,), the nearest where it knows none, and whether it knows it (F,).

    Raises PzcapError if the truth is of another capture: it lacks a camera or all timecodes.
    """
    index = {timecode: frame for frame, timecode in enumerate(truth.timecodes)}
    known = np.array([timecode in index for timecode in reconstruction.timecodes], bool)
    unknown = [] if known.any() else [reconstruction.timecodes[0]]
    unknown += [name for name in reconstruction.camera_names if name not in truth.camera_names]
    if unknown:
        raise PzcapError(f"the truth beside the capture knows no '{unknown[0]}'; it is of another capture, remove it")
    first = int(np.argmax(known))
    frames = np.arange(len(known)) - first + index[reconstruction.timecodes[first]]
    return np.clip(frames, 0, len(index) - 1), known


def _within(reconstruction: Reconstruction, known: Mask) -> Reconstruction:
    """``reconstruction``, its estimates valid in the frame sets ``known`` (F,) alone."""
    motion = reconstruction.motion
    return replace(
        reconstruction,
        tracks=tuple(None if t is None else replace(t, valid=t.valid & known) for t in reconstruction.tracks),
        motion=None if motion is None else replace(motion, valid=motion.valid & known),
    )


# --------------------------------------------------------------------------------------------------------------
# Cameras


def project_true(
    world_T_cam: Array, focal_px: float, principal_px: Array, k1: float, points_m: Array
) -> tuple[Array, Mask]:
    """World points (N, 3) to pixels (N, 2), and which of them can be seen at all (N,).

    The lens of pzcap.types, written out a second time. With barrel distortion the radius grows to a largest value and
    then folds back: what lies beyond is never seen, though the formula puts it into the image.
    """
    cam = (np.linalg.inv(world_T_cam) @ np.column_stack([points_m, np.ones(len(points_m))]).T)[:3]
    x, y = cam[0] / cam[2], cam[1] / cam[2]
    squared = x * x + y * y
    factor = focal_px * (1.0 + k1 * squared)
    pixels = np.column_stack([principal_px[0] + factor * x, principal_px[1] + factor * y])
    return pixels, (cam[2] > 0.1) & (1.0 + 3.0 * k1 * squared > 0.0)


def _camera_errors(
    reconstruction: Reconstruction, number: int, truth: Truth, true: int, frames: NDArray[np.int64]
) -> CameraErrors:
    reference, panorama = reconstruction.references[number], reconstruction.panoramas[number]
    track, camera = reconstruction.tracks[number], reconstruction.cameras[number]
    found: dict[str, Any] = {}
    if reference is not None:
        offset = reference.camera.world_T_cam[:3, 3] - truth.reference_world_T_cam[true, :3, 3]
        found["position_m"] = float(np.linalg.norm(offset))
        found["reference_px"] = _rms(np.linalg.norm(reference.residuals_px, axis=1))
    if panorama is not None:
        found["sweep_pan_rad"] = sweep_errors(panorama, truth, true)
    if track is not None:
        pan = np.where(track.valid, _wrap(track.pan_rad - truth.pan_rad[true, frames]), 0.0)
        focal = np.where(track.valid, track.focal_px / truth.focal_px[true, frames] - 1.0, 0.0)
        found["pan_rad"], found["focal"] = Series(pan, track.valid), Series(focal, track.valid)
        found["pan_sigma_rad"] = Series(np.sqrt(np.maximum(track.covariance[:, 0, 0], 0.0)), track.valid)
        found["focal_sigma"] = Series(np.sqrt(np.maximum(track.covariance[:, 1, 1], 0.0)), track.valid)
        normalised, usable = _normalised(np.column_stack([pan, np.log1p(focal)]), track)
        if usable.any():
            found["normalised"], found["nees"] = normalised, Series(np.sum(normalised**2, axis=1) / 2, usable)
        if camera is not None:
            series, points = _reprojection(camera, track, truth, true, frames)
            found["reprojection_px"], found["reprojection_points_px"] = series, points
    return CameraErrors(**found)


def sweep_errors(panorama: Panorama, truth: Truth, true: int) -> Array | None:
    """(M,) pan of the sweep's frames against the truth, rad, one common offset removed; None of another sweep."""
    if len(panorama.sweep_pan_rad) != truth.sweep_pan_rad.shape[1]:
        return None
    sweep = _wrap(panorama.sweep_pan_rad - truth.sweep_pan_rad[true])
    return _wrap(sweep - np.angle(np.mean(np.exp(1j * sweep))))


def _wrap(angle: Array) -> Array:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _normalised(error: Array, track: PanZoomTrack) -> tuple[Array, Mask]:
    """Errors (F, 2) in units of their own covariance, uncorrelated; 0 where there is none (F,)."""
    usable = track.valid & (np.linalg.det(track.covariance) > 0.0)
    values = np.zeros(error.shape)
    values[usable] = np.linalg.solve(np.linalg.cholesky(track.covariance[usable]), error[usable][..., None])[..., 0]
    return values, usable


def _with_bound(errors: CameraErrors, least: bound.Bound | None, known: Mask) -> CameraErrors:
    """``errors`` and the bound beside them, in the frame sets ``known`` (F,) to the truth."""
    if least is None:
        return errors
    pan, focal = (Series(one.values.copy(), one.valid & known) for one in (least.pan_rad, least.log_focal))
    return replace(errors, pan_bound_rad=pan, focal_bound=focal)


def _reprojection(
    camera: PanZoomCamera, track: PanZoomTrack, truth: Truth, true: int, frames: NDArray[np.int64]
) -> tuple[Series, Array]:
    """RMS a frame, and all distances (N,), between where the two cameras see the points of the static scene.

    A distance counts no more than the image's diagonal: a camera that looks elsewhere is wrong, not infinitely so.
    """
    points_m = truth.scene_points_m[true]
    width, height = camera.lens.width, camera.lens.height
    diagonal = float(np.hypot(width, height))
    rms, valid, distances = np.zeros(len(frames)), np.zeros(len(frames), bool), []
    for frame in np.flatnonzero(track.valid):
        here = true, frames[frame]
        numbers = truth.world_T_cam[here], truth.focal_px[here], truth.principal_px[here], truth.k1[here]
        seen, inside = project_true(*numbers, points_m)
        inside &= np.all((seen >= 0) & (seen <= [width - 1, height - 1]), axis=1)
        if not inside.any():
            continue
        estimated = camera_model.at(camera, track.pan_rad[frame], track.tilt_rad[frame], track.focal_px[frame])
        pixels, depth = camera_model.project(estimated, points_m[inside])
        distance = np.minimum(np.linalg.norm(pixels - seen[inside], axis=1), diagonal)
        distance[depth <= 0.0] = diagonal
        distances.append(distance)
        rms[frame], valid[frame] = np.sqrt(np.mean(distance**2)), True
    return Series(rms, valid), np.concatenate(distances) if distances else np.zeros(0)


# --------------------------------------------------------------------------------------------------------------
# The body


def body_errors(motion: Motion, truth: Truth, frames: NDArray[np.int64]) -> BodyErrors:
    """Compare a motion with the truth, whose frames (F,) are those of `frames_of`."""
    true = truth.joints_m[frames]
    keyframe = np.zeros(len(frames), bool)
    keyframe[motion.keyframes] = True
    lengths = [_limbs_m(joints[motion.valid]) for joints in (motion.joints_m, true)]
    return BodyErrors(
        joints_m=np.linalg.norm(motion.joints_m - true, axis=2),
        limbs=lengths[0] / lengths[1] - 1.0,
        valid=motion.valid,
        keyframe=keyframe,
        inverted=truth.inverted[frames],
        airborne=truth.airborne[frames],
    )


def _limbs_m(joints_m: Array) -> Array:
    """Mean length (15,) of each limb: the way from a joint to its parent; empty for no frames (0, 16, 3)."""
    if not len(joints_m):
        return np.zeros(0)
    children = np.arange(1, len(PARENTS))
    return np.asarray(np.linalg.norm(joints_m[:, children] - joints_m[:, PARENTS[1:]], axis=2).mean(axis=0))


# --------------------------------------------------------------------------------------------------------------
# Metrics


def metrics(result: Score) -> list[Metric]:
    """Every number of metrics.md that needs the truth; None where the run had not the material."""
    cameras = result.cameras
    pan = np.degrees(_joined([c.pan_rad for c in cameras]))
    focal = 100.0 * _joined([c.focal for c in cameras])
    sweeps = [c.sweep_pan_rad for c in cameras if c.sweep_pan_rad is not None]
    parts = [c.reprojection_points_px for c in cameras if c.reprojection_points_px is not None]
    points = np.concatenate(parts) if parts else np.zeros(0)
    positions = [c.position_m for c in cameras if c.position_m is not None]
    residuals = [c.reference_px for c in cameras if c.reference_px is not None]
    found = [
        _metric("reference.reprojection.rms", float(np.mean(residuals)) if residuals else None, "px"),
        _metric("reference.position.max", 1000.0 * max(positions) if positions else None, "mm"),
        _metric("panorama.pan.rms", _rms(np.degrees(np.concatenate(sweeps))) if sweeps else None, "deg"),
        *_spread("panzoom.pan", pan, "deg"),
        *_spread("panzoom.focal", focal, "%"),
        _metric("panzoom.reprojection.rms", _rms(points), "px"),
        _metric("panzoom.reprojection.p95", _percentile(points, 95), "px"),
        _metric("panzoom.lost", float(result.lost) if any(c.pan_rad for c in cameras) else None, "frames"),
        _metric("panzoom.bound_ratio.pan", _over([(c.pan_rad, c.pan_bound_rad) for c in cameras]), "1"),
        _metric("panzoom.bound_ratio.focal", _over([(c.focal, c.focal_bound) for c in cameras]), "1"),
        _metric("panzoom.nees", _mean(_joined([c.nees for c in cameras])), "1"),
    ]
    views = result.foreground or ()
    found += [
        _metric("foreground.iou", _mean(_joined([view.iou for view in views])), "1", "higher"),
        _metric("foreground.outline", _mean(_joined([view.outline_px for view in views])), "px"),
        _metric("foreground.shadow", _mean(100.0 * _joined([view.shadow for view in views])), "%"),
    ]
    return found + body_metrics(result.body)


def body_metrics(body: BodyErrors | None) -> list[Metric]:
    """The metrics of the body; None, all of them, where nobody was tracked."""
    if body is None:
        none = np.zeros((0, 16))
        scored = inverted = airborne = none
        limbs = np.zeros(0)
        keyframes = lost = None
    else:
        millimetres = 1000.0 * body.joints_m
        scored = millimetres[body.scored]
        inverted = millimetres[body.scored & body.inverted]
        airborne = millimetres[body.scored & body.airborne]
        limbs = 100.0 * body.limbs
        keyframes = float(np.sum(body.keyframe))
        lost = float(np.sum(~body.valid | np.any(body.joints_m > LOST_M, axis=1)))
    return [
        _metric("body.mpjpe.mean", _mean(scored), "mm"),
        _metric("body.mpjpe.p95", _percentile(scored, 95), "mm"),
        _metric("body.mpjpe.max", float(scored.max()) if scored.size else None, "mm"),
        _metric("body.mpjpe.inverted", _mean(inverted), "mm"),
        _metric("body.mpjpe.airborne", _mean(airborne), "mm"),
        _metric("body.mpjpe.true_cameras", None, "mm"),
        _metric("body.limb.rms", _rms(limbs), "%"),
        _metric("body.limb.max", float(np.abs(limbs).max()) if limbs.size else None, "%"),
        _metric("body.keyframes", keyframes, "frames"),
        _metric("body.lost", lost, "frames"),
    ]


def _metric(key: str, value: float | None, unit: str, direction: Direction = "lower") -> Metric:
    return Metric(key, value, unit, direction)


def _joined(series: list[Series | None] | list[Series]) -> Array:
    """The valid values of all of them, (N,)."""
    parts = [one.values[one.valid] for one in series if one is not None]
    return np.concatenate(parts) if parts else np.zeros(0)


def _over(pairs: list[tuple[Series | None, Series | None]]) -> float | None:
    """RMS error over the RMS of its bound, in the frames that have both."""
    both = [(e, b, e.valid & b.valid) for e, b in pairs if e is not None and b is not None]
    error = _rms(np.concatenate([e.values[at] for e, _, at in both])) if both else None
    least = _rms(np.concatenate([b.values[at] for _, b, at in both])) if both else None
    return None if error is None or not least else error / least


def _spread(key: str, errors: Array, unit: str) -> list[Metric]:
    size = np.abs(errors)
    return [
        _metric(f"{key}.rms", _rms(errors), unit),
        _metric(f"{key}.median", _percentile(size, 50), unit),
        _metric(f"{key}.p95", _percentile(size, 95), unit),
        _metric(f"{key}.max", float(size.max()) if size.size else None, unit),
    ]


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _mean(values: Array) -> float | None:
    return float(np.mean(values)) if values.size else None


def _percentile(values: Array, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if values.size else None
