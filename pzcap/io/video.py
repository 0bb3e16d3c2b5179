"""Frame-accurate video and SMPTE timecode; anything that FFmpeg decodes is read.

Time is counted in whole frames: a frame's *index* is its presentation time times the frame rate, rounded. A dropped
frame is a gap in the indices, and the timecode of a frame is the video's start timecode plus its index.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation
from av.video.stream import VideoStream
from numpy.typing import NDArray

from pzcap.io.files import checked
from pzcap.types import Image, PzcapError

_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d):(\d\d)")


def frames_per_day(rate: Fraction) -> int:
    """Timecodes repeat after this many frames. Non-drop timecode counts ``round(rate)`` frames a second."""
    return 24 * 3600 * round(rate)


def timecode_to_frames(timecode: str, rate: Fraction) -> int:
    """Frames since midnight of a non-drop SMPTE ``timecode`` "hh:mm:ss:ff".

    Raises PzcapError if it is malformed or a drop-frame timecode ("hh:mm:ss;ff").
    """
    match = _TIMECODE.fullmatch(timecode)
    if match is None:
        raise PzcapError(f'timecode "{timecode}" is not "hh:mm:ss:ff" (non-drop); set the clock to non-drop timecode')
    hours, minutes, seconds, frames = (int(group) for group in match.groups())
    if hours > 23 or minutes > 59 or seconds > 59 or frames >= round(rate):
        raise PzcapError(f'timecode "{timecode}" does not exist at {rate} frames/s; check the clock\'s frame rate')
    return ((hours * 60 + minutes) * 60 + seconds) * round(rate) + frames


def frames_to_timecode(frames: int, rate: Fraction) -> str:
    """The inverse of `timecode_to_frames`; wraps at midnight."""
    seconds, frame = divmod(frames % frames_per_day(rate), round(rate))
    return f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}:{frame:02}"


class VideoReader:
    """A video file, opened and checked: its packets are listed (which is quick), none is decoded yet.

    Attributes: ``width``, ``height``, ``frame_rate`` (Fraction), ``timecode`` (str, or None if the file has none),
    ``indices`` (frame_count,) int64 increasing, ``frame_count``.

    Raises PzcapError if the file is missing, is no video, is empty, truncated, or has a variable frame rate.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._open() as container:
            stream = self._stream(container)
            self.width, self.height = stream.codec_context.width, stream.codec_context.height
            rate = stream.guessed_rate
            if not rate or self.width == 0:
                raise PzcapError(f"{path}: the video holds no decodable frame; copy it again from the camera")
            self.frame_rate = Fraction(rate)
            self.timecode = _find_timecode(container)
            try:
                packets = [(p.pts * p.time_base, p.is_discard) for p in container.demux(stream) if p.pts is not None]
            except FFmpegError as error:
                raise self._broken() from error
            declared = stream.frames
        if len(packets) < declared:
            raise self._broken()
        # What an edit list cuts off is decoded, but not shown.
        times = [time for time, discard in packets if not discard]
        if not times:
            raise PzcapError(f"{path}: the video holds no frames; copy it again from the camera")
        self.indices: NDArray[np.int64] = np.array(sorted(round(time * self.frame_rate) for time in times), np.int64)
        if np.any(np.diff(self.indices) < 1):
            raise PzcapError(f"{path}: the frame rate varies; convert it to a constant {self.frame_rate} frames/s")
        self.frame_count = len(self.indices)

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        return self.read()

    def read(self, start: int = 0, stop: int | None = None) -> Iterator[tuple[int, Image]]:
        """Decode the frames whose index lies in [start, stop), in order: (index, image (H, W, 3)).

        Memory is constant in the length of the video. Raises PzcapError where a frame cannot be decoded.
        """
        wanted = self.indices[(self.indices >= start) & (self.indices < (np.inf if stop is None else stop))]
        if len(wanted) == 0:
            return
        done = 0
        with self._open() as container:
            stream = self._stream(container)
            if wanted[0] > self.indices[0]:
                offset = round(int(wanted[0]) / self.frame_rate / stream.time_base) if stream.time_base else 0
                container.seek(offset, stream=stream)  # lands on the last intra frame before
            try:
                for frame in container.decode(stream):
                    index = round((frame.pts or 0) * (frame.time_base or 0) * self.frame_rate)
                    if index < wanted[0]:
                        continue
                    if index != wanted[done] or frame.is_corrupt:
                        break
                    yield index, _to_bgr(frame)
                    done += 1
                    if done == len(wanted):
                        return
            except FFmpegError as error:
                raise self._broken(int(wanted[done])) from error
        raise self._broken(int(wanted[done]))

    def _open(self) -> av.container.InputContainer:
        try:
            return av.open(str(checked(self.path)))
        except FFmpegError as error:
            if not self.path.is_file():
                raise PzcapError(f"{self.path}: no such video; copy it from the camera") from error
            raise self._broken() from error

    def _stream(self, container: av.container.InputContainer) -> VideoStream:
        if not container.streams.video:
            raise PzcapError(f"{self.path}: the file holds no video; copy it again from the camera")
        stream = container.streams.video[0]
        # A damaged frame must raise, not be patched up with what stood there before.
        stream.codec_context.options = {"err_detect": "explode"}
        return stream

    def _broken(self, index: int | None = None) -> PzcapError:
        where = "" if index is None else f" at frame {index}"
        return PzcapError(f"{self.path}: the video is truncated or damaged{where}; copy it again from the camera")


def _to_bgr(frame: VideoFrame) -> Image:
    if frame.format.name == "yuv420p" and frame.width % 2 == frame.height % 2 == 0:
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
