"""When each frame of a video is shown, and the index that this gives it: from its packets, which need no decoding."""

from __future__ import annotations

import errno
import re
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.stream import VideoStream
from numpy.typing import NDArray

from pzcap.io import limits
from pzcap.io.edit_list import read_edit
from pzcap.io.files import memory_ran_out
from pzcap.types import PzcapError

_USUAL_RATES: Final = tuple(
    Fraction(rate * 1000, thousand) for rate in (24, 25, 30, 48, 50, 60, 100, 120, 240) for thousand in (1000, 1001)
)


_OWN_CLOCK: Final = ("mpegts", "mpeg", "avi", "flv")
"""Formats, as FFmpeg names them, whose first stamp says nothing but how long the recorder was on, or decoding takes."""


_CUT_S: Final = 0.5  # by how much earlier than it says a recording may end
_UNSTAMPED: Final = 0.1  # pictures without a time, which are not read, as a share of the others
_STREAMS: Final = ("mpegts", "mpeg")
"""Formats without an index, in which FFmpeg finds places by their time, though decoding may not begin there."""


class FrameTimes(NamedTuple):
    """The frames that a video shows."""

    times: NDArray[np.int64]  # (N,) ascending, when each is presented, in the stream's time base
    times_s: NDArray[np.float64]  # (N,) from index 0 on
    indices: NDArray[np.int64]  # (N,) increasing
    rate: Fraction  # frames a second
    constant: bool  # whether that holds for all of them; where not, the index of a frame is its number
    reordered: int  # by how much the presentation of a frame comes after its decoding, at most, in the time base
    keys: NDArray[np.int64]  # (K, 2) of formats without an index, where decoding may begin: presentation, decoding time
    begins_s: float  # what the file's clock, which its sound keeps to, says at time 0: other than 0 in some formats


def frame_times(path: Path, container: InputContainer, stream: VideoStream, rate: Fraction) -> FrameTimes:
    """The frames of the file at ``path`` that is said to have this ``rate``. Raises PzcapError where it is damaged."""
    listed = _listed(path, container, stream, rate)
    count = len(listed.times)
    indices = [round((int(time) - listed.origin) / listed.frame) for time in listed.times]
    times_s = np.array([float(time - listed.origin) for time in listed.times.tolist()]) * float(listed.base)
    constant = all(a < b for a, b in pairwise(indices))
    if not constant and (trembling := _trembling(times_s)) is not None:
        rate, constant = trembling.rate, True
        indices = list(range(trembling.first, trembling.first + count))
    if max(abs(indices[0]), indices[-1]) > limits.LATEST_FRAME or (
        indices[-1] - indices[0] > limits.SPARSEST * (count + limits.FEW)
    ):
        raise PzcapError(
            f"{path}: {count} frames are shown as frames {indices[0]} to {indices[-1]}; its presentation times are "
            "damaged, copy it again from the camera"
        )
    numbers: NDArray[np.int64] = np.array(indices if constant else range(count), np.int64)
    own_clock = container.format.name in _OWN_CLOCK
    begins_s = float(listed.origin * listed.base) if own_clock else 0.0
    return FrameTimes(listed.times, times_s, numbers, rate, constant, listed.reordered, listed.keys, begins_s)


class _Listed(NamedTuple):
    """A video's packets, from the first shown on."""

    times: NDArray[np.int64]  # (N,) ascending, in the stream's time base
    origin: Fraction  # of index 0, in the same
    frame: Fraction  # duration of one, in the same
    base: Fraction  # s
    reordered: int  # as of `FrameTimes`
    keys: NDArray[np.int64]  # the same


def _listed(path: Path, container: InputContainer, stream: VideoStream, rate: Fraction) -> _Listed:
    """List the packets; what an edit list cuts off is left out."""
    base = Fraction(stream.time_base or 1)
    found: list[int] = []
    keys: list[tuple[int, int]] = []
    indexed = container.format.name not in _STREAMS
    reordered, unstamped = 0, 0
    try:
        for packet in container.demux(stream):
            if packet.pts is None:
                unstamped += packet.size > 0
            else:
                found.append(packet.pts)
                if not indexed and packet.is_keyframe:
                    keys.append((packet.pts, packet.pts if packet.dts is None else packet.dts))
                reordered = max(reordered, packet.pts - (packet.pts if packet.dts is None else packet.dts))
            if len(found) > limits.FRAMES:
                raise PzcapError(f"{path}: more than {limits.FRAMES} frames; cut it into takes")
    except FFmpegError as error:
        raise failed(path, error) from error
    said_s = _said_to_end(stream)
    if len(found) < stream.frames or (found and said_s > float(max(found) * base + 1 / rate) + _CUT_S):
        raise damaged(path)
    if not found and unstamped:
        raise PzcapError(
            f"{path}: a raw stream, which does not say when its frames are shown; put it into a file that does: "
            f"ffmpeg -framerate RATE -i {path.name} -c copy OUT.mp4"
        )
    if not found:
        raise PzcapError(f"{path}: the video holds no frames; copy it again from the camera")
    if unstamped > _UNSTAMPED * len(found):
        raise damaged(path, stamped=False)
    # a stream that was cut out of another begins with pictures that nobody can decode
    times = np.array(sorted(time for time in found if not keys or time >= keys[0][0]), np.int64)
    frame, begins = 1 / (base * rate), np.array(keys, np.int64).reshape(-1, 2)
    if not container.format.name.startswith("mov"):
        origin = int(times[0]) if container.format.name in _OWN_CLOCK else 0
        return _Listed(times, Fraction(origin), frame, base, reordered, begins)
    edit = read_edit(path, stream.id)
    if edit is None:  # without one, what is shown first is shown at once, however late decoding makes it
        return _Listed(times, Fraction(int(times[0])), frame, base, reordered, begins)
    begin, rounded = edit.begin_s / base, edit.rounded_s / base
    shown = times > float(begin - rounded)
    if edit.shown_s is not None:
        shown &= times < float(begin + edit.shown_s / base - rounded)
    if not shown.any():
        raise PzcapError(f"{path}: its edit list shows none of its frames; export it again")
    return _Listed(times[shown], begin - edit.delay_s / base, frame, base, reordered, begins)


def _said_to_end(stream: VideoStream) -> float:
    """When the last picture ends by a Matroska's own tag, in seconds; 0: there is none."""
    told = re.fullmatch(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)", stream.metadata.get("DURATION", ""))
    return 3600.0 * int(told[1]) + 60.0 * int(told[2]) + float(told[3]) if told else 0.0


class _Trembling(NamedTuple):
    """Frames of a constant rate, whose stamps are uneven."""

    rate: Fraction
    first: int  # index


def _trembling(times_s: NDArray[np.float64]) -> _Trembling | None:
    """The constant rate of frames at ``times_s`` (N,), each less than a frame from its place: recorders that stamp what
    they are sent write such. None where the rate itself varies, or frames are missing."""
    numbers = np.arange(len(times_s))
    if len(times_s) < 3:
        return None
    line = np.polynomial.Polynomial.fit(numbers, times_s, 1).convert().coef
    start, period = float(line[0]), float(line[-1])
    off = times_s - start - period * numbers
    sigma = float(np.std(off)) / np.sqrt(np.sum((numbers - numbers.mean()) ** 2))
    fitting = [rate for rate in _USUAL_RATES if abs(1 / float(rate) - period) < 3 * sigma + 1e-6]
    if np.abs(off).max() >= period or not fitting:
        return None
    rate = min(fitting, key=lambda each: (each.denominator, abs(1 / float(each) - period)))
    # by the middle of all stamps: the first one trembles as the others do
    return _Trembling(rate, round(float(rate) * (start + period * float(numbers.mean())) - float(numbers.mean())))


def usual_rate(times_s: NDArray[np.float64]) -> Fraction:
    """The rate that a camera was set to whose frames at ``times_s`` (N,) vary in rate: the usual one that is nearest to
    most of them."""
    period = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0
    # of 30 and 29.97 nobody can tell which one varies
    return min((rate for rate in _USUAL_RATES if rate.denominator == 1), key=lambda rate: abs(np.log(rate * period)))


# --------------------------------------------------------------------------------------------------------------
# Errors


def failed(path: Path, error: Exception, index: int | None = None) -> Exception:
    """Error to raise where FFmpeg fails: not every failure is a damage of the file."""
    if memory_ran_out(refused=isinstance(error, MemoryError)):
        return MemoryError(f"{path} cannot be decoded")
    if isinstance(error, PermissionError) and error.errno == errno.EACCES:  # a seek to nowhere is "not permitted", too
        return PzcapError(f"{path}: may not be read ({error.strerror}); change its permissions")
    if isinstance(error, OSError) and error.errno in (errno.EIO, errno.EMFILE, errno.ENFILE):
        return PzcapError(f"{path}: cannot be read ({error.strerror})")
    return damaged(path, index)


def damaged(path: Path, index: int | None = None, stamped: bool = True) -> PzcapError:
    """Error to raise where a video ends too early, or a frame of that ``index`` cannot be decoded. ``stamped``: its
    format keeps when each picture is shown."""
    where = "" if index is None else f" at frame {index}"
    anew = (
        ""
        if stamped
        else "; if it plays well, its container cannot say when its pictures are shown: write it "
        f"anew, ffmpeg -i {path.name} -crf 10 OUT.mp4"
    )
    return PzcapError(f"{path}: the video is truncated or damaged{where}; copy it again from the camera{anew}")
