"""TRC: joints and ends as markers, metres, y up, facing +x in the zero pose, as OpenSim's models stand.

A frame without a body has NaN in every cell: a blank cell at the end of a row is lost by OpenSim's reader.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pzcap.export.axes import Y_UP_FACING_X
from pzcap.export.take import Take, points, write_text


def write(take: Take, folder: Path) -> list[Path]:
    """Write the motion; the file."""
    motion = take.motion()
    names, places = points(motion)
    moved = np.where(motion.valid[:, None, None], places @ Y_UP_FACING_X.T, np.nan)
    path = folder / f"{take.file}.trc"
    rate, frames = f"{take.rate:.8g}", len(moved)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{len(names)}\tm\t{rate}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)),
        *(
            f"{frame}\t{time:.9f}\t" + "\t".join("NaN" if np.isnan(value) else f"{value:.7f}" for value in row.ravel())
            for frame, (time, row) in enumerate(zip(take.times_s, moved, strict=True), start=1)
        ),
    ]
    return [write_text(path, "\n".join(lines) + "\n")]
