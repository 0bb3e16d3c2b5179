"""FreeD, message D1: 29 bytes a frame; a file a camera, and a table of what its zoom numbers mean.

Degrees in 1/32768, positive to the right, up and clockwise seen from behind; places in 1/64 mm, z up, the camera at
zero looking along +y. A frame in which the camera was not located repeats the message before, so that message k is
frame k.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.export.axes import pan_tilt_roll
from pzcap.export.take import SENSOR_WIDTH_MM, LocatedCamera, Take, held, write_text
from pzcap.geometry import lens
from pzcap.io.files import write_bytes
from pzcap.types import Array, Camera, PzcapError

ZOOM_MAX: Final = 65535
_TABLE_ROWS: Final = 65
_DEGREE: Final = 32768
_MILLIMETRE: Final = 64
_REACH: Final = 2**23


def write(take: Take, folder: Path) -> list[Path]:
    """Write the messages and the zoom table of each camera; the files."""
    files = []
    for located in take.cameras():
        stem = f"{take.file}_{located.file}"
        files.append(write_bytes(folder / f"{stem}.d1", b"".join(messages(located))))
        files.append(write_text(folder / f"{stem}_zoom.csv", _zoom_table(located)))
    return files


def messages(located: LocatedCamera) -> list[bytes]:
    """A message a frame set. PzcapError where the camera stands further out than the format reaches, 131 m."""
    low, high = _zoom_range(located)
    found = []
    for frame in held(located.track.valid).tolist():
        camera = located.at(frame)
        assert camera is not None
        zoom = np.log(camera.focal_px / low) / max(np.log(high / low), 1e-12)
        found.append(_message(located.number + 1, camera, round(ZOOM_MAX * float(zoom))))
    return found


def send(take: Take, host: str, port: int, pause: Callable[[float], None] = time.sleep) -> int:
    """Send the messages of all cameras by UDP, at the rate of the take; how many frames were sent."""
    rows = list(zip(*(messages(located) for located in take.cameras()), strict=True))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        start = time.monotonic()
        for frame, row in enumerate(rows):
            pause(max(0.0, start + frame / take.rate - time.monotonic()))
            try:
                for message in row:
                    out.sendto(message, (host, port))
            except OSError as error:
                raise PzcapError(f"FreeD cannot be sent to {host}:{port} ({error.strerror}); give HOST:PORT") from error
    return len(rows)


def _message(number: int, camera: Camera, zoom: int) -> bytes:
    angles = pan_tilt_roll(camera.world_T_cam[:3, :3])
    turns = [round(_DEGREE * angle) for angle in (-angles.pan, angles.tilt, angles.roll)]
    places = [round(_MILLIMETRE * 1000.0 * value) for value in camera.world_T_cam[:3, 3].tolist()]
    if any(abs(value) >= _REACH for value in places):
        raise PzcapError("FreeD: a camera stands more than 131 m from the origin; the format reaches no further")
    body = bytes([0xD1, number]) + b"".join(value.to_bytes(3, "big", signed=True) for value in (*turns, *places))
    body += zoom.to_bytes(3, "big") + bytes(3) + bytes(2)  # focus is not known; two bytes are spare
    return body + bytes([(0x40 - sum(body)) % 256])


def _zoom_range(located: LocatedCamera) -> tuple[float, float]:
    focal = located.track.focal_px[located.track.valid]
    return float(focal.min()), float(focal.max())


def _zoom_table(located: LocatedCamera) -> str:
    low, high = _zoom_range(located)
    lines = ["zoom,focal_px,focal_mm_on_36_mm,principal_x_px,principal_y_px,k1,k2,p1,p2"]
    for share in np.linspace(0.0, 1.0, _TABLE_ROWS).tolist():
        focal = low * (high / low) ** share
        principal, distortion = lens.at(located.head.lens, focal)
        numbers: Sequence[float] | Array = [
            focal, focal * SENSOR_WIDTH_MM / located.head.lens.width, *principal, *distortion
        ]  # fmt: skip
        lines.append(",".join([f"{ZOOM_MAX * share:.3f}", *(f"{number:.9g}" for number in numbers)]))
    return "\n".join(lines) + "\n"
