"""Videos as cameras, phones and editors write them; what `sim.capture_writer` does not do."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame

from pzcap.types import Image

ONE = 1 << 16
TURNS = {0: (ONE, 0, 0, ONE), 90: (0, ONE, -ONE, 0), 180: (-ONE, 0, 0, -ONE), 270: (0, -ONE, ONE, 0)}
"""First two rows of the matrix of a track header, by the degrees that a player turns the pictures clockwise."""
MIRROR = (-ONE, 0, 0, ONE)


def pictures(count: int, width: int = 64, height: int = 48) -> list[Image]:
    """Smooth pictures, brighter at the top left, each of its own brightness, so that order and turn can be told."""
    rows, columns = np.mgrid[0:height, 0:width]
    base = 120 - 40 * rows / height - 20 * columns / width
    return [np.asarray(np.repeat((base + 3 * k)[..., None], 3, axis=2), np.uint8) for k in range(count)]


def number(image: Image) -> int:
    """Which of the `pictures` it is, however it is turned."""
    return round((float(image.mean()) - 90.0) / 3)


def encode(
    path: Path, images: Sequence[Image], rate: Fraction, *, timecode: str | None = None,
    options: dict[str, str] | None = None, muxer: dict[str, str] | None = None,
    setup: Callable[[Any], object] | None = None, times_s: Sequence[float] | None = None,
) -> Path:  # fmt: skip
    """Encode as H.264. ``times_s``: when each picture is shown, by default one after the other; ``setup`` changes the
    stream."""
    with av.open(str(path), "w", options=muxer or {}) as container:
        stream = container.add_stream("libx264", rate=rate, options={"crf": "4"} | (options or {}))
        base = 1 / rate if times_s is None else Fraction(1, 90_000)
        stream.pix_fmt, stream.codec_context.time_base = "yuv420p", base
        stream.height, stream.width = images[0].shape[:2]
        if timecode is not None:
            stream.metadata["timecode"] = timecode
        if setup is not None:
            setup(stream)
        for k, image in enumerate(images):
            frame = VideoFrame.from_ndarray(
                np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), np.uint8), format="yuv420p"
            )
            frame.pts, frame.time_base = k if times_s is None else round(times_s[k] / base), base
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def _boxes(data: bytes, name: str) -> list[int]:
    """Places behind the headers of all boxes of this name."""
    place, found = data.find(name.encode()), []
    while place >= 0:
        found.append(place + 4)
        place = data.find(name.encode(), place + 4)
    return found


def flag(path: Path, matrix: tuple[int, int, int, int]) -> Path:
    """Write the first two rows of the matrix of the first track's header: how a player turns the pictures."""
    data = bytearray(path.read_bytes())
    at = _boxes(data, "tkhd")[0]
    a, b, c, d = matrix
    struct.pack_into(">9i", data, at + (52 if data[at] == 1 else 40), a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    return path


def trim(path: Path, shown_s: Fraction) -> Path:
    """Say in the edit list that the first track is shown for so long, as an editor trims without encoding again."""
    data = bytearray(path.read_bytes())
    scale = struct.unpack_from(">I", data, _boxes(data, "mvhd")[0] + 12)[0]
    struct.pack_into(">I", data, _boxes(data, "elst")[0] + 8, round(shown_s * scale))
    path.write_bytes(data)
    return path
