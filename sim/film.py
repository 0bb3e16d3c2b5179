"""A camera at work: it exposes, develops and records. Rendering, developing and encoding go on side by side."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, Image, Mask, Pose
from pzcap.video import write_video
from sim.athlete import set_pose
from sim.optics import Plate, Rig, lens_maps, through_lens, vignette
from sim.render import Stage
from sim.sensor import Exposure, Sensor, SensorConfig

_AHEAD = 4  # frames that may wait to be developed
_SHADOW_LEVELS = 6  # grey levels by which a shadow darkens a pixel, at least

Look = Callable[[float], tuple[float, float]]
"""Pan (rad) and focal length (px) at a time (s)."""


class FilmCamera:
    """One camera on its tripod in the hall. ``pose_at`` gives the athlete's pose at a time."""

    def __init__(
        self,
        stage: Stage,
        plate: Plate,
        rig: Rig,
        pose_at: Callable[[float], Pose],
        config: SensorConfig,
        rng: np.random.Generator,
    ) -> None:
        self._stage, self._plate, self._rig, self._pose_at, self._config = stage, plate, rig, pose_at, config
        self._sensor = Sensor(config, vignette(rig), rng)

    def still(self, rng: np.random.Generator) -> Image:
        """Photograph the calibration object at the reference pose, nobody in the hall."""
        focal_px = self._rig.reference_focal_px
        self._stage.aim(self._rig.world_T_cam(0.0, focal_px), focal_px)
        light = self._stage.picture(athlete=False, calibration_object=True)
        return self._develop(light, focal_px, 1, Exposure(self._config.exposure_drift, rng)(0.0), rng)

    def record(
        self,
        path: Path,
        look: Look,
        times_s: Array,
        *,
        athlete: bool,
        frame_rate: Fraction,
        crf: int,
        sub_exposures: int,
        rng: np.random.Generator,
        timecode: str | None = None,
        indices: Sequence[int] | None = None,
    ) -> Iterator[int]:
        """Record a video; yield each frame's number once it is exposed. The video is complete at the end.

        times_s: (N,) the middle of each exposure, which lasts ``shutter_s`` and averages ``sub_exposures`` moments.
        """
        exposure = Exposure(self._config.exposure_drift, rng)
        offsets_s = ((np.arange(sub_exposures) + 0.5) / sub_exposures - 0.5) * self._config.shutter_s
        exposed: queue.Queue[tuple[Image | NDArray[np.uint16], float, float] | None] = queue.Queue(_AHEAD)

        def developed() -> Iterator[Image]:
            while (item := exposed.get()) is not None:
                light, focal_px, gain = item
                yield self._develop(light, focal_px, sub_exposures, gain, rng)

        with ThreadPoolExecutor(1) as pool:
            encoding = pool.submit(
                write_video, path, developed(), frame_rate, crf=crf, timecode=timecode, indices=indices
            )
            try:
                for k, time_s in enumerate(times_s.tolist()):
                    light = self._expose(look, time_s + offsets_s, athlete)
                    _put(exposed, (light, look(time_s)[1], exposure(time_s)), encoding)
                    yield k
            finally:
                _put(exposed, None, encoding)
            encoding.result()

    def mask(self, look: Look, time_s: float) -> Mask:
        """(height, width) the pixels that show the athlete."""
        focal_px = self._aim(look, time_s, athlete=True)
        maps = lens_maps(self._rig, self._plate, focal_px, 1)
        return np.asarray(through_lens(self._stage.mask(), maps, self._rig) > 127)

    def shadow(self, look: Look, time_s: float, mask: Mask) -> Mask:
        """(height, width) the pixels that the athlete's shadow darkens, off the athlete's own ``mask``."""
        focal_px = self._aim(look, time_s, athlete=True)
        maps = lens_maps(self._rig, self._plate, focal_px, self._plate.scale)
        lit, dark = (
            through_lens(self._stage.picture(athlete=shown), maps, self._rig).astype(np.float32).mean(axis=2)
            for shown in (False, True)
        )
        return np.asarray(
            (lit - dark > _SHADOW_LEVELS) & ~cv2.dilate(mask.astype(np.uint8), np.ones((3, 3))).astype(bool)
        )

    def _aim(self, look: Look, time_s: float, athlete: bool) -> float:
        pan_rad, focal_px = look(time_s)
        if athlete:
            set_pose(self._stage.model, self._stage.data, self._pose_at(time_s))
        self._stage.aim(self._rig.world_T_cam(pan_rad, focal_px), focal_px)
        return focal_px

    def _expose(self, look: Look, times_s: Array, athlete: bool) -> Image | NDArray[np.uint16]:
        """The sum of the plates at these times."""
        total: Image | NDArray[np.uint16] | None = None
        for time_s in times_s.tolist():
            self._aim(look, time_s, athlete)
            picture = self._stage.picture(athlete=athlete)
            total = picture if total is None else np.asarray(cv2.add(total, picture, dtype=cv2.CV_16U), np.uint16)
        assert total is not None
        return total

    def _develop(
        self, light: Image | NDArray[np.uint16], focal_px: float, exposures: int, gain: float, rng: np.random.Generator
    ) -> Image:
        maps = lens_maps(self._rig, self._plate, focal_px, self._plate.scale)
        return self._sensor.develop(through_lens(light, maps, self._rig), gain / exposures, rng)


def _put(exposed: queue.Queue, item: object, encoding: Future[None]) -> None:
    """Hand over, unless the encoder has failed, which then shows when its result is asked for."""
    while not encoding.done():
        try:
            exposed.put(item, timeout=0.5)
        except queue.Full:
            continue
        return
