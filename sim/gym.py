"""The sports hall and the calibration object, added to a MuJoCo model.

World: origin on the floor at the centre of the hall, z up, metres; the hall is 30 x 20 x 8 m. Geoms of the hall are in
group 0, those of the calibration object in group 3, so that `MjvOption.geomgroup` shows or hides it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import mujoco
import numpy as np

from pzcap.types import Array, CalibrationObject, Image, Marker
from sim.textures import Canvas, courses, grain, weather

HALL_M: Final = (30.0, 20.0, 8.0)
CARPET_M: Final = 12.0
HALL_GROUP: Final = 0
OBJECT_GROUP: Final = 3

DICTIONARY: Final = "DICT_4X4_50"
FRAME_M: Final = 2.0  # edge of the calibration object's cube
MARKER_M: Final = 0.5
QUIET_M: Final = 0.0625  # white margin around a marker
PITCH_M: Final = 0.66  # between the centres of neighbouring boards
_MARKER_PX_PER_M: Final = 384  # a marker's cell is 32 texels, a marker 192: its corners fall between texels


@dataclass(frozen=True)
class GymConfig:
    """How the hall is furnished and lit."""

    shadows: bool = True  # the main light casts shadows
    texture_px_per_m: float = 200.0  # of the lower walls and the carpet; less where no camera comes near


def build_gym(spec: mujoco.MjSpec, config: GymConfig, rng: np.random.Generator) -> None:
    """Add hall, furniture and lights to `spec`, and set its visual options (light, shadow map, tessellation)."""
    _set_visual(spec, config)
    length, width, height = HALL_M
    ppm = config.texture_px_per_m
    walls = {
        "south": ((0, -width / 2), (1, 0), length),
        "east": ((length / 2, 0), (0, 1), width),
        "north": ((0, width / 2), (-1, 0), length),
        "west": ((-length / 2, 0), (0, -1), width),
    }
    for name, ((x, y), (rx, ry), extent) in walls.items():
        canvas = Canvas(extent, height, ppm, (128, 128, 128))
        courses(
            canvas.image, ppm, rng, [(150, 150, 140), (140, 145, 140)], unit_m=(0.4, 0.2), joint_m=0.012,
            joint=(110, 110, 105),
        )  # fmt: skip
        weather(canvas.image, grain(canvas.image.shape[:2], rng, 2.0))
        add_panel(spec, f"wall_{name}", canvas.image, (x, y, height / 2), (rx, ry, 0), (0, 0, 1), (extent, height))
    floor = Canvas(length, width, ppm / 2, (165, 140, 105))
    weather(floor.image, grain(floor.image.shape[:2], rng, 3.0))
    add_panel(spec, "floor", floor.image, (0, 0, 0), (1, 0, 0), (0, 1, 0), (length, width))
    carpet = Canvas(CARPET_M, CARPET_M, ppm, (70, 95, 150))
    weather(carpet.image, grain(carpet.image.shape[:2], rng, 3.0))
    add_panel(spec, "carpet", carpet.image, (0, 0, 0.004), (1, 0, 0), (0, 1, 0), (CARPET_M, CARPET_M))
    ceiling = Canvas(length, width, ppm / 4, (130, 130, 130))
    weather(ceiling.image, grain(ceiling.image.shape[:2], rng, 3.0))
    add_panel(spec, "ceiling", ceiling.image, (0, 0, height), (1, 0, 0), (0, -1, 0), (length, width))


def calibration_object() -> CalibrationObject:
    """The open cube at the centre of the hall: markers 0-35 on its side faces, nine a face, and its twelve edges."""
    markers = []
    for face in range(4):
        centre, right, up = _face(face)
        for k in range(9):
            middle = centre + PITCH_M * ((k % 3 - 1) * right + (1 - k // 3) * up)
            signs = ((-1, 1), (1, 1), (1, -1), (-1, -1))
            corners = np.array([middle + MARKER_M / 2 * (a * right + b * up) for a, b in signs])
            markers.append(Marker(id=9 * face + k, corners_m=corners))
    h = FRAME_M / 2
    corners = np.array([(x, y, z) for z in (0.0, FRAME_M) for x, y in ((-h, -h), (h, -h), (h, h), (-h, h))])
    pairs = [(i, (i + 1) % 4) for i in range(4)]
    edges = [*pairs, *((a + 4, b + 4) for a, b in pairs), *((i, i + 4) for i in range(4))]
    return CalibrationObject(DICTIONARY, tuple(markers), corners[np.array(edges)])


def add_calibration_object(spec: mujoco.MjSpec) -> None:
    """Add the calibration object to `spec`, in geom group 3."""
    definition = calibration_object()
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, definition.dictionary))
    margin, side = round(QUIET_M * _MARKER_PX_PER_M), round(MARKER_M * _MARKER_PX_PER_M)
    board_m = MARKER_M + 2 * QUIET_M
    for marker in definition.markers:
        tile = cv2.copyMakeBorder(
            cv2.aruco.generateImageMarker(dictionary, marker.id, side), *[margin] * 4, cv2.BORDER_CONSTANT, value=255
        )
        corners = marker.corners_m
        right, up = (corners[1] - corners[0]) / MARKER_M, (corners[0] - corners[3]) / MARKER_M
        centre = corners.mean(axis=0)
        image = cv2.cvtColor(cv2.convertScaleAbs(tile, alpha=0.75, beta=20), cv2.COLOR_GRAY2RGB)
        name = f"marker_{marker.id}"
        add_panel(spec, name, np.asarray(image, np.uint8), centre, right, up, (board_m, board_m), group=OBJECT_GROUP)
        # A plane is seen from its front alone; the board behind it hides what is on the far side.
        thickness = 0.006
        board = spec.worldbody.add_geom(
            name=f"board_{marker.id}", type=mujoco.mjtGeom.mjGEOM_BOX, size=[board_m / 2, board_m / 2, thickness / 2],
            pos=centre - np.cross(right, up) * (thickness / 2 + 0.002), rgba=[0.6, 0.55, 0.48, 1],
        )  # fmt: skip
        _finish(board, OBJECT_GROUP, right, up)
    for i, (start, end) in enumerate(definition.wireframe_m):
        edge = spec.worldbody.add_geom(
            name=f"edge_{i}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*start, *end], size=[0.012, 0, 0],
            rgba=[0.25, 0.25, 0.27, 1],
        )  # fmt: skip
        _finish(edge, OBJECT_GROUP)


def add_panel(
    spec: mujoco.MjSpec,
    name: str,
    image: Image,
    centre: Sequence[float] | Array,
    right: Sequence[float] | Array,
    up: Sequence[float] | Array,
    size_m: tuple[float, float],
    group: int = HALL_GROUP,
) -> None:
    """Add a textured plane facing ``right x up``; `image` is red-green-blue, its first row at the top."""
    spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=image.shape[1], height=image.shape[0], nchannel=3
    ).data = np.ascontiguousarray(image).tobytes()
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, reflectance=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    geom = spec.worldbody.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[size_m[0] / 2, size_m[1] / 2, 1.0], pos=centre, material=name
    )
    _finish(geom, group, right, up)


def _finish(
    geom: mujoco.MjsGeom,
    group: int,
    right: Sequence[float] | Array = (1.0, 0.0, 0.0),
    up: Sequence[float] | Array = (0.0, 1.0, 0.0),
) -> None:
    """What all scenery shares: nothing collides; the local axes x and y point `right` and `up`."""
    geom.contype = geom.conaffinity = 0
    geom.group = group
    if geom.type != mujoco.mjtGeom.mjGEOM_CAPSULE:
        axes = np.stack([right, up, np.cross(right, up)], axis=1).astype(np.float64)
        mujoco.mju_mat2Quat(geom.quat, axes.ravel())


def _face(index: int) -> tuple[Array, Array, Array]:
    """Centre of a side face of the cube, and its right and up as seen from the front."""
    outward = ((0, -1), (1, 0), (0, 1), (-1, 0))[index]
    normal = np.array([*outward, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return normal * FRAME_M / 2 + up * FRAME_M / 2, np.cross(up, normal), up


def _set_visual(spec: mujoco.MjSpec, config: GymConfig) -> None:
    spec.visual.headlight.ambient = [0.45] * 3
    spec.visual.headlight.diffuse = [0, 0, 0]  # it turns with the camera, which no lamp does
    spec.visual.headlight.specular = [0, 0, 0]
    spec.visual.quality.shadowsize = 4096
    spec.visual.quality.numslices = 64
    spec.visual.quality.numstacks = 64
    spec.visual.map.znear = 0.01
    spec.visual.map.zfar = 50.0
    spec.stat.extent = 20.0
    spec.stat.center = [0, 0, 2]
    for name, direction, strength, shadow in (
        ("main", (0.35, 0.25, -1.0), 0.38, config.shadows),
        ("fill_a", (-0.8, 0.5, -0.6), 0.2, False),
        ("fill_b", (0.4, -0.9, -0.5), 0.2, False),
    ):
        spec.worldbody.add_light(
            name=name, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 7.5], dir=direction,
            diffuse=[strength] * 3, ambient=[0, 0, 0], specular=[0.05] * 3, castshadow=shadow,
        )  # fmt: skip
