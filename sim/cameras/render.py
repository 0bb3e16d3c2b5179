"""MuJoCo as a camera: pictures and masks of the scene, off screen."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

import sim
from pzcap.types import Array, Image, Mask, PzcapError
from sim.cameras.shading import ShadowedPass, casts_one_shadow

LARGEST_PICTURE_PX: Final = 16384
"""Width and height of the largest picture that every OpenGL since 2010 can draw."""

_BACKENDS = ("egl", "osmesa", "glfw")
_PROBE = """
import importlib, sys, mujoco
context = importlib.import_module("mujoco." + sys.argv[1]).GLContext(8, 8)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), 100)
"""


def check_gl() -> None:
    """Raise PzcapError, with what to install, if pictures cannot be rendered here.

    Tried in a process of its own: a failed import of MuJoCo leaves half-loaded modules behind.
    """
    backend = sim.GL_BACKEND
    if backend not in _BACKENDS:
        raise PzcapError(f"MUJOCO_GL={backend} cannot render off screen; set it to one of {', '.join(_BACKENDS)}")
    run = subprocess.run([sys.executable, "-c", _PROBE, backend], capture_output=True, check=False)
    if run.returncode != 0:
        packages = "libosmesa6" if backend == "osmesa" else "libegl1 libgl1"
        raise PzcapError(
            f"MuJoCo cannot render with MUJOCO_GL={backend}: install the GL library (apt-get install {packages})"
        )


OTHERS_GROUP: Final = 4
"""Geom group of other people than the athlete."""


def _nobody(time_s: float) -> None:
    del time_s


class Stage:
    """A compiled scene with one camera that can be put anywhere.

    The athlete's geoms are in ``athlete_group``, the calibration object's in ``object_group``, the hall's in group 0.
    Pictures up to ``width`` x ``height`` need no further memory.

    Textures that are seen small are blurred beforehand (``mipmaps``), by as much across as along: a floor that is seen
    at a flat angle is blurred sideways, too, and stands some thousandths of an image pixel elsewhere at another zoom.
    Pictures that are much finer than the image can do without.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        width: int,
        height: int,
        athlete_group: int,
        object_group: int,
        *,
        mipmaps: bool = True,
    ) -> None:
        self._groups = (athlete_group, object_group)
        self._up = 0.0  # of the picture's middle above the optical axis, picture heights
        spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
        spec.visual.quality.offsamples = 0  # the plate is finer than the image; that is smoothing enough
        # Twenty-eight sides leave a limb round to 0.1 px; 64 would double the time of every picture.
        spec.visual.quality.numslices, spec.visual.quality.numstacks = 28, 16
        camera = spec.worldbody.add_camera(name="shoot")
        camera.fovy = 45.0
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._camera_id = self.model.camera("shoot").id
        self._context = importlib.import_module(f"mujoco.{sim.GL_BACKEND}").GLContext(width, height)
        self._context.make_current()
        self._gpu = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gpu)
        if not mipmaps:
            self._disable_mipmaps()
        self._pass = ShadowedPass(self.model, self._gpu) if casts_one_shadow(self.model) else None
        self._world_T_eye = np.eye(4)
        self._scene = mujoco.MjvScene(self.model, maxgeom=2000)
        self._option = mujoco.MjvOption()
        self._view = mujoco.MjvCamera()
        self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self._camera_id
        self.accompany: Callable[[float], None] = _nobody  # puts all but the athlete where they are at a time
        self.others = False  # whether other people are in the hall
        self._is_athlete = self.model.geom_group == athlete_group

    def close(self) -> None:
        self._gpu.free()
        self._context.free()

    def aim(self, world_T_cam: Array, vertical_view_deg: float, up: float = 0.0) -> None:
        """Put the camera at ``world_T_cam``. The athlete's pose is as `sim.people.athlete.set_pose` wrote it.

        ``vertical_view_deg``: height of the picture as if the optical axis met its middle. ``up``: how far that middle
        is above the axis, picture heights.
        """
        model, self._up = self.model, up
        model.cam_pos[self._camera_id] = world_T_cam[:3, 3]
        self._world_T_eye = world_T_cam * np.array([1.0, -1.0, -1.0, 1.0])
        axes = np.ascontiguousarray(self._world_T_eye[:3, :3])
        mujoco.mju_mat2Quat(model.cam_quat[self._camera_id], axes.ravel())
        model.cam_fovy[self._camera_id] = vertical_view_deg
        mujoco.mj_kinematics(model, self.data)
        mujoco.mj_camlight(model, self.data)

    def carry(self, piece: str, by_m: tuple[float, float, float]) -> None:
        """Carry the geoms whose names begin with ``piece`` elsewhere, for good."""
        for geom in range(self.model.ngeom):
            if self.model.geom(geom).name.startswith(piece):
                self.model.geom_pos[geom] += by_m

    def picture(self, size: tuple[int, int], *, athlete: bool, calibration_object: bool = False) -> Image:
        """Picture of ``size`` (width, height): red-green-blue, the *bottom* row first."""
        self._update(athlete, calibration_object)
        return self._draw(
            *size, (np.array([athlete, calibration_object, self.others]), self.data.geom_xpos, self.data.geom_xmat)
        )

    def mask(self, size: tuple[int, int]) -> Image:
        """Mask of the athlete, 0 or 255, of ``size`` (width, height), the *bottom* row first."""
        self._update(athlete=True, calibration_object=False)
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        coded = self._draw(*size)
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 0
        table = np.zeros(self._scene.ngeom + 1, np.uint8)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.segid >= 0 and self._is_athlete[geom.objid]:
                table[geom.segid + 1] = 255
        code = coded[..., 0].astype(np.int32) | coded[..., 1].astype(np.int32) << 8
        return np.asarray(table[code])

    def cast_rays(self, origin_m: Array, directions: Array) -> tuple[Array, Mask]:
        """First intersections (N, 3) of rays with directions (N, 3) with the hall, and which rays have one (N,)."""
        n = len(directions)
        ids, distances = np.zeros(n, np.int32), np.zeros(n)
        groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_multiRay(
            self.model, self.data, origin_m, np.ascontiguousarray(directions).ravel(), groups, 1, -1, ids, distances,
            None, n, 1e3,
        )  # fmt: skip
        return origin_m + directions * distances[:, None], ids >= 0

    def _disable_mipmaps(self) -> None:
        gl = importlib.import_module("OpenGL.GL")  # for the backend that MuJoCo has chosen
        for texture in self._gpu.texture[: self.model.ntex].tolist():
            gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
            gl.glTexParameteri(gl.GL_TEXTURE_2D, gl.GL_TEXTURE_MIN_FILTER, gl.GL_LINEAR)

    def _update(self, athlete: bool, calibration_object: bool) -> None:
        for group, shown in zip((*self._groups, OTHERS_GROUP), (athlete, calibration_object, self.others), strict=True):
            self._option.geomgroup[group] = shown
        mujoco.mjv_updateScene(
            self.model, self.data, self._option, None, self._view, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )  # fmt: skip
        if self._up:
            for eye in self._scene.camera:
                shift = self._up * (eye.frustum_top - eye.frustum_bottom)
                eye.frustum_bottom, eye.frustum_top = eye.frustum_bottom + shift, eye.frustum_top + shift

    def _enlarge(self, width: int, height: int) -> None:
        """Make room for pictures larger than was foreseen: of cameras that turn while they read a frame."""
        if max(width, height) > LARGEST_PICTURE_PX:
            raise PzcapError(
                f"a picture of {width} x {height} px would be rendered, and {LARGEST_PICTURE_PX} is the most; let the "
                "cameras turn slower, or give a smaller shoot.width, shoot.height or supersampling"
            )
        mujoco.mjr_resizeOffscreen(width, height, self._gpu)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gpu)

    def _draw(self, width: int, height: int, lit: tuple[Array, ...] | None = None) -> NDArray[np.uint8]:
        """Draw the scene. ``lit``: all that shadows depend on, or None for codes in the place of light."""
        self._context.make_current()  # another stage may have drawn since
        if width > self._gpu.offWidth or height > self._gpu.offHeight:
            self._enlarge(max(width, self._gpu.offWidth), max(height, self._gpu.offHeight))
        rectangle = mujoco.MjrRect(0, 0, width, height)
        if self._pass is not None and lit is not None:
            self._pass.draw(rectangle, self._scene, self._world_T_eye, lit)
        else:
            mujoco.mjr_render(rectangle, self._scene, self._gpu)
        pixels = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, rectangle, self._gpu)
        return pixels
