"""A simulated camera: exposes, develops, records. Rendering, developing and encoding run side by side."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from pzcap.types import Array, Image, Mask, Pose
from sim.cameras.operator import PanTiltZoom
from sim.cameras.optics import Plate, Rig, lens_maps, plate_for, through_lens, vignette
from sim.cameras.render import Stage
from sim.cameras.sensor import Exposure, Sensor, SensorConfig
from sim.capture_writer import write_video
from sim.people.athlete import set_pose

_AVERAGED: Final = 0.75  # share of the supersampling that pictures averaged over several moments need

_AHEAD = 4  # frames that may wait to be developed
_SHADOW_LEVELS = 6  # grey levels by which a shadow darkens a pixel, at least

Look = Callable[[float], PanTiltZoom]
"""Pan, zoom and tilt of the camera at a time (s)."""
Person = Callable[[float], Pose]
"""Pose of the person in the hall at a time (s)."""


class Recording(NamedTuple):
    """Format of a video and way to film it."""

    frame_rate: Fraction
    crf: int
    supersampling: float  # rendered pixels for each pixel, in a frame of a single moment; of several, less
    sub_exposures: int = 1  # moments averaged over the open shutter
    light: float = 1.0  # brightness of the hall, over that by default
    timecode: str | None = None  # of the first frame
    indices: Sequence[int] | None = None  # (N,) numbers of the frames, where some are dropped


def finest_plate(rig: Rig, config: SensorConfig, zoom: float) -> tuple[int, int]:
    """Width and height of the largest picture that is rendered at a zoom."""
    scale = max(config.supersampling, config.supersampling_still)
    return plate_for(rig, rig.reference_focal_px * zoom, np.deg2rad(config.grid_turn_deg)).size(scale)


class FilmCamera:
    """One camera on its tripod in the hall."""

    def __init__(self, stage: Stage, rig: Rig, config: SensorConfig, rng: np.random.Generator) -> None:
        self._stage, self._rig, self._config = stage, rig, config
        self._averaged_scale = _AVERAGED * config.supersampling
        self._sensor = Sensor(config, vignette(rig), rng)

    def still(self, rng: np.random.Generator, aim: PanTiltZoom | None = None) -> Image:
        """Photograph the calibration object at the reference pose, or with another ``aim``; nobody in the hall."""
        scale = self._config.supersampling_still
        aim = aim or PanTiltZoom(0.0, self._rig.reference_focal_px)
        focal_px = aim.focal_px
        plate = self._aim(lambda _: aim, 0.0, None)
        light = self._stage.picture(plate.size(scale), athlete=False, calibration_object=True)
        return self._develop(light, focal_px, scale, Exposure(self._config.exposure_drift, rng)(0.0), rng)

    def record(
        self, path: Path, look: Look, times_s: Array, person: Person | None, how: Recording, rng: np.random.Generator
    ) -> Iterator[int]:
        """Record a video; yield each frame's number once it is exposed. The video is complete at the end.

        times_s: (N,) the middle of each exposure, which lasts ``shutter_s``. person: None if nobody is in the hall.
        """
        exposure = Exposure(self._config.exposure_drift, rng)
        moments = how.sub_exposures if self._config.shutter_s > 0 else 1
        offsets_s = ((np.arange(moments) + 0.5) / moments - 0.5) * self._config.shutter_s
        scale = how.supersampling if moments == 1 else _AVERAGED * how.supersampling
        exposed: queue.Queue[tuple[Image, float, float] | None] = queue.Queue(_AHEAD)

        def developed() -> Iterator[Image]:
            while (item := exposed.get()) is not None:
                plate, focal_px, gain = item
                yield self._develop(plate, focal_px, scale, gain, rng)

        with ThreadPoolExecutor(1) as pool:
            encoding = pool.submit(
                write_video, path, developed(), how.frame_rate, crf=how.crf, timecode=how.timecode, indices=how.indices
            )
            try:
                for k, time_s in enumerate(times_s.tolist()):
                    focal_px = look(time_s).focal_px
                    plate = self._expose(look, time_s + offsets_s, focal_px, scale, person)
                    _put(exposed, (plate, focal_px, how.light * exposure(time_s)), encoding)
                    if encoding.done():
                        break
                    yield k
            finally:
                _put(exposed, None, encoding)
            encoding.result()

    def mask(self, look: Look, time_s: float, person: Person) -> Mask:
        """(height, width) the pixels that show the person."""
        plate = self._aim(look, time_s, person)
        # finer than the image, as pictures are: else an edge would stand up to half a pixel beside itself
        maps = lens_maps(self._rig, plate, look(time_s).focal_px, self._averaged_scale)
        return np.asarray(through_lens(self._stage.mask(plate.size(self._averaged_scale)), maps, self._rig) > 127)

    def shadow(self, look: Look, time_s: float, person: Person, mask: Mask) -> Mask:
        """(height, width) the pixels that the person's shadow darkens, off the person's own ``mask``."""
        plate = self._aim(look, time_s, person)
        maps = lens_maps(self._rig, plate, look(time_s).focal_px, self._averaged_scale)
        lit, dark = (
            through_lens(self._stage.picture(plate.size(self._averaged_scale), athlete=shown), maps, self._rig)
            for shown in (False, True)
        )
        darker = lit.mean(axis=2) - dark.mean(axis=2) > _SHADOW_LEVELS
        body = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))
        return np.asarray(darker & (body == 0))

    def _aim(self, look: Look, time_s: float, person: Person | None, focal_px: float | None = None) -> Plate:
        """Set the scene for one moment; return the plate to render. ``focal_px`` overrules what the trajectory says."""
        aim = look(time_s)
        focal_px = focal_px or aim.focal_px
        if person is not None:
            set_pose(self._stage.model, self._stage.data, person(time_s))
        plate = self._plate(focal_px)
        world_T_cam = self._rig.world_T_cam(aim.pan_rad, focal_px, aim.raised_rad)
        self._stage.aim(plate.turn(world_T_cam), plate.vertical_view_deg(focal_px))
        return plate

    def _plate(self, focal_px: float) -> Plate:
        return plate_for(self._rig, focal_px, np.deg2rad(self._config.grid_turn_deg))

    def _expose(self, look: Look, times_s: Array, focal_px: float, scale: float, person: Person | None) -> Image:
        """The mean of the plates at these times, during which the focal length hardly changes."""
        total = np.zeros(0, np.uint16)
        for k, time_s in enumerate(times_s.tolist()):
            plate = self._aim(look, time_s, person, focal_px)
            picture = self._stage.picture(plate.size(scale), athlete=person is not None)
            if len(times_s) == 1:
                return picture
            total = picture.astype(np.uint16) if k == 0 else np.asarray(cv2.add(total, picture, dtype=cv2.CV_16U))
        return np.asarray(cv2.convertScaleAbs(total, alpha=1 / len(times_s)), np.uint8)

    def _develop(self, light: Image, focal_px: float, scale: float, gain: float, rng: np.random.Generator) -> Image:
        maps = lens_maps(self._rig, self._plate(focal_px), focal_px, scale)
        return self._sensor.develop(through_lens(light, maps, self._rig), gain, rng)


def _put(exposed: queue.Queue, item: object, encoding: Future[None]) -> None:
    """Hand over, unless the encoder has failed, which then shows when its result is asked for."""
    while not encoding.done():
        try:
            exposed.put(item, timeout=0.5)
        except queue.Full:
            continue
        return
