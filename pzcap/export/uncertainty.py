"""Uncertainty, and all that a format has no place for, as tables beside it: comma separated, a row a frame set."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pzcap.export.take import Take, write_text
from pzcap.types import JOINTS, Camera

CAMERA_COLUMNS = (
    "frame", "timecode", "time_s", "valid", "pan_deg", "pan_sigma_deg", "focal_px", "focal_sigma_px", "principal_x_px",
    "principal_y_px", "k1", "k2", "p1", "p2", "exposed_s", "pan_shear_deg", "focal_shear_px",
)  # fmt: skip


def write_joints(take: Take, folder: Path) -> Path:
    """Write the standard deviation of each joint's distance from the truth, metres; the path."""
    motion, stamps = take.motion(), _stamps(take)
    rows = [
        [*stamp, int(valid), *(f"{sigma:.6f}" if valid else "" for sigma in sigmas)]
        for stamp, valid, sigmas in zip(stamps, motion.valid, motion.sigma_m, strict=True)
    ]
    header = ["frame", "timecode", "time_s", "valid", *(f"{joint}_sigma_m" for joint in JOINTS)]
    return write_text(folder / f"{take.file}_joints_sigma.csv", _table(header, rows))


def write_cameras(take: Take, folder: Path) -> list[Path]:
    """Write pan, lens and their standard deviations of each camera, when it exposed its middle row, and by how much
    pan and focal length change from the first row to the last where they are not exposed at once; the paths."""
    stamps, files = _stamps(take), []
    for camera in take.cameras():
        rows = []
        for frame, stamp in enumerate(stamps):
            here = camera.at(frame)
            numbers: list[float] = []
            if here is not None:
                pan, focal = camera.sigma(frame)
                numbers = [float(np.rad2deg(camera.track.pan_rad[frame])), pan, here.focal_px, focal, *lens(here)]
                numbers += [take.times_s[frame] + camera.head.clock_s, *camera.shear(frame)]
            empty = [""] * (len(CAMERA_COLUMNS) - 4 - len(numbers))
            rows.append([*stamp, int(here is not None), *(f"{number:.9g}" for number in numbers), *empty])
        path = folder / f"{take.file}_camera_{camera.file}.csv"
        files.append(write_text(path, _table(CAMERA_COLUMNS, rows)))
    return files


def lens(camera: Camera) -> list[float]:
    """Principal point and distortion of a camera at one instant."""
    return [float(camera.principal_px[0]), float(camera.principal_px[1]), camera.k1, camera.k2, camera.p1, camera.p2]


def _stamps(take: Take) -> list[list[object]]:
    pairs = zip(take.reconstruction.timecodes, take.times_s, strict=True)
    return [[frame, timecode, f"{time:.9f}"] for frame, (timecode, time) in enumerate(pairs)]


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    return "".join(",".join(map(str, row)) + "\n" for row in (header, *rows))
