"""A simulated camera: what its lens lets through, picture by picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np

from pzcap.types import Array, Image, Mask, Pose
from sim.cameras.operator import PanTiltZoom
from sim.cameras.optics import Plate, Rig, lens_maps, plate_for, through_lens
from sim.cameras.render import Stage
from sim.cameras.sensor import SensorConfig
from sim.people.athlete import set_pose

_AVERAGED: Final = 0.75  # share of the supersampling that pictures averaged over several moments need
_SHADOW_LEVELS: Final = 6  # grey levels by which a shadow darkens a pixel, at least

Look = Callable[[float], PanTiltZoom]
"""Pan, zoom and tilt of the camera at a time (s)."""
Person = Callable[[float], Pose]
"""Pose of the person in the hall at a time (s)."""


def finest_plate(rig: Rig, config: SensorConfig, zoom: float) -> tuple[int, int]:
    """Width and height of the largest picture that is rendered at a zoom."""
    scale = max(config.supersampling, config.supersampling_still)
    return plate_for(rig, rig.reference_focal_px * zoom, np.deg2rad(config.grid_turn_deg)).size(scale)


class FilmCamera:
    """One camera on its tripod in the hall. Pictures are light: (height, width, 3) red-green-blue, without noise."""

    def __init__(self, stage: Stage, rig: Rig, config: SensorConfig) -> None:
        self._stage, self._rig, self._config = stage, rig, config
        self._averaged_scale = _AVERAGED * config.supersampling

    def still(self, aim: PanTiltZoom | None = None) -> Image:
        """The calibration object at the reference pose, or with another ``aim``; nobody is in the hall."""
        scale = self._config.supersampling_still
        aim = aim or PanTiltZoom(0.0, self._rig.reference_focal_px)
        plate = self._aim(lambda _: aim, 0.0, None)
        picture = self._stage.picture(plate.size(scale), athlete=False, calibration_object=True)
        return through_lens(picture, lens_maps(self._rig, plate, aim.focal_px, scale), self._rig)

    def instant(self, look: Look, time_s: float, person: Person | None) -> Image:
        """One moment, as frames of the sweep and the zoom run are rendered. person: None if nobody is in the hall."""
        return self._exposed(look, time_s, np.zeros(1), person, self._config.supersampling_still)

    def exposure(self, look: Look, time_s: float, person: Person) -> Image:
        """The mean over the open shutter, whose middle is ``time_s``: a frame of the motion."""
        moments = self._config.sub_exposures if self._config.shutter_s > 0 else 1
        offsets_s = ((np.arange(moments) + 0.5) / moments - 0.5) * self._config.shutter_s
        scale = self._config.supersampling if moments == 1 else self._averaged_scale
        return self._exposed(look, time_s, offsets_s, person, scale)

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
        plate = plate_for(self._rig, focal_px, np.deg2rad(self._config.grid_turn_deg))
        world_T_cam = self._rig.world_T_cam(aim.pan_rad, focal_px, aim.raised_rad)
        self._stage.aim(plate.turn(world_T_cam), plate.vertical_view_deg(focal_px))
        return plate

    def _exposed(self, look: Look, time_s: float, offsets_s: Array, person: Person | None, scale: float) -> Image:
        """The mean of the pictures at these offsets (N,) from ``time_s``, whose focal length they all have."""
        focal_px = look(time_s).focal_px
        pictures = []
        for moment_s in (time_s + offsets_s).tolist():
            plate = self._aim(look, moment_s, person, focal_px)
            pictures.append(self._stage.picture(plate.size(scale), athlete=person is not None))
        light = pictures[0]
        if len(pictures) > 1:
            total = light.astype(np.uint16)
            for picture in pictures[1:]:
                cv2.add(total, picture, dst=total, dtype=cv2.CV_16U)
            light = np.asarray(cv2.convertScaleAbs(total, alpha=1 / len(pictures)), np.uint8)
        return through_lens(light, lens_maps(self._rig, plate, focal_px, scale), self._rig)
