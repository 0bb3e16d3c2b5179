"""Stabilised video: the motion as the virtual fixed cameras would have filmed it, with their calibration.

For detectors and tools that want to see pictures themselves. The hall stands still in them; only what stands at the
athlete's distance or far away is exact to the pixel, since the projection centre moves by millimetres. What a camera
did not show is black.
"""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Final

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame

from pzcap.export.take import Take, write_text
from pzcap.export.virtual_cameras import VirtualCamera, athlete, virtual_cameras
from pzcap.geometry.camera import project
from pzcap.io.capture import frame_sets
from pzcap.io.files import written_whole
from pzcap.types import Array, Camera, Float32, Image, PzcapError

LONGEST_PX: Final = 3840  # width, and height, up to which a virtual camera's picture is written at its full size
_CRF: Final = "16"
_STEP: Final = 16  # px between places where the way from one picture to the other is worked out


def write(take: Take, folder: Path) -> list[Path]:
    """Write a video for each camera, and their calibration; the files. PzcapError where no capture is given."""
    if take.capture is None:
        raise PzcapError("stabilised video is made of the capture's own: give --capture FOLDER")
    virtual = tuple(replace(each, camera=scaled(each.camera)) for each in virtual_cameras(take))
    cameras = [each.opencv(each.located.name) | {"video": f"{each.located.file}.mp4"} for each in virtual]
    rate = take.reconstruction.frame_rate
    about = {"frame_rate": f"{rate.numerator}/{rate.denominator}", "cameras": cameras}
    files = [write_text(folder / "cameras.json", json.dumps(about, indent=1, ensure_ascii=False) + "\n")]
    paths = [folder / f"{each.located.file}.mp4" for each in virtual]
    places = athlete(take)
    with ExitStack() as stack:
        writers = [
            stack.enter_context(_Writer(stack.enter_context(written_whole(path)), each.camera, rate))
            for path, each in zip(paths, virtual, strict=True)
        ]
        for frames in frame_sets(take.capture):
            if frames.index >= len(places):
                break
            for writer, each in zip(writers, virtual, strict=True):
                writer.add(_stabilised(each, frames.index, frames.images[each.located.number], places[frames.index]))
    return [*files, *paths]


def scaled(camera: Camera) -> Camera:
    """The camera with a picture of even size that is no larger than is written."""
    scale = min(1.0, LONGEST_PX / max(camera.width, camera.height))
    width, height = (max(2, 2 * round(scale * size / 2)) for size in (camera.width, camera.height))
    principal = (camera.principal_px + 0.5) * scale - 0.5
    return replace(camera, width=width, height=height, focal_px=camera.focal_px * scale, principal_px=principal)


def _stabilised(each: VirtualCamera, frame: int, image: Image | None, athlete_m: Array) -> Image:
    """The picture (H, W, 3) of a virtual camera."""
    camera, real = each.camera, each.located.at(frame)
    if image is None or real is None:
        return np.zeros((camera.height, camera.width, 3), np.uint8)
    columns = np.arange(0, camera.width + _STEP, _STEP, dtype=np.float64)
    rows = np.arange(0, camera.height + _STEP, _STEP, dtype=np.float64)
    across, down = np.meshgrid(columns, rows)
    far = float(np.linalg.norm(athlete_m - camera.world_T_cam[:3, 3]))
    ways = np.stack([across - camera.principal_px[0], down - camera.principal_px[1]], axis=-1) / camera.focal_px
    ways = np.concatenate([ways, np.ones((*across.shape, 1))], axis=-1).reshape(-1, 3)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    places = camera.world_T_cam[:3, 3] + far * ways @ camera.world_T_cam[:3, :3].T
    ahead = (places - real.world_T_cam[:3, 3]) @ real.world_T_cam[:3, 2] > 0.1 * far
    pixels = np.where(ahead[:, None], project(real, places)[0], -1e4).reshape(*across.shape, 2)
    column, row = (_between(pixels[..., k], camera.width, camera.height) for k in range(2))
    return np.asarray(cv2.remap(image, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT), np.uint8)


def _between(coarse: Array, width: int, height: int) -> Float32:
    """(H, W) of values (R, C) that are known every `_STEP` pixels: distortion is smooth."""
    across, down = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    fine = cv2.remap(coarse.astype(np.float32), across / _STEP, down / _STEP, cv2.INTER_LINEAR)
    return np.asarray(fine, np.float32)


class _Writer:
    """A video file that is being written."""

    def __init__(self, path: Path, camera: Camera, rate: Fraction) -> None:
        self._container = av.open(str(path), "w", format="mp4")
        self._stream = self._container.add_stream("libx264", rate=rate, options={"crf": _CRF, "preset": "fast"})
        self._stream.width, self._stream.height = camera.width, camera.height
        self._stream.pix_fmt = "yuv420p"

    def __enter__(self) -> _Writer:
        return self

    def __exit__(self, *_: object) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()

    def add(self, image: Image) -> None:
        self._container.mux(self._stream.encode(VideoFrame.from_ndarray(image, format="bgr24")))
