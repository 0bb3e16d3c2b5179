"""Frame-accurate video and SMPTE timecode; anything that FFmpeg decodes is read.

Time is counted in whole frames: a frame's *index* is its presentation time times the frame rate, rounded. A dropped
frame is a gap in the indices, and the timecode of a frame is the video's start timecode plus its index. Pictures come
as a player shows them: turned upright as the file says, in the colours that it says.
"""

from __future__ import annotations

import errno
import re
import struct
from collections import deque
from collections.abc import Container, Iterator
from fractions import Fraction
from itertools import chain, pairwise
from pathlib import Path
from typing import Final, NamedTuple, cast

import av
import cv2
import numpy as np
from av.error import FFmpegError
from av.filter import Graph
from av.sidedata.sidedata import SideData
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation
from av.video.stream import VideoStream
from numpy.typing import NDArray

from pzcap.io import limits
from pzcap.io.edit_list import read_edit
from pzcap.io.files import checked, memory_ran_out
from pzcap.types import Image, PzcapError

_TIMECODE: Final = re.compile(r"(\d\d):(\d\d):(\d\d)([:;])(\d{2,3})")
_PARITY: Final = {2: "tff", 3: "bff", 4: "bff", 5: "tff"}  # by AVFieldOrder: the field that is shown first
_SQUARE: Final = 2e-3  # departure of a pixel's width from its height that encoders write for square ones
_BT601: Final = (2, 5, 6)  # AVColorSpace: unspecified, and the two that are BT.601
_FULL_RANGE: Final = 2  # AVColorRange
_USUAL_RATES: Final = tuple(
    Fraction(rate * 1000, thousand) for rate in (24, 25, 30, 48, 50, 60, 100, 120, 240) for thousand in (1000, 1001)
)
_TURN: Final = "DISPLAYMATRIX"  # av.sidedata.sidedata.Type


def frames_per_day(rate: Fraction, drop: bool = False) -> int:
    """Timecodes repeat after this many frames. Non-drop timecode counts ``round(rate)`` frames a second."""
    return 24 * 3600 * round(rate) - (24 * 54 * _dropped(rate) if drop else 0)


def _dropped(rate: Fraction) -> int:
    """Frame numbers that drop-frame timecode leaves out in each minute but every tenth (SMPTE 12M)."""
    return round(rate) // 15


def timecode_to_frames(timecode: str, rate: Fraction) -> int:
    """Frames since midnight of an SMPTE ``timecode``: "hh:mm:ss:ff", or "hh:mm:ss;ff" if it is drop-frame.

    Raises PzcapError if it is malformed or does not exist at this frame rate.
    """
    match = _TIMECODE.fullmatch(timecode)
    if match is None:
        raise PzcapError(f'timecode "{timecode}" is not "hh:mm:ss:ff", nor "hh:mm:ss;ff" (drop-frame); correct it')
    hours, minutes, seconds, frames = (int(match.group(number)) for number in (1, 2, 3, 5))
    drop = match.group(4) == ";"
    if drop and (rate.denominator != 1001 or round(rate) % 30):
        raise PzcapError(f'timecode "{timecode}" is drop-frame, which {rate} frames/s have not; check the clock')
    left_out = drop and seconds == 0 and minutes % 10 and frames < _dropped(rate)
    if hours > 23 or minutes > 59 or seconds > 59 or frames >= round(rate) or left_out:
        raise PzcapError(f'timecode "{timecode}" does not exist at {rate} frames/s; check the clock\'s frame rate')
    total = ((hours * 60 + minutes) * 60 + seconds) * round(rate) + frames
    minutes += 60 * hours
    return total - (_dropped(rate) * (minutes - minutes // 10) if drop else 0)


def frames_to_timecode(frames: int, rate: Fraction, drop: bool = False) -> str:
    """The inverse of `timecode_to_frames`; wraps at midnight."""
    frames %= frames_per_day(rate, drop)
    if drop:
        numbers = _dropped(rate)
        minute = 60 * round(rate) - numbers
        tens, rest = divmod(frames, 10 * minute + numbers)
        frames += numbers * (9 * tens + max(0, rest - numbers) // minute)
    seconds, frame = divmod(frames, round(rate))
    return f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}{';' if drop else ':'}{frame:02}"


class _Listed(NamedTuple):
    """A video's packets: when each frame is presented, in the stream's time base, from the first shown on."""

    times: NDArray[np.int64]  # (N,) ascending
    origin: Fraction  # of index 0, in the same
    frame: Fraction  # duration of one, in the same
    base: Fraction  # s
    reordered: int  # by how much the presentation of a frame comes after its decoding, at most, in the same


class _Trembling(NamedTuple):
    """Frames of a constant rate, whose stamps are uneven."""

    rate: Fraction
    first: int  # index


class VideoReader:
    """A video file, opened and checked: its packets are listed (which is quick), and one frame is decoded.

    Attributes: ``width``, ``height`` (upright), ``frame_rate`` (Fraction), ``timecode`` (str, or None if the file has
    none), ``indices`` (frame_count,) int64 increasing, ``times_s`` (frame_count,) when each is shown, ``frame_count``,
    ``constant_rate``, ``interlaced``. Where the rate is not constant, as phones film, the index of a frame is its
    number. Stamps that tremble about a constant rate are of a constant rate. Of interlaced video the first field of a
    frame is read, its time the frame's, and with `read_fields` the second as well, half a frame period later. The rows
    between are made by FFmpeg's bwdif: from the other fields where nothing moves, else from the rows beside.

    Raises PzcapError if the file is missing, is no video, is empty or truncated, if its pixels are not square, and for
    sizes beyond `pzcap.io.limits`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._open() as container:
            stream = self._stream(container)
            rate = stream.guessed_rate
            if not rate or stream.codec_context.width == 0 or not stream.time_base:
                raise PzcapError(f"{path}: the video holds no decodable frame; copy it again from the camera")
            self._check_format(stream)
            self.interlaced = int(stream.codec_context.field_order) in _PARITY
            self.frame_rate = Fraction(rate)
            self.timecode = _find_timecode(container)
            listed = self._list(container, stream)
        self._times, self.frame_count, self._reordered = listed.times, len(listed.times), listed.reordered
        indices = [round((int(time) - listed.origin) / listed.frame) for time in listed.times]
        self.times_s = np.array([float(time - listed.origin) for time in listed.times.tolist()]) * float(listed.base)
        self.constant_rate = all(a < b for a, b in pairwise(indices))
        if not self.constant_rate and (trembling := _trembling(self.times_s)) is not None:
            self.frame_rate, self.constant_rate = trembling.rate, True
            indices = list(range(trembling.first, trembling.first + self.frame_count))
        if max(abs(indices[0]), indices[-1]) > limits.LATEST_FRAME or (
            indices[-1] - indices[0] > limits.SPARSEST * (self.frame_count + limits.FEW)
        ):
            raise PzcapError(
                f"{path}: {self.frame_count} frames are shown as frames {indices[0]} to {indices[-1]}; its "
                "presentation times are damaged, copy it again from the camera"
            )
        self.indices: NDArray[np.int64] = np.array(indices if self.constant_rate else range(len(indices)), np.int64)
        self._quarter_turns = self._turned()
        size = stream.codec_context.width, stream.codec_context.height
        self.width, self.height = size[::-1] if self._quarter_turns % 2 else size

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        return self.read()

    def read(
        self, start: int = 0, stop: int | None = None, wanted: Container[int] | None = None
    ) -> Iterator[tuple[int, Image]]:
        """Decode the frames whose index lies in [start, stop), in order: (index, image (H, W, 3)).

        ``wanted``: of a file of which not every picture is used, those that are. Memory is constant in the length of
        the video. Raises PzcapError where a frame cannot be decoded.
        """
        for index, fields in self._decode(start, stop):
            if wanted is None or index in wanted:
                yield index, self._shown(fields[0])

    def read_fields(
        self, start: int = 0, stop: int | None = None, wanted: Container[int] | None = None
    ) -> Iterator[tuple[int, Image, Image | None]]:
        """`read`, and beside each image the second field of an interlaced frame; None of a whole one."""
        for index, fields in self._decode(start, stop):
            if wanted is None or index in wanted:
                yield index, self._shown(fields[0]), self._shown(fields[1]) if len(fields) > 1 else None

    def _shown(self, frame: VideoFrame) -> Image:
        image = _to_bgr(frame)
        return np.ascontiguousarray(np.rot90(image, self._quarter_turns)) if self._quarter_turns else image

    def _decode(self, start: int, stop: int | None) -> Iterator[tuple[int, tuple[VideoFrame, ...]]]:
        within = (self.indices >= start) & (self.indices < (np.inf if stop is None else stop))
        numbers, done = np.flatnonzero(within), 0
        if len(numbers) == 0:
            return
        with self._open() as container:
            stream = self._stream(container)
            if numbers[0] > 0:
                # lands on the last intra frame that is decoded by then: with B frames, one that is shown later may be
                container.seek(int(self._times[numbers[0]]) - self._reordered, stream=stream)
            try:
                for time, fields in self._pictures(container, stream):
                    if time < self._times[numbers[0]]:
                        continue
                    if time != self._times[numbers[done]] or any(one.is_corrupt for one in fields):
                        break
                    yield int(self.indices[numbers[done]]), fields
                    done += 1
                    if done == len(numbers):
                        return
            except FFmpegError as error:
                raise self._failed(error, int(self.indices[numbers[done]])) from error
        raise self._broken(int(self.indices[numbers[done]]))

    def _pictures(
        self, container: av.container.InputContainer, stream: VideoStream
    ) -> Iterator[tuple[int, tuple[VideoFrame, ...]]]:
        """Decode whole pictures, one a frame or one a field, and when each frame is presented in the stream's time
        base."""
        if not self.interlaced:
            yield from ((frame.pts or 0, (frame,)) for frame in container.decode(stream))
            return
        graph, first = Graph(), _PARITY.get(int(stream.codec_context.field_order), "auto")
        whole = graph.add("bwdif", f"mode=send_field:parity={first}:deint=all")
        graph.link_nodes(graph.add_buffer(template=stream), whole, graph.add("buffersink")).configure()
        times: deque[int] = deque()  # of frames in the graph: it needs the next one to make the pictures of two fields
        fields: list[VideoFrame] = []
        for frame in chain(container.decode(stream), [None]):
            if frame is not None:
                times.append(frame.pts or 0)
            graph.push(frame)
            while times:
                try:
                    picture = graph.pull()
                except (BlockingIOError, EOFError):
                    break
                fields.append(cast("VideoFrame", picture))
                if len(fields) == 2:
                    yield times.popleft(), tuple(fields)
                    fields = []

    def _list(self, container: av.container.InputContainer, stream: VideoStream) -> _Listed:
        """List the packets; what an edit list cuts off is left out."""
        base = Fraction(stream.time_base or 1)
        found: list[int] = []
        reordered = 0
        try:
            for packet in container.demux(stream):
                if packet.pts is not None:
                    found.append(packet.pts)
                    reordered = max(reordered, packet.pts - (packet.pts if packet.dts is None else packet.dts))
                if len(found) > limits.FRAMES:
                    raise PzcapError(f"{self.path}: more than {limits.FRAMES} frames; cut it into takes")
        except FFmpegError as error:
            raise self._failed(error) from error
        if len(found) < stream.frames:
            raise self._broken()
        if not found:
            raise PzcapError(f"{self.path}: the video holds no frames; copy it again from the camera")
        times, frame = np.array(sorted(found), np.int64), 1 / (base * self.frame_rate)
        if not container.format.name.startswith("mov"):
            return _Listed(times, Fraction(0), frame, base, reordered)
        edit = read_edit(self.path, stream.id)
        if edit is None:  # without one, what is shown first is shown at once, however late decoding makes it
            return _Listed(times, Fraction(int(times[0])), frame, base, reordered)
        begin, rounded = edit.begin_s / base, edit.rounded_s / base
        shown = times > float(begin - rounded)
        if edit.shown_s is not None:
            shown &= times < float(begin + edit.shown_s / base - rounded)
        if not shown.any():
            raise PzcapError(f"{self.path}: its edit list shows none of its frames; export it again")
        return _Listed(times[shown], begin - edit.delay_s / base, frame, base, reordered)

    def _check_format(self, stream: VideoStream) -> None:
        context = stream.codec_context
        if problem := limits.picture_problem(context.width, context.height):
            raise PzcapError(f"{self.path}: {problem}")
        wide = stream.sample_aspect_ratio or Fraction(1)
        if wide > 0 and abs(float(wide) - 1) > _SQUARE:
            raise PzcapError(
                f"{self.path}: its pixels are {wide.numerator}:{wide.denominator}, not square; convert all that this "
                f"camera recorded, the still too: ffmpeg -i {self.path.name} -vf scale=iw*sar:ih,setsar=1 -crf 10 OUT"
            )

    def _turned(self) -> int:
        """Quarter turns, anticlockwise, that show the pictures upright."""
        _, (frame, *_) = next(self._decode(int(self.indices[0]), None))
        self.interlaced = self.interlaced or bool(frame.interlaced_frame)
        matrix = frame.side_data.get(_TURN)
        if not isinstance(matrix, SideData):
            return 0
        a, b, _, c, d = struct.unpack_from("=5i", bytes(matrix))
        turns = {(1, 0, 0, 1): 0, (0, -1, 1, 0): 1, (-1, 0, 0, -1): 2, (0, 1, -1, 0): 3}
        signs = tuple((value > 0) - (value < 0) for value in (a, b, c, d))
        if signs not in turns:
            raise PzcapError(
                f"{self.path}: its metadata mirror it, or turn it by less than a right angle; make that part of the "
                f"pictures: ffmpeg -i {self.path.name} -crf 10 OUT"
            )
        return turns[signs]

    def _open(self) -> av.container.InputContainer:
        try:
            return av.open(str(checked(self.path)), options={"ignore_editlist": "1"}, metadata_errors="replace")
        except FFmpegError as error:
            if not self.path.is_file():
                raise PzcapError(f"{self.path}: no such video; copy it from the camera") from error
            raise self._failed(error) from error

    def _stream(self, container: av.container.InputContainer) -> VideoStream:
        if not container.streams.video:
            raise PzcapError(f"{self.path}: the file holds no video; copy it again from the camera")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise PzcapError(
                f"{self.path}: FFmpeg does not know its codec, or it is damaged; convert it to H.264 where it was "
                "recorded, or copy it again"
            )
        # A damaged frame must raise, not be patched up with what stood there before.
        stream.codec_context.options = {"err_detect": "explode"}
        return stream

    def _failed(self, error: Exception, index: int | None = None) -> Exception:
        """Error to raise where FFmpeg fails: not every failure is a damage of the file."""
        if isinstance(error, MemoryError) or memory_ran_out():
            return MemoryError(f"{self.path} cannot be decoded")
        if isinstance(error, PermissionError):
            return PzcapError(f"{self.path}: may not be read ({error.strerror}); change its permissions")
        if isinstance(error, OSError) and error.errno in (errno.EIO, errno.EMFILE, errno.ENFILE):
            return PzcapError(f"{self.path}: cannot be read ({error.strerror})")
        return self._broken(index)

    def _broken(self, index: int | None = None) -> PzcapError:
        where = "" if index is None else f" at frame {index}"
        return PzcapError(f"{self.path}: the video is truncated or damaged{where}; copy it again from the camera")


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


def _to_bgr(frame: VideoFrame) -> Image:
    usual = frame.format.name == "yuv420p" and int(frame.colorspace) in _BT601 and int(frame.color_range) != _FULL_RANGE
    if usual and frame.width % 2 == frame.height % 2 == 0:
        return np.asarray(cv2.cvtColor(frame.to_ndarray(), cv2.COLOR_YUV2BGR_I420), np.uint8)
    accurate = Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT | Interpolation.BITEXACT
    return np.asarray(frame.to_ndarray(format="bgr24", interpolation=accurate), np.uint8)


def _find_timecode(container: av.container.InputContainer) -> str | None:
    """SMPTE start timecode, wherever the container keeps it (MP4 and MOV: a track; Matroska: a tag)."""
    for metadata in (container.streams.video[0].metadata, *(s.metadata for s in container.streams), container.metadata):
        for key, value in metadata.items():
            if key.lower() == "timecode":
                return value
    return None
