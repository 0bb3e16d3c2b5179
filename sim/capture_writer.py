"""Capture folders, written: the JSON files, and video with timecode. docs/capture.md specifies the format.

Only H.264 is written. A dropped frame is a gap in the indices (`pzcap.io.video`).
"""

from __future__ import annotations

import errno
import json
from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import count
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.audio.frame import AudioFrame
from av.audio.stream import AudioStream
from av.container import OutputContainer
from av.video.frame import PictureType, VideoFrame
from numpy.typing import NDArray

from pzcap.io.capture import FOOTAGE, FORMAT, MANIFEST, VERSION
from pzcap.types import (
    SEGMENTS,
    CalibrationObject,
    CameraFiles,
    Capture,
    Image,
    KnownLength,
    Mark,
    Pose,
    PzcapError,
    Subject,
)
from sim.hall.sound import SAMPLES_PER_S

_SOUND_FRAME = 1024  # samples that AAC encodes at once


def write_capture(capture: Capture) -> None:
    """Write the JSON files of ``capture`` into its folder, which holds the images and videos already."""

    def relative(path: Path | None) -> str | None:
        return path.relative_to(capture.folder).as_posix() if path else None

    manifest: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": capture.name,
        "frame_rate": f"{capture.frame_rate.numerator}/{capture.frame_rate.denominator}",
        "full_turn": capture.full_turn,
        "cameras": [
            {"name": c.name, **{kind: relative(getattr(c, kind)) for kind in _places(c)}, **_counted_from(c)}
            for c in capture.cameras
        ],
    }
    if capture.calibration_object is not None:
        manifest["object"] = "object.json"
        write_object(capture.folder / "object.json", capture.calibration_object)
    if capture.subject is not None:
        manifest["subject"] = "subject.json"
        write_subject(capture.folder / "subject.json", capture.subject)
    if capture.keyframe_poses:
        manifest["keyframes"] = "keyframes.json"
        write_keyframes(capture.folder / "keyframes.json", capture.keyframe_poses)
    if capture.lengths:
        manifest["lengths"] = "lengths.json"
        write_lengths(capture.folder / "lengths.json", capture.lengths)
    dump_json(capture.folder / MANIFEST, manifest)


def _places(camera: CameraFiles) -> tuple[str, ...]:
    """Entries that are written of a camera: all its footage, with null for what is missing, and keypoints if it has
    them."""
    return (*FOOTAGE, "keypoints") if camera.keypoints else FOOTAGE


def _counted_from(camera: CameraFiles) -> dict[str, int]:
    return {} if camera.keypoints_from is None else {"keypoints_from": camera.keypoints_from}


def write_object(path: Path, definition: CalibrationObject) -> None:
    """Write object.json."""
    markers = [{"id": marker.id, "corners_m": marker.corners_m.tolist()} for marker in definition.markers]
    wireframe = definition.wireframe_m.tolist()
    dump_json(path, {"dictionary": definition.dictionary, "markers": markers, "wireframe_m": wireframe})


def write_subject(path: Path, subject: Subject) -> None:
    """Write subject.json."""
    own: dict[str, Any] = {"sigmas_m": {**subject.sigmas_m}, "loose_m": {**subject.loose_m}}
    own |= {"mass_kg": subject.mass_kg, "sex": subject.sex}
    given = {key: value for key, value in own.items() if value}
    dump_json(path, {"measurements_m": subject.measurements_m, "sigma_m": subject.sigma_m, **given})


def write_keyframes(path: Path, poses: dict[str, Pose]) -> None:
    """Write keyframes.json: the poses by timecode."""
    keyframes = [
        {
            "timecode": timecode,
            "root_position_m": pose.root_position_m.tolist(),
            "rotations_wxyz": dict(zip(SEGMENTS, pose.rotations.tolist(), strict=True)),
        }
        for timecode, pose in poses.items()
    ]
    dump_json(path, keyframes)


def write_lengths(path: Path, lengths: Sequence[KnownLength]) -> None:
    """Write lengths.json."""

    def marks(end: Sequence[Mark]) -> list[dict[str, Any]]:
        return [{"camera": m.camera, "video": m.video, "frame": m.frame, "px": m.px.tolist()} for m in end]

    entries = [
        {"name": one.name, "length_m": one.length_m, "sigma_m": one.sigma_m, "from": marks(one.ends[0]),
         "to": marks(one.ends[1])}
        for one in lengths
    ]  # fmt: skip
    dump_json(path, entries)


def dump_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def write_video(
    path: Path,
    frames: Iterable[Image],
    frame_rate: Fraction,
    *,
    crf: int,
    timecode: str | None = None,
    indices: Sequence[int] | None = None,
    interlaced: bool = False,
    sound: NDArray[np.float32] | None = None,
) -> None:
    """Encode (H, W, 3) images of even size as H.264 (4:2:0). The same frames give the same bytes on every machine.

    crf: x264's constant rate factor, 0 (lossless but for the colour subsampling) to 51.
    timecode: SMPTE timecode of index 0.
    indices: the index of each frame, strictly increasing; by default 0, 1, 2, ... A gap stands for dropped frames.
    interlaced: images are woven of two fields, the even rows of the first.
    sound: (N,) samples from the time of index 0 on, 48,000 a second; it becomes AAC, as cameras record it.
    Raises PzcapError if the disk is full or the file cannot be written.
    """
    started = False
    try:
        with av.open(str(path), "w") as container:
            # One thread, since x264's output depends on how many there are; no macroblock tree, since that reads memory
            # that nobody wrote, and the same frames then give other bytes in another process.
            special = "mbtree=0:tff=1" if interlaced else "mbtree=0"
            options = {"crf": str(crf), "preset": "veryfast", "threads": "1", "x264-params": special}
            stream = container.add_stream("libx264", rate=frame_rate, options=options)
            stream.pix_fmt = "yuv420p"
            track = None if sound is None else container.add_stream("aac", rate=SAMPLES_PER_S, options={"b": "128k"})
            stream.codec_context.time_base = 1 / frame_rate
            if timecode is not None:
                stream.metadata["timecode"] = timecode
            for index, image in zip(count() if indices is None else indices, frames, strict=indices is not None):
                if not started:
                    stream.height, stream.width = image.shape[:2]
                    started = True
                    if track is not None and sound is not None:
                        _add_sound(container, track, sound)
                frame = VideoFrame.from_ndarray(_to_yuv(image), format="yuv420p")
                frame.pts, frame.time_base, frame.pict_type = index, 1 / frame_rate, PictureType.NONE
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    except OSError as error:  # FFmpegError is one too
        reason = "the disk is full; free some space" if error.errno == errno.ENOSPC else error.strerror
        raise PzcapError(f"{path}: cannot write the video: {reason}") from error


def _add_sound(container: OutputContainer, track: AudioStream, samples: NDArray[np.float32]) -> None:
    track.codec_context.layout = "mono"
    for start in range(0, len(samples), _SOUND_FRAME):
        frame = AudioFrame.from_ndarray(samples[None, start : start + _SOUND_FRAME], format="fltp", layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = SAMPLES_PER_S, start, Fraction(1, SAMPLES_PER_S)
        container.mux(track.encode(frame))
    container.mux(track.encode())


def _to_yuv(image: Image) -> Image:
    """(H, W, 3) to planar 4:2:0, (3/2 H, W).

    Not by FFmpeg's own converter, whose fast path is off by up to four grey levels, nor by OpenCV's alone, which takes
    a block's colour from its top left pixel: each 2 x 2 block is given its mean colour first.
    """
    height, width = image.shape[:2]
    mean = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    mean = cv2.resize(mean, (width, height), interpolation=cv2.INTER_NEAREST)
    yuv = np.asarray(cv2.cvtColor(mean, cv2.COLOR_BGR2YUV_I420), np.uint8)
    yuv[:height] = cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420)[:height]
    return yuv
