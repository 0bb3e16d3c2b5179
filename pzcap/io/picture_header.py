"""Width and height of a PNG or a JPEG, from its header: known before memory is taken for its pixels."""

from __future__ import annotations

import struct
from typing import Final

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8"
_FRAMES: Final = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
"""Second bytes of the JPEG markers that begin a frame's header."""
_CHUNK: Final = 12  # bytes of a PNG's part beside its content: length, kind, check sum


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that a PNG's or JPEG's header tells, before any turn by its EXIF; None for anything else."""
    if data.startswith(_PNG):
        return _png(data)
    if data.startswith(_JPEG):
        return _jpeg(data)
    return None


def is_whole(data: bytes) -> bool:
    """True where a PNG's or JPEG's last part is there. Within a JPEG's data, a marker is never met by chance."""
    if data.startswith(_PNG):
        return _has_all_chunks(data)
    return data.rfind(b"\xff\xd9") > data.rfind(b"\xff\xda")


def _has_all_chunks(data: bytes) -> bool:
    """True where each part of a PNG is there as long as it says: for one that is not OpenCV takes up to 2 GiB."""
    place = len(_PNG)
    while place + _CHUNK <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        if data[place + 4 : place + 8] == b"IEND":
            return True
        place += _CHUNK + length
    return False


def _png(data: bytes) -> tuple[int, int] | None:
    if len(data) < 24 or data[12:16] != b"IHDR":
        return None
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _jpeg(data: bytes) -> tuple[int, int] | None:
    place = 2
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", data, place + 5)
            return width, height
        # fill bytes stand alone, and so do the markers without a length
        alone = marker == 0xFF or marker == 0x01 or 0xD0 <= marker <= 0xD8
        place += (1 if marker == 0xFF else 2) if alone else 2 + struct.unpack_from(">H", data, place + 2)[0]
    return None
