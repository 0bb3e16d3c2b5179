"""The hall of the simulator without a session: a camera in its corners, and MuJoCo's own projection."""

from __future__ import annotations

import importlib
import os

import cv2
import mujoco
import numpy as np

from pzcap.types import Array, Image
from sim.hall.gym import GymConfig, add_calibration_object, build_gym

WIDTH, HEIGHT, FOCAL_PX = 640, 480, 880.0
CORNERS = ((-10.5, -8.0), (10.5, -8.0), (10.5, 8.0), (-10.5, 8.0))


class Hall:
    """The hall and a camera in it, without any of the library's own geometry."""

    def __init__(self, config: GymConfig, seed: int) -> None:
        spec = mujoco.MjSpec()
        build_gym(spec, config, np.random.default_rng(seed))
        add_calibration_object(spec)
        spec.worldbody.add_geom(
            name="post", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.2, 0.8, 0], pos=[-4, -4, 1], group=1
        )
        spec.worldbody.add_camera(name="camera")
        spec.visual.global_.offwidth, spec.visual.global_.offheight = 2 * WIDTH, 2 * HEIGHT
        spec.visual.quality.offsamples = 0
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        backend = importlib.import_module(f"mujoco.{os.environ.get('MUJOCO_GL') or 'egl'}")
        self._gl = backend.GLContext(2 * WIDTH, 2 * HEIGHT)
        self._gl.make_current()
        self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(self.model, maxgeom=2000)
        self._view = mujoco.MjvCamera()
        self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0

    def close(self) -> None:
        self._context.free()
        self._gl.free()

    def aim(self, position: Array, target: Array, zoom: float = 1.0) -> None:
        forward = (target - position) / np.linalg.norm(target - position)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(right, forward), -forward], axis=1)
        self.model.cam_pos[0] = position
        mujoco.mju_mat2Quat(self.model.cam_quat[0], np.ascontiguousarray(axes).ravel())
        self.focal_px = zoom * FOCAL_PX
        self.model.cam_fovy[0] = 2 * np.degrees(np.arctan(HEIGHT / 2 / self.focal_px))
        mujoco.mj_forward(self.model, self.data)

    def look(self, corner: int, pan_rad: float, zoom: float = 1.0) -> None:
        """From a corner, turned to the left by `pan_rad` from the centre of the hall, a little downwards."""
        position = np.array([*CORNERS[corner], 1.75])
        azimuth = np.arctan2(-position[1], -position[0]) + pan_rad
        self.aim(position, position + np.array([np.cos(azimuth), np.sin(azimuth), -0.07]), zoom)

    def image(self, *, calibration_object: bool = False, post: bool = False) -> Image:
        option = mujoco.MjvOption()
        option.geomgroup[:] = [1, post, 0, calibration_object, 0, 0]
        every, double = mujoco.mjtCatBit.mjCAT_ALL, np.empty((2 * HEIGHT, 2 * WIDTH, 3), np.uint8)
        mujoco.mjv_updateScene(self.model, self.data, option, None, self._view, every, self._scene)
        rectangle = mujoco.MjrRect(0, 0, 2 * WIDTH, 2 * HEIGHT)
        self._gl.make_current()
        mujoco.mjr_render(rectangle, self._scene, self._context)
        mujoco.mjr_readPixels(double, None, rectangle, self._context)
        small = cv2.resize(double, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(small[::-1, :, ::-1], dtype=np.uint8)

    def homography(self) -> Array:
        """(3, 3): directions in the world to pixels, seen from where the camera stands."""
        rotation = self.data.cam_xmat[0].reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
        f = self.focal_px
        return np.array([[f, 0, (WIDTH - 1) / 2], [0, f, (HEIGHT - 1) / 2], [0, 0, 1]]) @ rotation.T

    def project(self, points_m: Array) -> Array:
        seen = (points_m - self.data.cam_xpos[0]) @ self.homography().T
        return seen[:, :2] / seen[:, 2:]
