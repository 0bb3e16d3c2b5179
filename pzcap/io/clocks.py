"""Clocks of the motion's recordings: which picture of which camera belongs to which frame set.

The common clock counts frame sets. By timecode it counts from midnight; by ``sync.json`` (docs/capture.md), which has
the offset of each camera where there is no timecode, from the common time 0. A camera that records a multiple of the
frame sets' rate gives every second, or every n-th, of its pictures. One whose rate varies gives those nearest in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from pzcap.io import limits
from pzcap.io.manifest import load_json
from pzcap.io.timecode import frames_per_day, timecode_to_frames
from pzcap.io.video import VideoReader
from pzcap.types import Array, CameraClock, Capture, Indices, PzcapError

SYNC_FORMAT: Final = "pzcap-sync"
SYNC_VERSION: Final = 1
RATE_TOLERANCE: Final = 1e-4  # containers round 30000/1001 to 29.97
DRIFT: Final = 0.02
"""Departure of a clock's rate from a whole multiple of the frame sets', from which on it is no drift."""


_FULL: Final = 0.7  # pictures that a camera whose rate varies takes on average, as a share of the frame sets


class Timeline(NamedTuple):
    """Pictures of one camera that belong to frame sets."""

    clock: Indices  # (N,) ascending, frame sets of the common clock
    picture: Indices  # (N,) index of each, as `VideoReader.read` counts
    late: Array  # (N,) frame periods from the instant of the frame set to that of the picture


NEVER: Final = Timeline(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))


def read_sync(path: Path) -> dict[str, CameraClock]:
    """Read and check sync.json."""
    root = load_json(path)
    root.only("format", "version", "cameras")
    if root["format"].text() != SYNC_FORMAT or root["version"].value != SYNC_VERSION:
        raise root.error(f'this is not format "{SYNC_FORMAT}", version {SYNC_VERSION}; see docs/capture.md')
    clocks: dict[str, CameraClock] = {}
    for entry in root["cameras"].list():
        entry.only("name", "offset_s", "rate", "sigma_s", "by")
        name = entry["name"].text()
        offset, rate, sigma = (float(entry[key].array()) for key in ("offset_s", "rate", "sigma_s"))
        if name in clocks:
            raise entry.error(f'camera "{name}" stands there twice; remove one')
        if abs(offset) > limits.SYNC_S:
            raise entry["offset_s"].error(f"is {offset:g} s, where {limits.SYNC_S:g} are the most; give seconds")
        if not limits.SYNC_RATE[0] <= rate <= limits.SYNC_RATE[1]:
            raise entry["rate"].error(
                f"is {rate:g}; it is the seconds that pass while the file shows one, and 1 for a clock that goes right"
            )
        if not 0.0 <= sigma <= limits.SYNC_S:
            raise entry["sigma_s"].error("must be a standard deviation in seconds, 0 or more")
        by = entry["by"].text() if "by" in entry.value else "hand"
        clocks[name] = CameraClock(offset, rate, sigma, by)
    return clocks


def check_clock(name: str, reader: VideoReader, rate: Fraction, sync: dict[str, CameraClock] | None) -> None:
    """Check that the clock of a camera's motion video can be told. Raises PzcapError, with the remedy."""
    if sync is not None and name not in sync:
        raise PzcapError(f'{reader.path}: sync.json says nothing of camera "{name}"; add its offset (docs/capture.md)')
    clock = None if sync is None else sync[name]
    if reader.constant_rate:
        _multiple(reader, rate, clock)
    else:
        lasts = float(reader.times_s[-1] - reader.times_s[0]) * (1.0 if clock is None else clock.rate)
        average = (reader.frame_count - 1) / max(lasts, 1e-9)
        if average < _FULL * float(rate):
            raise PzcapError(
                f"{reader.path}: its frame rate varies, and is {average:.3g} frames/s on average where capture.json "
                f"says {float(rate):.6g}; film at a constant rate, or with more light"
            )
    if clock is None:
        _midnight(reader, rate)


def timelines(capture: Capture, readers: Sequence[VideoReader | None]) -> list[Timeline]:
    """The pictures of each camera (None: it has no motion) by frame sets."""
    if capture.sync is not None:
        return [
            NEVER if reader is None else _by_sync(reader, capture.frame_rate, capture.sync[camera.name])
            for camera, reader in zip(capture.cameras, readers, strict=True)
        ]
    return _by_timecode(capture, readers)


def drop_frame(folder: Path, recorded: Sequence[VideoReader]) -> bool:
    """True where the recordings' timecodes are drop-frame. Raises PzcapError if those of some are."""
    kinds = {";" in (reader.timecode or "") for reader in recorded}
    if len(kinds) > 1:
        listing = ", ".join(f"{reader.path.parent.name} {reader.timecode}" for reader in recorded)
        raise PzcapError(
            f"{folder}: some clocks count drop-frame (a semicolon before the frames) and some do not: {listing}; they "
            "drift apart by 3.6 s an hour, set all alike"
        )
    return kinds.pop()


def _by_timecode(capture: Capture, readers: Sequence[VideoReader | None]) -> list[Timeline]:
    recorded = [reader for reader in readers if reader is not None]
    day = frames_per_day(capture.frame_rate, drop_frame(capture.folder, recorded))
    found, before = [], None
    for reader in readers:
        if reader is None:
            found.append(NEVER)
            continue
        own = _midnight(reader, capture.frame_rate)
        every = _multiple(reader, capture.frame_rate, None) if reader.constant_rate else 1
        start = Fraction(own, every)
        if before is None:
            before = start
        # A clock that passed midnight before another was started is a day ahead of it, not a day behind.
        days = round((start - before) / day)
        if reader.constant_rate:
            found.append(_counted(reader, own - days * day * every, every))
        else:
            found.append(_nearest(reader, float(start - days * day) + reader.times_s * float(capture.frame_rate)))
    return found


def _by_sync(reader: VideoReader, rate: Fraction, clock: CameraClock) -> Timeline:
    every = _multiple(reader, rate, clock) if reader.constant_rate else 1
    lasts = float(reader.indices[-1] - reader.indices[0]) / float(reader.frame_rate)
    drift = clock.rate * every * float(rate) / float(reader.frame_rate) - 1.0
    if reader.constant_rate and abs(drift) * lasts * float(rate) < 0.5:  # whole frames: nothing is taken twice
        return _counted(reader, round(clock.offset_s * every * float(rate)), every)
    return _nearest(reader, (clock.offset_s + clock.rate * reader.times_s) * float(rate))


def _counted(reader: VideoReader, start: int, every: int) -> Timeline:
    """Every ``every``-th picture; ``start``: of index 0, on the common clock in the camera's own frames."""
    own = start + reader.indices
    used = own % every == 0
    return Timeline(own[used] // every, reader.indices[used], np.zeros(int(used.sum())))


def _nearest(reader: VideoReader, times: Array) -> Timeline:
    """The picture nearest to each frame set, of pictures at ``times`` (N,), frame sets of the common clock."""
    clock = np.floor(times + 0.5).astype(np.int64)
    order = np.lexsort((np.abs(times - clock), clock))
    _, first = np.unique(clock[order], return_index=True)
    chosen = order[first]
    return Timeline(clock[chosen], reader.indices[chosen], times[chosen] - clock[chosen])


def _multiple(reader: VideoReader, rate: Fraction, clock: CameraClock | None) -> int:
    """How many pictures a camera of constant rate takes while one frame set passes."""
    ratio = float(reader.frame_rate / rate) / (1.0 if clock is None else clock.rate)
    every = round(ratio)
    if every < 1 or abs(ratio / every - 1.0) > (RATE_TOLERANCE if clock is None else DRIFT):
        near = abs(float(reader.frame_rate / rate) - 1.0) <= DRIFT
        cure = (
            "let pzcap sync FOLDER find how cameras of nearly the same rate lie to each other"
            if near and clock is None
            else "film again at that rate, or leave this camera's motion out"
        )
        raise PzcapError(
            f"{reader.path}: has {reader.frame_rate} frames/s where capture.json says {rate}; correct one of them (a "
            f"camera may have a whole multiple: every n-th picture is taken), or {cure}"
        )
    return every


def _midnight(reader: VideoReader, rate: Fraction) -> int:
    """Frames since midnight of a recording's index 0, in its own rate; where that varies, in that of the frame sets."""
    if reader.timecode is None:
        raise PzcapError(
            f"{reader.path}: the video holds no SMPTE timecode; export it again with its timecode track, or let pzcap "
            "sync FOLDER find how the cameras lie to each other"
        )
    try:
        return timecode_to_frames(reader.timecode, reader.frame_rate if reader.constant_rate else rate)
    except PzcapError as error:
        raise PzcapError(f"{reader.path}: {error}") from error
