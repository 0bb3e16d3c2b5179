"""Errors of one camera, frame by frame. Nothing is aligned before it is compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pzcap.scoring.body_errors import Similarity
from pzcap.scoring.projection import angle_between, inside, project, turned, wrapped
from pzcap.scoring.records import CameraTrack, Series, TrueCamera
from pzcap.types import Array, Mask

JACCARD_PX: Final = (5, 10, 20)
"""Distances in pixels within which a point of the scene counts as found, JaC@5, @10, @20."""
FAR_OFF_RAD: Final = np.deg2rad(1.0)
"""Frames further off than this, and than three times the median, do not tell which common rotation there is."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraErrors:
    """Errors of one camera. None where nothing was said of it."""

    pan_rad: Series | None = None  # estimated minus true
    focal: Series | None = None  # estimated over true, minus 1
    pan_sigma_rad: Series | None = None  # standard deviation that the estimate claims
    focal_sigma: Series | None = None  # the same of the focal length, relative
    pan_bound_rad: Series | None = None  # Cramer-Rao bound of the standard deviation
    focal_bound: Series | None = None  # Cramer-Rao bound of the focal length, relative
    normalised: Array | None = None  # (F, 2) errors of pan and log focal, whitened by their claimed covariance
    nees: Series | None = None  # normalised estimation error squared over 2: 1 on average if the covariance is honest
    reprojection_px: Series | None = None  # RMS over the static scene points in the image
    reprojection_points_px: Array | None = None  # (N,) distances of all points in all frames
    jaccard: tuple[Series, ...] | None = None  # of the static scene points, a threshold of ``JACCARD_PX`` each
    rotation_rad: Series | None = None  # angle between the estimated and the true camera axes
    common_rad: Series | None = None  # angle to the true camera axes, after the one rotation that suits most frames
    centre_m: Series | None = None  # distance between the estimated and the true projection centre
    aligned_centre_m: Series | None = None  # the same after the similarity that brings the motion to the true one


def camera_errors(
    track: CameraTrack, true: TrueCamera, frames: NDArray[np.int64], known: Mask, image_size: tuple[int, int]
) -> CameraErrors:
    """Compare ``track`` (F,) with the truth in its ``frames`` (F,), where it is ``known`` (F,)."""
    pan, focal = pan_and_focal(track, true, frames)
    found: dict[str, Any] = {"pan_rad": pan, "focal": focal}
    if track.covariance is not None:
        sigma = np.sqrt(np.maximum(np.diagonal(track.covariance, axis1=1, axis2=2), 0.0))
        found["pan_sigma_rad"] = Series(sigma[:, 0].copy(), track.valid)
        found["focal_sigma"] = Series(sigma[:, 1].copy(), track.valid)
        errors = np.column_stack([pan.values, np.log1p(focal.values)])
        normalised, usable = _normalised(errors, track.covariance, track.valid)
        if usable.any():
            found["normalised"], found["nees"] = normalised, Series(np.sum(normalised**2, axis=1) / 2, usable)
    if track.poses is not None and true.track.poses is not None:
        found |= _pose_errors(track, true, frames)
        found |= _scene_errors(track, true, frames, image_size)
    for name in ("pan_bound_rad", "focal_bound"):
        bound: Series | None = getattr(true, name)
        if bound is not None:
            found[name] = Series(bound.values[frames], bound.valid[frames] & known)
    return CameraErrors(**found)


def own_world_errors(track: CameraTrack, true: TrueCamera, frames: NDArray[np.int64]) -> CameraErrors:
    """The errors of a camera whose rotations are in a frame of its own: focal length, and what one rotation leaves."""
    focal = np.where(track.valid, track.focal_px / true.track.focal_px[frames] - 1.0, 0.0)
    return CameraErrors(focal=Series(focal, track.valid), common_rad=_after_common_rotation(track, true, frames))


def aligned_centres(
    track: CameraTrack, true: TrueCamera, frames: NDArray[np.int64], similarity: Similarity
) -> Series | None:
    """Distances (F,) between estimated and true projection centres, the former after a ``similarity``."""
    if track.poses is None or true.track.poses is None:
        return None
    off = similarity.apply(track.poses.position_m) - true.track.poses.position_m[frames]
    return Series(np.linalg.norm(off, axis=1), track.valid)


def pan_and_focal(track: CameraTrack, true: TrueCamera, frames: NDArray[np.int64]) -> tuple[Series, Series]:
    """Errors of pan (rad) and focal length (relative), (F,) each.

    The pan is that which the track states, against its own reference pose. Where it states none, it is the turn of the
    optical axis about the true pan axis.
    """
    if track.pan_rad is not None and true.track.pan_rad is not None:
        apart = wrapped(track.pan_rad - true.track.pan_rad[frames])
    else:
        assert track.poses is not None
        assert true.track.poses is not None
        apart = turned(track.poses.rotation, true.track.poses.rotation[frames], true.pan_axis)
    pan = np.where(track.valid, apart, 0.0)
    focal = np.where(track.valid, track.focal_px / true.track.focal_px[frames] - 1.0, 0.0)
    return Series(pan, track.valid), Series(focal, track.valid)


def _normalised(error: Array, covariance: Array, valid: Mask) -> tuple[Array, Mask]:
    """Errors (F, 2) whitened by their covariance (F, 2, 2), and where there is one (F,); 0 elsewhere."""
    usable = valid & (np.linalg.det(covariance) > 0.0)
    values = np.zeros(error.shape)
    values[usable] = np.linalg.solve(np.linalg.cholesky(covariance[usable]), error[usable][..., None])[..., 0]
    return values, usable


def _pose_errors(track: CameraTrack, true: TrueCamera, frames: NDArray[np.int64]) -> dict[str, Any]:
    poses, there = track.poses, true.track.poses
    assert poses is not None
    assert there is not None
    return {
        "rotation_rad": Series(angle_between(poses.rotation, there.rotation[frames]), track.valid),
        "common_rad": _after_common_rotation(track, true, frames),
        "centre_m": Series(np.linalg.norm(poses.position_m - there.position_m[frames], axis=1), track.valid),
    }


def _after_common_rotation(track: CameraTrack, true: TrueCamera, frames: NDArray[np.int64]) -> Series | None:
    """Angles between true and found axes (F,), after the rotation of the world that suits most frames best."""
    poses, there = track.poses, true.track.poses
    if poses is None or there is None or not track.valid.any():
        return None
    found, wanted = poses.rotation, there.rotation[frames]
    apart, counted = np.zeros(len(found)), track.valid
    for _ in range(2):  # once more without what the first shows to be far off
        u, _, vt = np.linalg.svd(np.sum(wanted[counted] @ found[counted].transpose(0, 2, 1), axis=0))
        common = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
        apart = angle_between(common @ found, wanted)
        counted = track.valid & (apart <= max(FAR_OFF_RAD, 3.0 * float(np.median(apart[track.valid]))))
    return Series(apart, track.valid)


def _scene_errors(
    track: CameraTrack, true: TrueCamera, frames: NDArray[np.int64], image_size: tuple[int, int]
) -> dict[str, Any]:
    """Distances in px between the images of the static scene's points in the estimated and the true camera.

    A distance is limited to the image's diagonal. A point counts for the Jaccard index if either camera sees it in its
    image, and is found if both do, so near to each other.
    """
    poses, there = track.poses, true.track.poses
    assert poses is not None
    assert there is not None
    diagonal = float(np.hypot(*image_size))
    count = len(track.valid)
    rms, valid, jaccard, distances = np.zeros(count), np.zeros(count, bool), np.zeros((len(JACCARD_PX), count)), []
    for frame in np.flatnonzero(track.valid):
        at = int(frames[frame])
        seen, visible = project(there, float(true.track.focal_px[at]), at, true.scene_points_m)
        shown = visible & inside(seen, image_size)
        if not shown.any():
            continue
        pixels, found = project(poses, float(track.focal_px[frame]), int(frame), true.scene_points_m)
        either = shown | (found & inside(pixels, image_size))
        apart = np.linalg.norm(pixels - seen, axis=1)
        both = shown & found & inside(pixels, image_size)
        for row, within_px in enumerate(JACCARD_PX):
            jaccard[row, frame] = np.sum(both & (apart < within_px)) / np.sum(either)
        distance = np.where(found, np.minimum(apart, diagonal), diagonal)[shown]
        distances.append(distance)
        rms[frame], valid[frame] = np.sqrt(np.mean(distance**2)), True
    return {
        "reprojection_px": Series(rms, valid),
        "reprojection_points_px": np.concatenate(distances) if distances else np.zeros(0),
        "jaccard": tuple(Series(row, valid) for row in jaccard),
    }
