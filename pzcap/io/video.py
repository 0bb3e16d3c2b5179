"""Frame-accurate video; anything that FFmpeg decodes is read.

Time is counted in whole frames: a frame's *index* is its presentation time times the frame rate, rounded. A dropped
frame is a gap in the indices, and the timecode of a frame is the video's start timecode plus its index. Pictures come
as a player shows them: turned upright as the file says, in the colours that it says.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Container, Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Final, cast

import av
import cv2
import numpy as np
from av.error import ArgumentError, FFmpegError
from av.filter import Graph
from av.sidedata.sidedata import SideData
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation
from av.video.stream import VideoStream

from pzcap.io import limits
from pzcap.io.files import checked
from pzcap.io.frame_times import damaged, failed, frame_times
from pzcap.types import Image, Indices, PzcapError

_PARITY: Final = {2: "tff", 3: "bff", 4: "bff", 5: "tff"}  # by AVFieldOrder: the field that is shown first
_SQUARE: Final = 2e-3  # departure of a pixel's width from its height that encoders write for square ones
_BT601: Final = (2, 5, 6)  # AVColorSpace: unspecified, and the two that are BT.601
_FULL_RANGE: Final = 2  # AVColorRange
_TURN: Final = "DISPLAYMATRIX"  # av.sidedata.sidedata.Type
_UNSTAMPED: Final = ("avi", "mpeg")  # formats that do not keep for each picture when it is shown
_SEARCHES: Final = (0.0, 5.0, None)
"""How far before a frame to begin, in seconds; None: at the beginning, where an intra frame tells too little, as those
of open groups of pictures may, or where stamps are made up from there on, as in MPEG program streams."""
_RECORDINGS: Final = (
    "mov", "matroska", "avi", "mpegts", "mpeg", "mxf", "mxf_opatom", "gxf", "lxf", "ogg", "flv", "asf", "nut", "dv",
    "ivf", "wtv", "rm", "amv", "gif", "apng", "r3d", "cine", "yuv4mpegpipe", "h264", "hevc", "mpegvideo", "mjpeg",
    "m4v", "obu",
)  # fmt: skip
"""Formats that hold pictures themselves, as FFmpeg names them. Others are lists of further files, or one picture."""


class VideoReader:
    """A video file, opened and checked: its packets are listed (which is quick), and one frame is decoded.

    Attributes: ``width``, ``height`` (upright), ``frame_rate`` (Fraction), ``timecode`` (str, or None if the file has
    none), ``indices`` (frame_count,) int64 increasing, ``times_s`` (frame_count,) when each is shown, ``frame_count``,
    ``begins_s`` (what the file's own clock, which its sound keeps to, says at time 0), ``constant_rate``,
    ``interlaced``, ``on_its_side`` (its rows are shown as columns: a phone held upright). Where the rate is not
    constant, as phones film, the index of a frame is its number. Stamps that tremble about a constant rate are of a
    constant rate. Of interlaced video the first field of a frame is read, its time the frame's, and with `read_fields`
    the second as well, half a frame period later. The rows between are made by FFmpeg's bwdif: from the other fields
    where nothing moves, else from the rows beside.

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
            self.timecode = _find_timecode(container, stream)
            self._stamped = container.format.name not in _UNSTAMPED
            self._searches = _SEARCHES[-1:] if container.format.name == "mpeg" else _SEARCHES
            shown = frame_times(path, container, stream, Fraction(rate))
        self._times, self._reordered, self.frame_count = shown.times, shown.reordered, len(shown.times)
        self.times_s, self.indices, self.begins_s = shown.times_s, shown.indices, shown.begins_s
        self._keys = shown.keys
        self.frame_rate, self.constant_rate = shown.rate, shown.constant
        self._quarter_turns = self._turned()
        self.on_its_side = self._quarter_turns % 2 == 1
        size = stream.codec_context.width, stream.codec_context.height
        self.width, self.height = size[::-1] if self.on_its_side else size

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
        for before_s in self._searches if len(numbers) and numbers[0] > 0 else (None,):
            try:
                for index, fields in self._decoded(numbers, before_s):
                    yield index, fields
                    done += 1
                return
            except PzcapError:
                if done or before_s is None:
                    raise

    def _decoded(self, numbers: Indices, before_s: float | None) -> Iterator[tuple[int, tuple[VideoFrame, ...]]]:
        """Decode the frames of these consecutive ``numbers``, from the intra frame on that is found ``before_s`` before
        them; None: from the beginning on."""
        done = 0
        if len(numbers) == 0:
            return
        with self._open() as container:
            stream = self._stream(container)
            try:
                if before_s is not None:
                    earlier = round(before_s / float(stream.time_base or 1))
                    container.seek(self._place(int(self._times[numbers[0]]) - earlier), stream=stream)
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
                raise failed(self.path, error, int(self.indices[numbers[done]])) from error
        raise damaged(self.path, int(self.indices[numbers[done]]), stamped=self._stamped)

    def _place(self, time: int) -> int:
        """Where to look for the intra frame before a ``time``, in the stream's time base."""
        before = self._keys[self._keys[:, 0] <= time]
        # lands on the last intra frame that is decoded by then: with B frames, one shown later may be
        return int(before[-1, 1]) if len(before) else time - self._reordered

    def _pictures(
        self, container: av.container.InputContainer, stream: VideoStream
    ) -> Iterator[tuple[int, tuple[VideoFrame, ...]]]:
        """Decode whole pictures, one a frame or one a field, and when each frame is presented in the stream's time
        base."""
        if not self.interlaced:
            yield from ((frame.pts or 0, (frame,)) for frame in self._frames(container, stream))
            return
        graph, first = Graph(), _PARITY.get(int(stream.codec_context.field_order), "auto")
        whole = graph.add("bwdif", f"mode=send_field:parity={first}:deint=all")
        graph.link_nodes(graph.add_buffer(template=stream), whole, graph.add("buffersink")).configure()
        times: deque[int] = deque()  # of frames in the graph: it needs the next one to make the pictures of two fields
        fields: list[VideoFrame] = []
        for frame in chain(self._frames(container, stream), [None]):
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

    def _frames(self, container: av.container.InputContainer, stream: VideoStream) -> Iterator[VideoFrame]:
        """Decode from the first intra frame on. Pictures that are shown before it may need some that come before it,
        and be lost."""
        first: int | None = None
        for packet in container.demux(stream):
            if first is None and (packet.is_keyframe or len(self._keys) == 0):
                first = packet.pts or 0
            if first is None:
                continue
            try:
                frames = packet.decode()
            except FFmpegError:
                if packet.pts is None or packet.pts >= first:
                    raise
                continue
            yield from frames

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
        options = {"ignore_editlist": "1", "format_whitelist": ",".join(_RECORDINGS), "protocol_whitelist": "file"}
        try:
            return av.open(str(checked(self.path).absolute()), options=options, metadata_errors="replace")
        except FFmpegError as error:
            if not self.path.is_file():
                raise PzcapError(f"{self.path}: no such video; copy it from the camera") from error
            if isinstance(error, ArgumentError):
                raise PzcapError(
                    f"{self.path}: is no recording, but a picture or a list of other files; put the video itself "
                    "there, such as MP4, MOV or MKV"
                ) from error
            raise failed(self.path, error) from error

    def _stream(self, container: av.container.InputContainer) -> VideoStream:
        stream = container.streams.best("video")  # not the thumbnail that some cameras and tools put beside it
        if not isinstance(stream, VideoStream):
            raise PzcapError(f"{self.path}: the file holds no video; copy it again from the camera")
        if stream.codec_context is None:
            raise PzcapError(
                f"{self.path}: FFmpeg does not know its codec, or it is damaged; convert it to H.264 where it was "
                "recorded, or copy it again"
            )
        # A damaged frame must raise, not be patched up with what stood there before.
        stream.codec_context.options = {"err_detect": "explode"}
        return stream


def _to_bgr(frame: VideoFrame) -> Image:
    usual = frame.format.name == "yuv420p" and int(frame.colorspace) in _BT601 and int(frame.color_range) != _FULL_RANGE
    if usual and frame.width % 2 == frame.height % 2 == 0:
        return np.asarray(cv2.cvtColor(frame.to_ndarray(), cv2.COLOR_YUV2BGR_I420), np.uint8)
    accurate = Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT | Interpolation.BITEXACT
    return np.asarray(frame.to_ndarray(format="bgr24", interpolation=accurate), np.uint8)


def _find_timecode(container: av.container.InputContainer, stream: VideoStream) -> str | None:
    """SMPTE start timecode, wherever the container keeps it (MP4 and MOV: a track; Matroska: a tag)."""
    for metadata in (stream.metadata, *(s.metadata for s in container.streams), container.metadata):
        for key, value in metadata.items():
            if key.lower() == "timecode":
                return value
    return None
