"""SoccerNet's camera JSON, a file a frame: degrees, metres, pixels; the world's z axis points down.

Its evaluation takes a picture to be twice as large as the principal point: an off-centre one is misread by it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pzcap.export.axes import Z_DOWN
from pzcap.export.take import Take, write_text
from pzcap.types import Camera


def write(take: Take, folder: Path) -> list[Path]:
    """Write a folder for each camera; the files."""
    return [
        write_text(folder / located.file / f"camera_{frame:05d}.json", json.dumps(_entries(camera), indent=1) + "\n")
        for located in take.cameras()
        for frame, camera in located.frames()
    ]


def _entries(camera: Camera) -> dict[str, Any]:
    """``Rz(pan) Rx(tilt) Rz(roll)`` takes camera axes to the world's; pan is positive to the right, tilt 90 level."""
    turned, place = Z_DOWN @ camera.world_T_cam[:3, :3], Z_DOWN @ camera.world_T_cam[:3, 3]
    pan = np.arctan2(turned[0, 2], -turned[1, 2])
    tilt = np.arccos(np.clip(turned[2, 2], -1.0, 1.0))
    roll = np.arctan2(turned[2, 0], turned[2, 1])
    return {
        "pan_degrees": float(np.rad2deg(pan)),
        "tilt_degrees": float(np.rad2deg(tilt)),
        "roll_degrees": float(np.rad2deg(roll)),
        "position_meters": place.tolist(),
        "x_focal_length": camera.focal_px,
        "y_focal_length": camera.focal_px,
        "principal_point": camera.principal_px.tolist(),
        "radial_distortion": [camera.k1, camera.k2, 0.0, 0.0, 0.0, 0.0],
        "tangential_distortion": [camera.p1, camera.p2],
        "thin_prism_distortion": [0.0, 0.0, 0.0, 0.0],
    }
