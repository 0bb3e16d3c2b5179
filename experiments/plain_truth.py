"""The simulator's truth as the plain one that `pzcap.scoring` scores against and hands out.

    python -m experiments.plain_truth CAPTURE FOLDER

writes that of a capture that the simulator has shot, for `pzcap-score RESULTS FOLDER`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from experiments.errors import guard
from experiments.footage import truth_beside
from experiments.terminal import command_line
from pzcap.io.capture import read_capture
from pzcap.scoring.records import CameraPoses, CameraTrack, Series, TrueCamera, TrueCapture
from pzcap.scoring.truth_files import write_truth
from pzcap.types import Array, PzcapError
from sim.truth import Truth

_HEAD_R_CAM: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def true_capture(
    truth: Truth,
    name: str = "",
    keyframes: Sequence[int] = (),
    bounds: Sequence[tuple[Series, Series] | None] | None = None,
) -> TrueCapture:
    """``truth`` as the score takes it.

    ``keyframes`` are the frames whose pose the capture gives, ``bounds`` the Cramer-Rao bounds of pan and focal length
    of each of the truth's cameras, where they are known.
    """
    keyframe = np.zeros(len(truth.timecodes), bool)
    keyframe[list(keyframes)] = True
    known = bounds or (None,) * len(truth.camera_names)
    return TrueCapture(
        name=name,
        image_size=(truth.width, truth.height),
        frame_rate=str(truth.frame_rate),
        timecodes=truth.timecodes,
        camera_names=truth.camera_names,
        cameras=tuple(_camera(truth, camera, bound) for camera, bound in enumerate(known)),
        joints_m=truth.joints_m,
        inverted=truth.inverted,
        airborne=truth.airborne,
        keyframe=keyframe,
    )


def keyframes_of(timecodes: Sequence[str], truth: Truth) -> list[int]:
    """Frames of the truth at these timecodes, of a capture's keyframes."""
    index = {timecode: frame for frame, timecode in enumerate(truth.timecodes)}
    return sorted(index[timecode] for timecode in timecodes if timecode in index)


def _camera(truth: Truth, camera: int, bound: tuple[Series, Series] | None) -> TrueCamera:
    count = len(truth.timecodes)
    distortion = np.zeros((count, 4))
    distortion[:, :3] = np.column_stack(
        [truth.k1[camera], *np.tile([truth.k2[camera], truth.p1[camera]], (count, 1)).T]
    )
    poses = CameraPoses(
        truth.world_T_cam[camera, :, :3, :3],
        truth.world_T_cam[camera, :, :3, 3],
        truth.principal_px[camera],
        distortion,
    )
    track = CameraTrack(np.ones(count, bool), truth.focal_px[camera], truth.pan_rad[camera], None, poses)
    pan, focal = (None, None) if bound is None else bound
    return TrueCamera(track, truth.recorded[camera], _pan_axis(truth, camera), truth.scene_points_m[camera], pan, focal)


def _pan_axis(truth: Truth, camera: int) -> Array:
    """(3,) the z axis of the head, from the reference pose: its rotation in the world, undone by tilt and roll."""
    tilt, roll = float(truth.tilt_rad[camera, 0]), float(truth.roll_rad[camera, 0])
    pan = float(truth.pan_rad[camera, 0])
    head_R_cam = _about(2, pan) @ _about(1, -tilt) @ _HEAD_R_CAM @ _about(2, roll)
    return np.asarray((truth.world_T_cam[camera, 0, :3, :3] @ head_R_cam.T)[:, 2])


def _about(axis: int, angle_rad: float) -> Array:
    """(3, 3) rotation about a coordinate axis."""
    rotation = np.eye(3)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    rotation[one, one] = rotation[two, two] = np.cos(angle_rad)
    rotation[two, one], rotation[one, two] = np.sin(angle_rad), -np.sin(angle_rad)
    return rotation


def write(capture: Path, folder: Path) -> None:
    """Write the truth of a ``capture`` that the simulator has shot to a ``folder``."""
    truth = truth_beside(capture)
    if truth is None:
        raise PzcapError(f"{capture}: no truth beside it; give the folder `capture` of one that the simulator has shot")
    given = read_capture(capture)
    keyframes = keyframes_of(list(given.keyframe_poses), truth)
    write_truth(true_capture(truth, given.name, keyframes), folder)


def main() -> int:
    """The command line."""
    parser = command_line("plain_truth", __doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    return guard(lambda: write(options.capture, options.folder))


if __name__ == "__main__":
    sys.exit(main())
