"""Tables of cameras and joints, as `pzcap-score` reads them and any spreadsheet does (docs/benchmark.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pzcap.export.take import Take
from pzcap.geometry import camera as geometry
from pzcap.scoring.files import BODY, CAMERAS, HEADER, write_results
from pzcap.scoring.records import BodyTrack, CameraPoses, CameraTrack, Results
from pzcap.types import Motion, PanZoomCamera, PanZoomTrack, Reconstruction


def write(take: Take, folder: Path) -> list[Path]:
    """Write a folder of the take's name; the files."""
    place = folder / take.file
    write_results(results_of(take.reconstruction), place)
    return [path for name in (HEADER, CAMERAS, BODY) if (path := place / name).is_file()]


def results_of(reconstruction: Reconstruction) -> Results:
    """All that the score asks of ``reconstruction``: pan, zoom and pose of each camera, and the joints."""
    sizes = {(c.lens.width, c.lens.height) for c in reconstruction.cameras if c is not None}
    pairs = zip(reconstruction.tracks, reconstruction.cameras, strict=True)
    return Results(
        method=reconstruction.method,
        capture=reconstruction.capture_name,
        frames=len(reconstruction.timecodes),
        timecodes=reconstruction.timecodes,
        image_size=sizes.pop() if len(sizes) == 1 else None,
        camera_names=reconstruction.camera_names,
        cameras=tuple(None if track is None else camera_track(track, camera) for track, camera in pairs),
        body=None if reconstruction.motion is None else body_track(reconstruction.motion),
    )


def camera_track(track: PanZoomTrack, camera: PanZoomCamera | None) -> CameraTrack:
    """The track of one camera; with poses where the camera itself is known."""
    poses = None if camera is None else _poses(track, camera)
    covariance = track.covariance.copy()
    covariance[:, 1, 0] = covariance[:, 0, 1]  # as files have it: an inverse is symmetric but for its last digit
    return CameraTrack(track.valid, track.focal_px, track.pan_rad, covariance, poses)


def body_track(motion: Motion) -> BodyTrack:
    """The joints of a motion."""
    keyframe = np.zeros(len(motion.valid), bool)
    keyframe[motion.keyframes] = True
    valid = np.repeat(motion.valid[:, None], motion.joints_m.shape[1], axis=1)
    return BodyTrack(motion.joints_m, valid, motion.sigma_m, keyframe)


def _poses(track: PanZoomTrack, camera: PanZoomCamera) -> CameraPoses:
    count = len(track.valid)
    rotation, position = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    principal, distortion = np.zeros((count, 2)), np.zeros((count, 4))
    for frame in np.flatnonzero(track.valid):
        now = geometry.of_track(camera, track, int(frame))
        rotation[frame], position[frame] = now.world_T_cam[:3, :3], now.world_T_cam[:3, 3]
        principal[frame], distortion[frame] = now.principal_px, (now.k1, now.k2, now.p1, now.p2)
    return CameraPoses(rotation, position, principal, distortion)
