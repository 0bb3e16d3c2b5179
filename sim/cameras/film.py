"""A simulated camera: what its lens lets through, picture by picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, Image, Mask, Pose
from sim.cameras.operator import PanTiltZoom
from sim.cameras.optics import Rig
from sim.cameras.plate import (
    Maps,
    Moment,
    Plate,
    fine_size,
    lens_maps,
    plate_for,
    plate_under,
    roll,
    rolled_maps,
    sampled,
    shrunk,
    through_lens,
)
from sim.cameras.render import Stage
from sim.cameras.sensor import SensorConfig, row_delay_s
from sim.people.athlete import set_pose

_AVERAGED: Final = 0.75  # share of the supersampling that pictures averaged over several moments need
_SHADOW_LEVELS: Final = 6  # grey levels by which a shadow darkens a pixel, at least
_PLATES_S: Final = 3.3e-3  # between plates of a rolling shutter: a limb of 10 m/s steps by 17 mm at most, at the hand
_INSTANT: Final = np.zeros(1)
_ALONE: Final = np.ones((1, 1))
_ROWS: Final = np.array([[0.25], [0.5], [0.25]])
_HALL_MOMENTS: Final = 4  # of an open shutter in the sweep: half a pixel from one to the next where it blurs two

Look = Callable[[float], PanTiltZoom]
"""Pan, zoom and tilt of the camera at a time (s)."""
Person = Callable[[float], Pose]
"""Pose of the person in the hall at a time (s)."""
Draw = Callable[[tuple[int, int]], Image]
"""Picture, or mask, of so many pixels (width, height) of the scene that is set."""


def finest_plate(rig: Rig, config: SensorConfig, zoom: float) -> tuple[int, int]:
    """Width and height of the largest picture that is rendered at a zoom."""
    scale = max(config.supersampling, config.supersampling_hall, config.supersampling_still)
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
        plate = self._plate(self._moment(aim))
        picture = self._stage.picture(plate.size(scale), athlete=False, calibration_object=True)
        return through_lens(picture, self._maps(plate, aim.focal_px, scale), self._rig)

    def instant(self, look: Look, time_s: float, person: Person | None) -> Image:
        """A frame of the sweep or the zoom run, most often of one moment. person: None if nobody is in the hall."""
        open_s = self._config.hall_shutter_s
        offsets_s = _moments(_HALL_MOMENTS) * open_s if open_s else _INSTANT
        return self._exposed(look, time_s, offsets_s, person, self._config.supersampling_hall)

    def exposure(self, look: Look, time_s: float, person: Person) -> Image:
        """The mean over the open shutter, whose middle is ``time_s``: a frame of the motion."""
        moments = self._config.sub_exposures if self._config.shutter_s > 0 else 1
        offsets_s = _moments(moments) * self._config.shutter_s
        scale = self._config.supersampling if moments == 1 else self._averaged_scale
        return self._exposed(look, time_s, offsets_s, person, scale)

    def mask(self, look: Look, time_s: float, person: Person) -> Mask:
        """(height, width) the pixels that show the person."""
        # finer than the image, as pictures are: else an edge would stand up to half a pixel beside itself
        seen = self._through(look, time_s, _INSTANT, person, self._averaged_scale, self._stage.mask)
        return np.asarray(seen > 127)

    def shadow(self, look: Look, time_s: float, person: Person, mask: Mask) -> Mask:
        """(height, width) the pixels that the person's shadow darkens, off the person's own ``mask``."""
        lit, dark = (
            self._through(
                look, time_s, _INSTANT, person, self._averaged_scale, partial(self._stage.picture, athlete=on)
            )
            for on in (False, True)
        )
        darker = lit.mean(axis=2) - dark.mean(axis=2) > _SHADOW_LEVELS
        body = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))
        return np.asarray(darker & (body == 0))

    def _exposed(self, look: Look, time_s: float, offsets_s: Array, person: Person | None, scale: float) -> Image:
        """The mean of the pictures at these offsets (N,) from ``time_s``. person: None if nobody is in the hall."""
        draw = partial(self._stage.picture, athlete=person is not None)
        return self._through(look, time_s, offsets_s, person, scale, draw)

    def _through(
        self, look: Look, time_s: float, offsets_s: Array, person: Person | None, scale: float, draw: Draw
    ) -> Image:
        """The mean of what is drawn at these offsets (N,) from ``time_s``, through the lens; woven of two fields."""
        field_s = self._config.field_s
        if not field_s:
            return self._whole(look, time_s, offsets_s, person, scale, draw)
        times_s = [time_s] if self._config.bob else [time_s, time_s + field_s]
        return _woven([self._whole(look, t, offsets_s, person, scale, draw) for t in times_s])

    def _whole(
        self, look: Look, time_s: float, offsets_s: Array, person: Person | None, scale: float, draw: Draw
    ) -> Image:
        """The same of all rows in one go."""
        if self._config.readout_s or (person is None and len(offsets_s) > 1):  # of an empty hall a plate is enough
            return self._rolled(look, time_s, offsets_s, person, scale, draw)
        focal_px = look(time_s).focal_px  # all pictures have it
        pictures = []
        for moment_s in (time_s + offsets_s).tolist():
            self._pose(person, moment_s)
            plate = self._plate(self._moment(look(moment_s)._replace(focal_px=focal_px)))
            pictures.append(draw(plate.size(scale)))
        return through_lens(_mean(pictures), self._maps(plate, focal_px, scale), self._rig)

    def _maps(self, plate: Plate, focal_px: float, scale: float) -> list[Maps]:
        return [lens_maps(self._rig, plate, focal_px, scale, stretch) for stretch in self._rig.stretches]

    def _rolled(
        self, look: Look, time_s: float, offsets_s: Array, person: Person | None, scale: float, draw: Draw
    ) -> Image:
        """The same, each row at its own time.

        Plates are drawn at a few moments, where the hall is empty at one. A row takes the nearest, through the camera
        of its own time (`plate.roll`): the hall is exact in every row, and of a body alone the motion is in steps.
        """
        rig, readout_s, turned_rad = self._rig, self._config.readout_s, np.deg2rad(self._config.grid_turn_deg)
        width, height = fine_size(rig, scale).tolist()
        delays_s = row_delay_s((np.arange(height) + 0.5) / scale - 0.5, rig.height, readout_s)
        span_s = abs(readout_s) + np.ptp(offsets_s)
        plates = 1 if person is None else math.ceil(span_s / _PLATES_S)
        middle_s = time_s + (offsets_s.min() + offsets_s.max()) / 2
        total = None
        for k, plate_s in enumerate((middle_s + ((np.arange(plates) + 0.5) / plates - 0.5) * span_s).tolist()):
            camera = self._moment(look(plate_s))
            pieces = []
            for exposed_s in (time_s + offsets_s).tolist():
                nearest = np.floor(((exposed_s + delays_s - middle_s) / span_s + 0.5) * plates)
                rows = np.flatnonzero(np.clip(nearest, 0, plates - 1) == k)
                if len(rows):
                    own = partial(self._cameras_of_rows, look, exposed_s)
                    pieces.append(roll(rig, camera, own, range(rows[0], rows[-1] + 1), turned_rad, scale))
            if not pieces:
                continue
            plate = plate_under(pieces, turned_rad, scale)
            self._pose(person, plate_s)
            up = plate.up_px / plate.height
            self._stage.aim(plate.turn(camera.world_T_cam), plate.vertical_view_deg(camera.focal_px), up)
            picture = draw(plate.size(scale))
            if total is None:
                total = np.zeros((height, width, *picture.shape[2:]), np.uint16)
            for piece in pieces:
                part, maps = total[piece.rows.start : piece.rows.stop], rolled_maps(piece, plate, scale, width)
                cv2.add(part, sampled(picture, maps), dst=part, dtype=cv2.CV_16U)
        assert total is not None
        return shrunk(_share(total, len(offsets_s)), rig)

    def _cameras_of_rows(self, look: Look, exposed_s: float, rows: Array) -> tuple[Array, Array]:
        """Rotation (N, 3, 3) and focal length (N,) of the camera as it exposes each of the image's ``rows`` (N,)."""
        delays_s = row_delay_s(rows, self._rig.height, self._config.readout_s)
        aims = np.array([look(t) for t in (exposed_s + delays_s).tolist()])
        return self._rig.turns(aims[:, 0], aims[:, 2], aims[:, 3]), aims[:, 1]

    def _moment(self, aim: PanTiltZoom) -> Moment:
        world_T_cam = self._rig.world_T_cam(aim.pan_rad, aim.focal_px, aim.raised_rad, aim.rolled_rad)
        return Moment(world_T_cam, aim.focal_px)

    def _pose(self, person: Person | None, time_s: float) -> None:
        if person is not None:
            set_pose(self._stage.model, self._stage.data, person(time_s))
            self._stage.accompany(time_s)

    def _plate(self, camera: Moment) -> Plate:
        """Aim at what a camera sees; return the plate to draw."""
        plate = plate_for(self._rig, camera.focal_px, np.deg2rad(self._config.grid_turn_deg))
        self._stage.aim(plate.turn(camera.world_T_cam), plate.vertical_view_deg(camera.focal_px))
        return plate


def _woven(pictures: Sequence[Image]) -> Image:
    """A frame with the even rows of the first picture and the odd ones of the second, or what is between those.

    Of a field each row is the mean of a row and half of either neighbour, as interlaced sensors read them.
    """
    fields = [np.asarray(cv2.sepFilter2D(one, -1, _ALONE, _ROWS, borderType=cv2.BORDER_REPLICATE)) for one in pictures]
    woven = fields[0].copy()
    if len(fields) == 2:
        woven[1::2] = fields[1][1::2]
    else:
        below = np.concatenate([woven[2::2], woven[-2:-1]])[: len(woven[1::2])]
        woven[1::2] = cv2.addWeighted(np.ascontiguousarray(woven[:-1:2]), 0.5, below, 0.5, 0.0)
    return np.asarray(woven, np.uint8)


def _moments(count: int) -> Array:
    """(count,) moments spread evenly over an open shutter, from -1/2 to 1/2."""
    return np.asarray((np.arange(count) + 0.5) / count - 0.5)


def _mean(pictures: Sequence[Image]) -> Image:
    if len(pictures) == 1:
        return pictures[0]
    total = pictures[0].astype(np.uint16)
    for picture in pictures[1:]:
        cv2.add(total, picture, dst=total, dtype=cv2.CV_16U)
    return _share(total, len(pictures))


def _share(total: NDArray[np.uint16], pictures: int) -> Image:
    """The mean of so many pictures from their sum."""
    return np.asarray(cv2.convertScaleAbs(total, alpha=1 / pictures), np.uint8)
