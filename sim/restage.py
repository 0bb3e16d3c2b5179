"""Further pictures of a shoot that was filmed before: the same hall, tripods and athlete, set up again."""

from __future__ import annotations

import numpy as np

from pzcap.types import Camera, Image, Pose
from sim.cameras.film import FilmCamera
from sim.cameras.operator import PanTiltZoom
from sim.cameras.optics import vignette
from sim.cameras.sensor import Exposure, Sensor
from sim.people.athlete import set_pose
from sim.scene import stream
from sim.session import ShootConfig, assemble


class Hall:
    """The hall, the tripods and the athlete of a shoot. Use it as a context manager."""

    def __init__(self, config: ShootConfig) -> None:
        self._config, self._session = config, assemble(config)
        self._stage = self._session.stage()

    def __enter__(self) -> Hall:
        return self

    def __exit__(self, *_: object) -> None:
        self._stage.close()

    def photograph_object(self, camera: int, pan_rad: float, focal_px: float) -> Image:
        """The calibration object, put back where it was, as this camera sees it panned and zoomed (section 4.3)."""
        rng = stream(self._config.seed, "object once more", camera)
        rig, config = self._session.rigs[camera], self._config.sensor
        light = FilmCamera(self._stage, rig, config).still(PanTiltZoom(pan_rad, focal_px))
        sensor = Sensor(config, vignette(rig), stream(self._config.seed, "sensor", camera))
        return sensor.develop(light, Exposure(config.exposure_drift, rng)(0.0), rng)

    def camera(self, camera: int, pan_rad: float, focal_px: float) -> Camera:
        """The true camera, so panned and zoomed."""
        config, rig, optics = self._config, self._session.rigs[camera], self._config.optics
        pose = rig.world_T_cam(pan_rad, focal_px)
        return Camera(
            config.width, config.height, pose, focal_px, rig.principal_px, rig.k1(focal_px), optics.k2, optics.p1
        )

    def portray(self, camera: Camera, pose: Pose) -> Image:
        """The athlete as an ideal ``camera`` would see them, which no tripod carries; its lens does not distort."""
        stage = self._stage
        set_pose(stage.model, stage.data, pose)
        stage.aim(camera.world_T_cam, float(np.degrees(2 * np.arctan(camera.height / 2 / camera.focal_px))))
        picture = stage.picture((camera.width, camera.height), athlete=True)
        return np.ascontiguousarray(picture[::-1, :, ::-1])
