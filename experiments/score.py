"""Errors of a reconstruction against the truth, frame by frame. `experiments.totals` sums them up to metrics.

Nothing is aligned before it is compared, except where a metric's name says so. `project_true` projects with the true
cameras and without the library, so that a bug in `pzcap.geometry.camera` shows and does not cancel out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments import bound
from experiments.silhouette_score import ForegroundErrors, Series
from pzcap.geometry import camera as geometry
from pzcap.types import (
    PARENTS,
    Array,
    Camera,
    Mask,
    Motion,
    Panorama,
    PanZoomCamera,
    PanZoomTrack,
    PzcapError,
    Reconstruction,
)
from sim.truth import Truth


@dataclass(frozen=True, slots=True, eq=False)
class CameraErrors:
    """Errors of one camera. None where the stage did not run."""

    pan_rad: Series | None = None  # estimated minus true
    focal: Series | None = None  # estimated over true, minus 1
    pan_sigma_rad: Series | None = None  # standard deviation that the estimate claims
    focal_sigma: Series | None = None  # the same of the focal length, relative
    refined_pan_rad: Series | None = None  # estimated minus true, after camera refinement
    refined_focal: Series | None = None  # estimated over true, minus 1, after camera refinement
    pan_bound_rad: Series | None = None  # Cramer-Rao bound of the standard deviation, from experiments.bound
    focal_bound: Series | None = None  # Cramer-Rao bound of the focal length, relative
    normalised: Array | None = None  # (F, 2) errors of pan and log focal, whitened by their claimed covariance
    nees: Series | None = None  # normalised estimation error squared over 2: 1 on average if the covariance is honest
    reprojection_px: Series | None = None  # RMS over the static scene points in the image
    reprojection_points_px: Array | None = None  # (N,) distances of all points in all frames
    sweep_pan_rad: Array | None = None  # (M,) a frame of the sweep, one common offset removed
    position_m: float | None = None  # distance of the reference camera's centre from the true one
    reference_px: float | None = None  # RMS residual of the calibration object


@dataclass(frozen=True, slots=True, eq=False)
class BodyErrors:
    """Errors of the motion."""

    joints_m: Array  # (F, 16) distance of each joint from the truth
    sigma_m: Array  # (F, 16) standard deviation that the estimate claims
    limbs: Array  # (15,) length of each limb, joint to joint, relative to the true one; empty where nothing is valid
    valid: Mask  # (F,) the tracker gave an estimate
    keyframe: Mask  # (F,) a person posed it: not scored
    inverted: Mask  # (F,) head below the pelvis
    airborne: Mask  # (F,) no contact with the floor

    @property
    def scored(self) -> Mask:
        """(F,) the frames that count: estimated, and not posed by hand."""
        return self.valid & ~self.keyframe


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Errors of a reconstruction."""

    truth_frames: NDArray[np.int64]  # (F,) index into the truth of each frame set
    cameras: tuple[CameraErrors, ...]
    foreground: tuple[ForegroundErrors, ...] | None
    body: BodyErrors | None
    lost: int  # recorded views without a valid estimate


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
    if not known.all():
        reconstruction = _within(reconstruction, known)
    least = bound.bounds(reconstruction, truth, frames, report)
    lost, cameras = 0, []
    for number, name in enumerate(reconstruction.camera_names):
        true, track = truth.camera_names.index(name), reconstruction.tracks[number]
        errors = _camera_errors(reconstruction, number, truth, true, frames)
        cameras.append(_with_bound(errors, least[number], known))
        found = np.zeros(len(frames), bool) if track is None else track.valid
        lost += int(np.sum(truth.recorded[true, frames] & known & ~found))  # dropped frames do not count
    motion = reconstruction.motion
    body = None if motion is None else body_errors(motion, truth, frames)
    return Score(frames, tuple(cameras), foreground, body, lost)


def frames_of(truth: Truth, reconstruction: Reconstruction) -> tuple[NDArray[np.int64], Mask]:
    """Index into the truth of each frame set (F,), or of the nearest, and which frame sets the truth knows (F,).

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
    """``reconstruction`` with estimates valid in the frame sets ``known`` (F,) alone."""
    motion = reconstruction.motion
    tracks, refined = (
        tuple(None if t is None else replace(t, valid=t.valid & known) for t in either)
        for either in (reconstruction.tracks, reconstruction.refined)
    )
    return replace(
        reconstruction,
        tracks=tracks,
        refined=refined,
        motion=None if motion is None else replace(motion, valid=motion.valid & known),
    )


# --------------------------------------------------------------------------------------------------------------
# Cameras


def project_true(camera: Camera, points_m: Array) -> tuple[Array, Mask]:
    """World points (N, 3) to pixels (N, 2), and which of them can be seen at all (N,).

    The lens of pzcap.types, written out a second time. With barrel distortion the radius grows to a largest value and
    then folds back: what lies beyond is never seen, though the formula puts it into the image.
    """
    k1, k2, p1, p2 = camera.k1, camera.k2, camera.p1, camera.p2
    cam = (np.linalg.inv(camera.world_T_cam) @ np.column_stack([points_m, np.ones(len(points_m))]).T)[:3]
    x, y = cam[0] / cam[2], cam[1] / cam[2]
    squared = x * x + y * y
    factor = 1.0 + k1 * squared + k2 * squared**2
    aside = factor * x + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x)
    down = factor * y + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y
    pixels = camera.principal_px + camera.focal_px * np.column_stack([aside, down])
    return pixels, (cam[2] > 0.1) & (1.0 + 3.0 * k1 * squared + 5.0 * k2 * squared**2 > 0.0)


def _camera_errors(
    reconstruction: Reconstruction, number: int, truth: Truth, true: int, frames: NDArray[np.int64]
) -> CameraErrors:
    reference, panorama = reconstruction.references[number], reconstruction.panoramas[number]
    track, camera = reconstruction.tracks[number], reconstruction.cameras[number]
    found: dict[str, Any] = {}
    if reference is not None:
        offset = reference.camera.world_T_cam[:3, 3] - truth.reference_world_T_cam[true, :3, 3]
        found["position_m"] = float(np.linalg.norm(offset))
        found["reference_px"] = float(np.sqrt(np.mean(np.sum(reference.residuals_px**2, axis=1))))
    if panorama is not None:
        found["sweep_pan_rad"] = sweep_errors(panorama, truth, true)
    refined = reconstruction.refined[number]
    if refined is not None:
        found["refined_pan_rad"], found["refined_focal"] = _pan_and_focal(refined, truth, true, frames)
    if track is not None:
        found["pan_rad"], found["focal"] = _pan_and_focal(track, truth, true, frames)
        pan, focal = found["pan_rad"].values, found["focal"].values
        found["pan_sigma_rad"] = Series(np.sqrt(np.maximum(track.covariance[:, 0, 0], 0.0)), track.valid)
        found["focal_sigma"] = Series(np.sqrt(np.maximum(track.covariance[:, 1, 1], 0.0)), track.valid)
        normalised, usable = _normalised(np.column_stack([pan, np.log1p(focal)]), track)
        if usable.any():
            found["normalised"], found["nees"] = normalised, Series(np.sum(normalised**2, axis=1) / 2, usable)
        if camera is not None:
            series, points = _reprojection(camera, track, truth, true, frames)
            found["reprojection_px"], found["reprojection_points_px"] = series, points
    return CameraErrors(**found)


def _pan_and_focal(track: PanZoomTrack, truth: Truth, true: int, frames: NDArray[np.int64]) -> tuple[Series, Series]:
    """Errors of pan (rad) and focal length (relative)."""
    pan = np.where(track.valid, geometry.wrapped(track.pan_rad - truth.pan_rad[true, frames]), 0.0)
    focal = np.where(track.valid, track.focal_px / truth.focal_px[true, frames] - 1.0, 0.0)
    return Series(pan, track.valid), Series(focal, track.valid)


def sweep_errors(panorama: Panorama, truth: Truth, true: int) -> Array | None:
    """Errors of pan (M,) of the sweep's frames, rad, one common offset removed; None if the sweep is another."""
    if len(panorama.sweep_pan_rad) != truth.sweep_pan_rad.shape[1]:
        return None
    sweep = geometry.wrapped(panorama.sweep_pan_rad - truth.sweep_pan_rad[true])
    return geometry.wrapped(sweep - np.angle(np.mean(np.exp(1j * sweep))))


def _normalised(error: Array, track: PanZoomTrack) -> tuple[Array, Mask]:
    """Errors (F, 2) whitened by their covariance, and where there is one (F,); 0 elsewhere."""
    usable = track.valid & (np.linalg.det(track.covariance) > 0.0)
    values = np.zeros(error.shape)
    values[usable] = np.linalg.solve(np.linalg.cholesky(track.covariance[usable]), error[usable][..., None])[..., 0]
    return values, usable


def _with_bound(errors: CameraErrors, least: bound.Bound | None, known: Mask) -> CameraErrors:
    """``errors`` with the bound, valid in the frame sets ``known`` (F,)."""
    if least is None:
        return errors
    pan, focal = (Series(one.values.copy(), one.valid & known) for one in (least.pan_rad, least.log_focal))
    return replace(errors, pan_bound_rad=pan, focal_bound=focal)


def _reprojection(
    camera: PanZoomCamera, track: PanZoomTrack, truth: Truth, true: int, frames: NDArray[np.int64]
) -> tuple[Series, Array]:
    """Distances in px between the images of the static scene's points in the estimated and the true camera.

    Returns the RMS of each frame, and all distances (N,). A distance is limited to the image's diagonal.
    """
    points_m = truth.scene_points_m[true]
    width, height = camera.lens.width, camera.lens.height
    diagonal = float(np.hypot(width, height))
    rms, valid, distances = np.zeros(len(frames)), np.zeros(len(frames), bool), []
    for frame in np.flatnonzero(track.valid):
        there = truth.camera(true, int(frames[frame]))
        seen, inside = project_true(there, points_m)
        inside &= np.all((seen >= 0) & (seen <= [width - 1, height - 1]), axis=1)
        if not inside.any():
            continue
        estimated = geometry.of_track(camera, track, int(frame))
        pixels, depth = geometry.project(estimated, points_m[inside])
        distance = np.minimum(np.linalg.norm(pixels - seen[inside], axis=1), diagonal)
        distance[depth <= 0.0] = diagonal
        distances.append(distance)
        rms[frame], valid[frame] = np.sqrt(np.mean(distance**2)), True
    return Series(rms, valid), np.concatenate(distances) if distances else np.zeros(0)


# --------------------------------------------------------------------------------------------------------------
# The body


def body_errors(motion: Motion, truth: Truth, frames: NDArray[np.int64]) -> BodyErrors:
    """Compare a motion with the truth in its ``frames`` (F,), as of `frames_of`."""
    true = truth.joints_m[frames]
    keyframe = np.zeros(len(frames), bool)
    keyframe[motion.keyframes] = True
    lengths = [_limbs_m(joints[motion.valid]) for joints in (motion.joints_m, true)]
    return BodyErrors(
        joints_m=np.linalg.norm(motion.joints_m - true, axis=2),
        sigma_m=motion.sigma_m,
        limbs=lengths[0] / lengths[1] - 1.0,
        valid=motion.valid,
        keyframe=keyframe,
        inverted=truth.inverted[frames],
        airborne=truth.airborne[frames],
    )


def _limbs_m(joints_m: Array) -> Array:
    """Mean length (15,) of each limb, from a joint (F, 16, 3) to its parent; empty if there are no frames."""
    if not len(joints_m):
        return np.zeros(0)
    children = np.arange(1, len(PARENTS))
    return np.asarray(np.linalg.norm(joints_m[:, children] - joints_m[:, PARENTS[1:]], axis=2).mean(axis=0))
