"""C3D: joints and ends as points, millimetres, z up; sigmas in a group of their own, since residuals are whole numbers.

A frame without a body has the residual -1 and NaN for coordinates: readers differ in which they look at.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pzcap.export.take import Take, library, points
from pzcap.io.files import write_bytes
from pzcap.types import JOINTS


def write(take: Take, folder: Path) -> list[Path]:
    """Write the motion; the file."""
    motion, ezc3d = take.motion(), library("ezc3d", "C3D")
    names, places = points(motion)
    c3d = ezc3d.c3d()
    parameters = c3d["parameters"]
    parameters["POINT"]["UNITS"]["value"] = ["mm"]
    parameters["POINT"]["RATE"]["value"] = [take.rate]
    parameters["POINT"]["LABELS"]["value"] = list(names)
    c3d.add_parameter("POINT", "X_SCREEN", ["+X"])
    c3d.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    c3d.add_parameter("PZCAP", "TIMECODE", [take.reconstruction.timecodes[0]])
    c3d.add_parameter("PZCAP", "SIGMA_LABELS", list(JOINTS))
    c3d.add_parameter("PZCAP", "SIGMA_MM", np.where(motion.valid[:, None], 1000.0 * motion.sigma_m, -1.0).T)
    data = np.ones((4, len(names), len(places)))
    data[:3] = np.where(motion.valid[:, None, None], 1000.0 * places, np.nan).transpose(2, 1, 0)
    c3d["data"]["points"] = data
    residuals = np.where(motion.valid, 0.0, -1.0)
    c3d["data"]["meta_points"]["residuals"] = np.broadcast_to(residuals, (1, len(names), len(places))).copy()
    with TemporaryDirectory() as own:  # its writer insists on the ending of the name
        c3d.write(str(Path(own) / "take.c3d"))
        return [write_bytes(folder / f"{take.file}.c3d", (Path(own) / "take.c3d").read_bytes())]
