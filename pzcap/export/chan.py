"""Nuke's .chan, a file a camera: frame, place (metres, y up), turn (degrees, order ZXY), vertical field of view.

Frame 1 is the first frame set. A frame in which the camera was not located is left out. The format has no place for the
principal point, the distortion and the order of rotations.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.export.axes import LOOKING_BACK, Y_UP_FACING_X
from pzcap.export.take import Take, write_text


def write(take: Take, folder: Path) -> list[Path]:
    """Write all cameras; the files."""
    files = []
    for located in take.cameras():
        lines = []
        for frame, camera in located.frames():
            place = Y_UP_FACING_X @ camera.world_T_cam[:3, 3]
            turned = Y_UP_FACING_X @ camera.world_T_cam[:3, :3] @ LOOKING_BACK
            z, x, y = Rotation.from_matrix(turned).as_euler("zxy", degrees=True)  # about z first
            field = np.rad2deg(2.0 * np.arctan(0.5 * camera.height / camera.focal_px))
            numbers = "\t".join(f"{number:.9f}" for number in (*place, x, y, z, field))
            lines.append(f"{frame + 1}\t{numbers}\n")
        files.append(write_text(folder / f"{take.file}_{located.file}.chan", "".join(lines)))
    return files
