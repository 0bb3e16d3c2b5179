"""The sports hall and the calibration object, added to a MuJoCo model.

World: origin on the floor at the centre of the hall, z up, metres; the hall is 30 x 20 x 8 m. Geoms of the hall are in
group 0, those of the calibration object in group 3, so that `MjvOption.geomgroup` shows or hides it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Final

import cv2
import mujoco
import numpy as np

from pzcap.types import Array, CalibrationObject, Marker
from sim.hall.furniture import furnish
from sim.hall.scenery import HALL_M, UP, WALLS, Scenery
from sim.hall.surfaces import CARPET_M, LOWER_M, carpet, ceiling, floor, lower_wall, plaster, upper_wall
from sim.hall.wallpaper import cover, wall_pictures
from sim.ranges import Range

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
    """Furniture and light of the hall."""

    shadows: bool = True
    """The main light casts shadows: one falls on the floor beside the athlete."""
    texture_px_per_m: Annotated[float, Range(50.0, 500.0)] = 200.0
    """Texels a metre of the lower walls and the carpet; less where no camera comes near. At 200 a texel 13 m
    off is as large as a pixel at the longest focal length."""
    lights_on: Annotated[float, Range(0.05, 20.0)] = 1.0
    """Brightness while the motion is recorded, over that of all before; 1: nobody touches the lights."""
    mains_share: Annotated[float, Range(0.0, 1.0)] = 0.0
    """Amplitude of the lamps' flicker, share of their mean brightness, before the open shutter averages it. 0: they
    burn steadily; 0.2 to 0.4 is what tubes and halide lamps on plain ballasts have."""
    mains_hz: Annotated[float, Range(1.0, 1000.0)] = 100.0
    """Frequency of the flicker, Hz, which is twice that of the mains, give or take a two thousandth."""
    mains_phases: Annotated[int, Range(1, 3)] = 1
    """Phases of the mains that the lamps hang on by turns. With three, what a camera sees is lit by all in a mixture of
    its own, which flickers less."""
    bare_walls: bool = False
    """Walls are plastered: one colour, faintly mottled. What hangs on them or stands before them stays."""
    wall_pictures: str = ""
    """Folder of pictures that cover walls: north, east, south, west, as PNG or JPEG; empty: the painted hall."""
    rearranged: bool = False
    """Vaulting boxes and mats stand elsewhere while the motion is recorded. Off: a crew leaves things in place."""


def build_gym(spec: mujoco.MjSpec, config: GymConfig, rng: np.random.Generator) -> None:
    """Add hall, furniture and lights to `spec`, and set its visual options (light, shadow map, tessellation)."""
    _light(spec, config)
    scenery = Scenery(spec, HALL_GROUP)
    length, width, height = HALL_M
    ppm = config.texture_px_per_m
    pictures = wall_pictures(config.wall_pictures)
    shell: list[Callable[[], None]] = []  # hung last: what stands before it need not be drawn over it
    for wall in WALLS.values():
        lower, upper = lower_wall(wall, ppm, rng), upper_wall(wall, 0.6 * ppm, rng)
        # painted all the same, so that nothing else in the hall changes
        if config.bare_walls:
            for part in (lower, upper):
                plaster(part, rng.spawn(1)[0])
        if wall.name in pictures:
            cover(pictures[wall.name], lower, upper)
        for name, part, z in (("lower", lower, LOWER_M / 2), ("upper", upper, (LOWER_M + height) / 2)):
            at, size_m = wall.at(wall.length / 2, 0.0, z), (part.width_m, part.height_m)
            shell.append(partial(scenery.panel, f"wall_{wall.name}_{name}", part.image, at, wall.along, UP, size_m))
    x, y = (1, 0, 0), (0, 1, 0)
    ground = partial(scenery.panel, "floor", floor(0.5 * ppm, rng).image, (0, 0, 0), x, y, (length, width))
    mat = partial(scenery.panel, "carpet", carpet(ppm, rng).image, (0, 0, 0.003), x, y, (CARPET_M, CARPET_M))
    roof = ceiling(0.3 * ppm, rng).image
    shell += [mat, ground, partial(scenery.panel, "ceiling", roof, (0, 0, height), x, (0, -1, 0), (length, width))]
    furnish(scenery, ppm, rng)
    for hang in shell:
        hang()


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
    scenery = Scenery(spec, OBJECT_GROUP)
    scenery.paint("object_board", (150, 138, 120))
    scenery.paint("object_edge", (64, 64, 68))
    board_m = MARKER_M + 2 * QUIET_M
    for marker in definition.markers:
        tile = cv2.aruco.generateImageMarker(dictionary, marker.id, side)
        tile = cv2.copyMakeBorder(tile, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255)
        image = cv2.cvtColor(cv2.convertScaleAbs(tile, alpha=0.75, beta=20), cv2.COLOR_GRAY2RGB)
        corners = marker.corners_m
        right, up = (corners[1] - corners[0]) / MARKER_M, (corners[0] - corners[3]) / MARKER_M
        centre, outward = corners.mean(axis=0), np.cross(right, up)
        scenery.panel(f"marker_{marker.id}", np.asarray(image, np.uint8), centre, right, up, (board_m, board_m))
        # A plane is seen from its front alone; the board behind it hides what is on the far side.
        scenery.box("board", "object_board", centre - 0.005 * outward, right, (board_m, 0.006, board_m))
    for start, end in definition.wireframe_m:
        scenery.bar("edge", "object_edge", start, end, 0.024)


def _face(index: int) -> tuple[Array, Array, Array]:
    """Centre of a side face of the cube, and its right and up as seen from the front."""
    outward = ((0, -1), (1, 0), (0, 1), (-1, 0))[index]
    normal = np.array([*outward, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return normal * FRAME_M / 2 + up * FRAME_M / 2, np.cross(up, normal), up


def _light(spec: mujoco.MjSpec, config: GymConfig) -> None:
    """Even light from above: most of it ambient, and three directional lights of which one casts shadows."""
    spec.visual.headlight.ambient = [0.67] * 3
    spec.visual.headlight.diffuse = [0, 0, 0]  # it turns with the camera, which no lamp does
    spec.visual.headlight.specular = [0, 0, 0]
    spec.visual.quality.shadowsize = 1024  # 24 mm a texel; twice that costs a sixth of a frame's time
    spec.visual.quality.numquads = 1  # flat faces under directional light need no finer vertices
    spec.visual.quality.numslices = 64
    spec.visual.quality.numstacks = 64
    spec.stat.center = [0, 0, HALL_M[2] / 4]
    spec.stat.extent = HALL_M[0] / 2
    spec.visual.map.shadowclip = 12.0 / spec.stat.extent  # the shadow map reaches 12 m from the main light's axis
    for name, direction, strength, shadow in (
        ("light_main", (0.24, 0.15, -1.0), 0.3, config.shadows),
        ("light_north_east", (0.8, 0.6, 0.0), 0.2, False),  # level: brightens walls, and no shadow on the floor
        ("light_south_west", (-0.8, -0.6, 0.0), 0.24, False),
    ):
        spec.worldbody.add_light(
            name=name, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=direction,
            pos=[0, 0, 5.3],  # what is behind it casts no shadow: above every jump, below beams and ducts
            diffuse=[strength] * 3, ambient=[0, 0, 0], specular=[0, 0, 0], castshadow=shadow,
        )  # fmt: skip
