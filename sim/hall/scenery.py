"""Placing scenery in a MuJoCo model: materials, textured panels, boxes and sheets, and the walls to place them by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, Image
from sim.hall.textures import Colour

HALL_M: Final = (30.0, 20.0, 8.0)
UP: Final = (0.0, 0.0, 1.0)

Vector = Sequence[float] | NDArray[np.float64]


@dataclass(frozen=True)
class Wall:
    """A wall as seen from inside the hall: `u` runs from its left end to its right."""

    name: str
    left: tuple[float, float]  # where u = 0, world
    right: tuple[float, float]  # unit vector along u, world

    @property
    def length(self) -> float:
        return HALL_M[0] if self.right[1] == 0 else HALL_M[1]

    @property
    def along(self) -> Array:
        return np.array([*self.right, 0.0])

    def at(self, u: float, off: float, z: float) -> Array:
        """World position (3,) at `u` along the wall, `off` metres into the hall, `z` above the floor."""
        inward = np.cross(self.along, UP)
        return np.array([*self.left, z]) + u * self.along + off * inward


_X, _Y = HALL_M[0] / 2, HALL_M[1] / 2
WALLS: Final = {
    "south": Wall("south", (_X, -_Y), (-1, 0)),
    "east": Wall("east", (_X, _Y), (0, -1)),
    "north": Wall("north", (-_X, _Y), (1, 0)),
    "west": Wall("west", (-_X, -_Y), (0, 1)),
}


class Scenery:
    """Adds geoms of one group to a model. Nothing collides; a name that is given twice gets a number."""

    def __init__(self, spec: mujoco.MjSpec, group: int) -> None:
        self._spec = spec
        self._group = group
        self._counts: dict[str, int] = {}

    def material(self, name: str, image: Image, *, emission: float = 0.0) -> str:
        """A matt material with a texture, red-green-blue, first row on top."""
        texture = self._spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=image.shape[1], height=image.shape[0], nchannel=3
        )
        texture.data = image.tobytes()
        material = self._spec.add_material(name=name, specular=0, shininess=0, reflectance=0, emission=emission)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        return name

    def paint(self, name: str, colour: Colour, *, emission: float = 0.0) -> str:
        """A matt material of one colour."""
        rgba = [*(c / 255 for c in colour), 1.0]
        self._spec.add_material(name=name, specular=0, shininess=0, reflectance=0, emission=emission, rgba=rgba)
        return name

    def panel(
        self, name: str, image: Image, centre: Vector, right: Vector, up: Vector, size_m: tuple[float, float]
    ) -> None:
        """A textured rectangle of (width, height) facing `right` x `up`, to be seen from there alone."""
        geom = self._geom(name, mujoco.mjtGeom.mjGEOM_PLANE, self.material(name, image), centre, right, up)
        geom.size = [size_m[0] / 2, size_m[1] / 2, 10.0]

    def box(self, name: str, material: str, centre: Vector, right: Vector, size_m: tuple[float, float, float]) -> None:
        """An upright box: `size_m` along `right` (horizontal), along up x right, and up."""
        geom = self._geom(name, mujoco.mjtGeom.mjGEOM_BOX, material, centre, right, np.cross(UP, right))
        geom.size = [s / 2 for s in size_m]

    def bar(self, name: str, material: str, start: Vector, end: Vector, thickness: float) -> None:
        """A square bar between two points."""
        axis = np.subtract(end, start)
        length = float(np.linalg.norm(axis))
        axis = axis / length
        side = np.cross(axis, UP if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
        geom = self._geom(
            name, mujoco.mjtGeom.mjGEOM_BOX, material, np.add(start, end) / 2, axis, side / np.linalg.norm(side)
        )
        geom.size = [length / 2, thickness / 2, thickness / 2]

    def sheet(self, name: str, material: str, points: Array, texture: Array) -> None:
        """A curved sheet through a grid of world `points` (R, C, 3) with texture coordinates (R, C, 2), v downwards."""
        rows, columns = points.shape[:2]
        index = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
        self._spec.add_mesh(
            name=name, uservert=points.reshape(-1), userface=faces.reshape(-1), usertexcoord=texture.reshape(-1),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        geom = self._geom(name, mujoco.mjtGeom.mjGEOM_MESH, material, (0, 0, 0), (1, 0, 0), (0, 1, 0))
        geom.meshname = name

    def _geom(
        self, name: str, kind: mujoco.mjtGeom, material: str, centre: Vector, right: Vector, up: Vector
    ) -> mujoco.MjsGeom:
        count = self._counts[name] = self._counts.get(name, 0) + 1
        axes = np.stack([right, up, np.cross(right, up)], axis=1).astype(np.float64)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        return self._spec.worldbody.add_geom(
            name=name if count == 1 else f"{name}_{count}", type=kind, material=material, pos=centre, quat=quaternion,
            group=self._group, contype=0, conaffinity=0,
        )  # fmt: skip
