"""The edit list of an MP4 or MOV file: which part of what was recorded is shown, and when (ISO 14496-12, 8.6.6).

FFmpeg applies edit lists itself, but lists too few frames where one ends in the middle of a group of pictures, and does
not tell a file without one from others; so it is told to ignore them, and they are read here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from pzcap.io.files import checked
from pzcap.types import PzcapError

_MOST_BOXES: Final = 100_000
_MOST_EDITS: Final = 1_000
_EMPTY: Final = -1  # media time of an edit that shows nothing


@dataclass(frozen=True, slots=True)
class Edit:
    """The one part of a track that is shown. Times in seconds."""

    begin_s: Fraction  # where it begins in what was recorded
    shown_s: Fraction | None  # how long it is; None: to the end
    delay_s: Fraction  # when it is shown
    rounded_s: Fraction  # by how much these may be off: the list counts in units of its own


class _Box(NamedTuple):
    kind: bytes
    begin: int  # of what is in it
    end: int


class _Entry(NamedTuple):
    duration: int  # in the movie's time scale; 0: to the end
    media_time: int  # in the track's; _EMPTY: nothing is shown
    rate: int  # 16.16


def read_edit(path: Path, track: int) -> Edit | None:
    """The edit of the track of this number in an MP4 or MOV file; None where it has no edit list.

    Raises PzcapError for a list of several parts, or one that changes the speed: timecode does not know them.
    """
    with checked(path).open("rb") as file:
        end = file.seek(0, 2)
        movie = next((box for box in _boxes(file, 0, end) if box.kind == b"moov"), None)
        if movie is None:
            return None
        scale = None
        for box in _boxes(file, movie.begin, movie.end):
            if box.kind == b"mvhd":
                scale = _time_scale(file, box)
            if box.kind == b"trak" and (found := _edits(file, box, track)):
                media_scale, entries = found
                return _joined(path, entries, scale or 0, media_scale)
    return None


def _boxes(file: BinaryIO, begin: int, end: int) -> Iterator[_Box]:
    """The boxes between two places of a file."""
    for _ in range(_MOST_BOXES):
        file.seek(begin)
        header = file.read(8)
        if begin + 8 > end or len(header) < 8:
            return
        size, kind = struct.unpack(">I4s", header)
        content = begin + 8
        if size == 1:
            large = file.read(8)
            if len(large) < 8:
                return
            size, content = struct.unpack(">Q", large)[0], begin + 16
        stop = end if size == 0 else begin + size
        if stop < content or stop > end:
            return
        yield _Box(kind, content, stop)
        begin = stop


def _time_scale(file: BinaryIO, box: _Box) -> int | None:
    """Units a second of an mvhd or mdhd box."""
    data = _content(file, box, 24)
    at = 20 if data[:1] == b"\x01" else 12
    return struct.unpack_from(">I", data, at)[0] if len(data) >= at + 4 else None


def _edits(file: BinaryIO, trak: _Box, track: int) -> tuple[int, list[_Entry]] | None:
    """Time scale and edit list of a track, if it is the one of this number and has them."""
    number, scale, entries = None, None, None
    for box in _boxes(file, trak.begin, trak.end):
        if box.kind == b"tkhd":
            data = _content(file, box, 24)
            at = 20 if data[:1] == b"\x01" else 12
            number = struct.unpack_from(">I", data, at)[0] if len(data) >= at + 4 else None
        elif box.kind in (b"edts", b"mdia"):
            for inner in _boxes(file, box.begin, box.end):
                if inner.kind == b"elst":
                    entries = _entries(_content(file, inner, 8 + 20 * _MOST_EDITS))
                elif inner.kind == b"mdhd":
                    scale = _time_scale(file, inner)
    return (scale, entries) if number == track and scale and entries else None


def _content(file: BinaryIO, box: _Box, most: int) -> bytes:
    file.seek(box.begin)
    return file.read(min(box.end - box.begin, most))


def _entries(data: bytes) -> list[_Entry]:
    layout = ">QqI" if data[:1] == b"\x01" else ">IiI"
    count = struct.unpack_from(">I", data, 4)[0] if len(data) >= 8 else 0
    fitting = min(count, (len(data) - 8) // struct.calcsize(layout))
    return [_Entry(*struct.unpack_from(layout, data, 8 + k * struct.calcsize(layout))) for k in range(fitting)]


def _joined(path: Path, entries: list[_Entry], scale: int, media_scale: int) -> Edit | None:
    """One edit of a list: what is shown without a break counts as one part."""
    if scale == 0:
        return None
    delay = Fraction(0)
    begin, shown = None, Fraction(0)
    for entry in entries:
        lasts = Fraction(entry.duration, scale)
        if entry.media_time == _EMPTY and begin is None:
            delay += lasts
            continue
        at = Fraction(entry.media_time, media_scale)
        follows = begin is None or abs(at - begin - shown) < Fraction(1, scale) + Fraction(1, media_scale)
        if entry.media_time < 0 or entry.rate != 1 << 16 or not follows:
            raise PzcapError(
                f"{path}: its edit list shows it in pieces, or not at its own speed; export what was recorded, as one"
            )
        begin, shown = at if begin is None else begin, shown + lasts
    if begin is None:
        return None
    return Edit(begin, shown or None, delay, Fraction(1, scale))
