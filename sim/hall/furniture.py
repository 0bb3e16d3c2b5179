"""Furniture off the walls: wall bars, benches, vaulting boxes, mats, a curtain, hoops, tables, beams and lamps."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from sim.hall import fittings
from sim.hall.scenery import HALL_M, UP, WALLS, Scenery, Wall
from sim.hall.surfaces import PILASTER_M, PILASTERS_U
from sim.hall.textures import Canvas, Colour, courses, flecks, grain, scuff, tint, wear, weather

REARRANGED: Final[dict[str, tuple[float, float, float]]] = {
    "vault_south": (-7.9, 11.5, 0.0),
    "vault_north": (-2.4, -12.1, 0.0),
    "mats_west": (6.7, 0.4, 0.0),
}
"""Furniture that `GymConfig.rearranged` carries to the carpet's edge: beginning of its geoms' names -> shift, m."""


def furnish(scenery: Scenery, px_per_m: float, rng: np.random.Generator) -> None:
    """Add everything to the hall; textures of what cameras come near to have twice `px_per_m`."""
    _materials(scenery, rng)
    south, east, north, west = (WALLS[name] for name in ("south", "east", "north", "west"))
    for wall in (south, north):
        _pilasters(scenery, wall, px_per_m, rng)
    for wall, u in ((south, 5.6), (south, 20.6), (north, 10.6), (north, 15.6)):
        _wall_bars(scenery, wall, u, 3.8)
    for wall, u, width in (
        (south, 0.5, 2.8), (south, 27.7, 2.0), (north, 0.4, 2.0), (north, 26.9, 2.6),
        (east, 0.5, 2.9), (east, 16.6, 2.8), (west, 0.3, 2.2), (west, 17.6, 2.1),
    ):  # fmt: skip
        board = Canvas.blank(width, 1.35, 2 * px_per_m, (128, 128, 128))
        fittings.notice_board(board, rng)
        wear(board, rng)
        name, centre = f"notice_board_{wall.name}_{u:.0f}", wall.at(u + width / 2, 0.03, 1.6)
        scenery.panel(name, board.image, centre, wall.along, UP, (width, 1.35))
        scenery.box("board_back", "wood_dark", wall.at(u + width / 2, 0.012, 1.6), wall.along, (width, 0.024, 1.35))
    for wall, u in ((south, 6.2), (south, 21.0), (north, 11.2), (north, 16.4), (east, 1.2), (west, 0.5), (west, 17.2)):
        _bench(scenery, wall, u, 0.55 if wall.length > 25 else 0.3)
    for wall, u, off in (
        (south, 9.9, 0.9), (south, 19.6, 0.7), (north, 9.3, 0.8), (north, 20.4, 0.8),
        (east, 4.4, 0.8), (west, 6.4, 0.7), (west, 13.6, 0.9), (east, 15.6, 0.8),
    ):  # fmt: skip
        _stand(scenery, wall, u, off, px_per_m, rng)
    _vaulting_box(scenery, WALLS["north"], 24.6, 0.9)
    _vaulting_box(scenery, WALLS["west"], 13.0, 1.2)
    _vaulting_box(scenery, WALLS["south"], 14.3, 1.0)
    _mats(scenery, WALLS["west"], 8.4, 1.1, 5)
    _mats(scenery, WALLS["north"], 3.6, 0.75, 3)
    _mats(scenery, WALLS["south"], 25.0, 0.7, 2)
    _beam(scenery, WALLS["north"], 17.5, 1.3)
    _table(scenery, WALLS["south"], 17.6, 1.1, px_per_m, rng)
    _table(scenery, WALLS["east"], 10.0, 1.6, px_per_m, rng)
    _curtain(scenery, WALLS["east"], 5.4, 14.6, rng)
    _hoop(scenery, WALLS["west"], 10.0, px_per_m, rng)
    _hoop(scenery, WALLS["east"], 10.0, px_per_m, rng)
    _roof(scenery, rng)


def _materials(scenery: Scenery, rng: np.random.Generator) -> None:
    for name, colour in (("wood", (178, 142, 98)), ("wood_dark", (124, 92, 62)), ("wood_red", (164, 116, 78))):
        canvas = Canvas.blank(2.0, 0.5, 256, colour)
        weather(canvas.image, grain(canvas.image.shape, rng, 9, stretch=(1, 12)))
        tint(canvas.image, flecks(canvas.image.shape, rng, 6, 0.05), (-26, -24, -20))
        scuff(canvas, rng, 12)
        scenery.material(name, canvas.image)
    for name, colour in (
        ("leather", (132, 92, 62)), ("mat", (60, 90, 140)), ("mat_green", (66, 116, 92)), ("steel", (148, 150, 152)),
    ):  # fmt: skip
        canvas = Canvas.blank(1.5, 0.75, 256, colour)
        weather(canvas.image, grain(canvas.image.shape, rng, 7))
        tint(canvas.image, flecks(canvas.image.shape, rng, 5, 0.06), (18, 18, 18))
        if name.startswith("mat"):
            canvas.text(0.3, 0.28, 0.16, fittings.phrase(rng, 2), (190, 188, 180), weight=0.2, width=0.9)
            canvas.border(0.04, (34, 44, 64))
        scuff(canvas, rng, 20)
        scenery.material(name, canvas.image)
    scenery.paint("iron", (70, 74, 80))
    scenery.paint("orange", (196, 92, 40))
    scenery.paint("lamp", (225, 225, 215), emission=0.35)


def _pilasters(scenery: Scenery, wall: Wall, px_per_m: float, rng: np.random.Generator) -> None:
    for k, u in enumerate(PILASTERS_U):
        canvas = Canvas.blank(PILASTER_M, HALL_M[2], px_per_m, (128, 128, 128))
        colours: list[Colour] = [(178, 160, 142), (170, 150, 132), (186, 170, 152)]
        courses(canvas, rng, colours, unit_m=(0.25, 0.085), joint_m=0.012, joint=(130, 124, 116))
        weather(canvas.image, grain(canvas.image.shape, rng, 6))
        canvas.text(0.12, 2.3, 0.28, str(k + 1), (70, 76, 92), weight=0.2)
        fittings.sheet(canvas.part(0.1, 1.35 + rng.uniform(-0.2, 0.2), 0.28, 0.4), rng)
        scuff(canvas, rng, 3)
        name = scenery.material(f"pilaster_{wall.name}_{k}", canvas.image)
        scenery.box(name, name, wall.at(u, 0.15, HALL_M[2] / 2), wall.along, (PILASTER_M, 0.3, HALL_M[2]))


def _wall_bars(scenery: Scenery, wall: Wall, u: float, width: float) -> None:
    for k in range(5):
        scenery.box("bars_upright", "wood_red", wall.at(u + k * width / 4, 0.08, 1.3), wall.along, (0.045, 0.14, 2.6))
    for z in [*np.arange(0.18, 2.2, 0.15), 2.35, 2.52]:
        centre = wall.at(u + width / 2, 0.16 if z > 2.3 else 0.1, z)
        scenery.box("bars_rung", "wood", centre, wall.along, (width, 0.028, 0.038))


def _bench(scenery: Scenery, wall: Wall, u: float, off: float) -> None:
    length = 3.0 if wall.length > 25 else 2.2
    scenery.box("bench_seat", "wood", wall.at(u + length / 2, off, 0.33), wall.along, (length, 0.27, 0.04))
    scenery.box("bench_rail", "wood_red", wall.at(u + length / 2, off, 0.1), wall.along, (length, 0.05, 0.1))
    for share in (0.1, 0.9):
        scenery.box("bench_leg", "wood_dark", wall.at(u + share * length, off, 0.155), wall.along, (0.05, 0.24, 0.31))


def _stand(scenery: Scenery, wall: Wall, u: float, off: float, px_per_m: float, rng: np.random.Generator) -> None:
    """A roll-up banner on the floor."""
    canvas = Canvas.blank(0.85, 2.0, 2 * px_per_m, (128, 128, 128))
    fittings.poster(canvas, rng)
    wear(canvas, rng)
    name = scenery.material(f"stand_{wall.name}_{u:.0f}", canvas.image)
    scenery.box(name, name, wall.at(u, off, 1.05), wall.along, (0.85, 0.02, 2.0))
    scenery.box("stand_foot", "iron", wall.at(u, off, 0.03), wall.along, (0.9, 0.2, 0.06))


def _vaulting_box(scenery: Scenery, wall: Wall, u: float, off: float) -> None:
    for k in range(4):
        material, size = ("wood", "wood_red")[k % 2], (1.5 - 0.1 * k, 0.8 - 0.1 * k, 0.25)
        scenery.box(f"vault_{wall.name}_layer", material, wall.at(u, off, 0.14 + 0.26 * k), wall.along, size)
    scenery.box(f"vault_{wall.name}_top", "leather", wall.at(u, off, 1.13), wall.along, (1.15, 0.48, 0.18))


def _mats(scenery: Scenery, wall: Wall, u: float, off: float, count: int) -> None:
    for k in range(count):
        material, centre = ("mat", "mat_green")[k % 2], wall.at(u + 0.05 * (-1) ** k, off, 0.1 + 0.21 * k)
        scenery.box(f"mats_{wall.name}", material, centre, wall.along, (1.9, 0.95, 0.2))


def _beam(scenery: Scenery, wall: Wall, u: float, off: float) -> None:
    """A balance beam."""
    scenery.box("beam", "leather", wall.at(u, off, 1.17), wall.along, (4.6, 0.1, 0.16))
    for side in (-1, 1):
        foot = u + side * 1.6
        scenery.box("beam_leg", "steel", wall.at(foot, off, 0.55), wall.along, (0.1, 0.1, 1.1))
        scenery.box("beam_foot", "iron", wall.at(foot, off, 0.04), wall.along, (0.14, 1.0, 0.08))


def _table(scenery: Scenery, wall: Wall, u: float, off: float, px_per_m: float, rng: np.random.Generator) -> None:
    """The judges' table, its cloth printed."""
    canvas = Canvas.blank(2.6, 0.74, 1.5 * px_per_m, (90, 96, 120))
    fittings.banner(canvas, rng, ("JUDGES", fittings.phrase(rng, 3)), (76, 92, 128))
    name = scenery.material(f"table_{wall.name}", canvas.image)
    scenery.box(name, name, wall.at(u, off, 0.37), wall.along, (2.6, 0.7, 0.74))
    for k in range(3):
        centre = wall.at(u - 0.8 + 0.8 * k, off - 0.55, 0.75)
        scenery.box("chair_back", "wood_red", centre, wall.along, (0.42, 0.03, 0.35))
        scenery.box("monitor", "iron", wall.at(u - 0.7 + 0.75 * k, off, 0.88), wall.along, (0.36, 0.04, 0.26))


def _curtain(scenery: Scenery, wall: Wall, start: float, stop: float, rng: np.random.Generator) -> None:
    """The stage curtain, in folds, a valance over it."""
    height, columns, rows = 3.9, 420, 5
    canvas = Canvas.blank(stop - start, height, 110, (164, 74, 76))
    weather(canvas.image, grain(canvas.image.shape, rng, 9, stretch=(10, 1)))
    weather(canvas.image, grain(canvas.image.shape, rng, 5))
    tint(canvas.image, flecks(canvas.image.shape, rng, 4, 0.08), (26, 14, 12))
    for y in (0.25, 0.45):
        canvas.rectangle(0, y, canvas.width_m, 0.09, (178, 144, 70))
    for x in np.arange(1.2, canvas.width_m, 2.3):
        fittings.emblem(canvas.part(x - 0.45, 1.5, 0.9, 0.9), rng)
    scuff(canvas, rng, 1.0)
    share = np.linspace(0.0, 1.0, columns)
    fold = 0.09 * np.sin(2 * np.pi * share * 34 + 2.0 * np.sin(9 * share)) + 0.04 * np.sin(50 * share)
    points = np.array([[wall.at(start + s * (stop - start), 0.3 + f, z) for s, f in zip(share, fold, strict=True)]
                       for z in np.linspace(height, 0.04, rows)])  # fmt: skip
    texture = np.stack(np.meshgrid(share, np.linspace(0, 1, rows)), axis=-1)
    scenery.sheet("curtain", scenery.material("curtain", canvas.image), points, texture)
    centre = wall.at((start + stop) / 2, 0.28, height + 0.15)
    scenery.box("valance", "wood_dark", centre, wall.along, (stop - start + 0.4, 0.5, 0.4))
    for u in (start - 0.2, stop + 0.2):
        scenery.box("proscenium", "wood_red", wall.at(u, 0.22, 2.0), wall.along, (0.3, 0.44, 4.0))


def _hoop(scenery: Scenery, wall: Wall, u: float, px_per_m: float, rng: np.random.Generator) -> None:
    """A basketball backboard with its ring, carried from the wall."""
    off, z = 1.5, 3.4
    canvas = Canvas.blank(1.8, 1.05, px_per_m, (188, 188, 182))
    weather(canvas.image, grain(canvas.image.shape, rng, 5))
    canvas.border(0.05, (178, 70, 52))
    canvas.part(0.605, 0.15, 0.59, 0.45).border(0.05, (178, 70, 52))
    canvas.text(0.15, 0.8, 0.1, fittings.phrase(rng, 3), (60, 80, 120), width=1.4)
    scuff(canvas, rng, 15)
    name = scenery.material(f"backboard_{wall.name}", canvas.image)
    scenery.box(name, name, wall.at(u, off, z), wall.along, (1.8, 0.04, 1.05))
    for side in (-0.6, 0.6):
        scenery.bar("hoop_arm", "iron", wall.at(u + side, 0.0, z + 0.9), wall.at(u + side, off, z + 0.35), 0.06)
        scenery.bar("hoop_arm", "iron", wall.at(u + side, 0.0, z - 0.4), wall.at(u + side, off, z - 0.35), 0.06)
    angles = np.linspace(0, 2 * np.pi, 17)
    ring = [wall.at(u + 0.23 * np.cos(a), off + 0.4 + 0.23 * np.sin(a), 3.05) for a in angles]
    for start, end in pairwise(ring):
        scenery.bar("hoop_ring", "orange", start, end, 0.02)


def _roof(scenery: Scenery, rng: np.random.Generator) -> None:
    """Beams across the hall, ducts along it, lamps between."""
    length, width, height = HALL_M
    canvas = Canvas.blank(20.0, 0.6, 60, (170, 138, 98))
    courses(canvas, rng, [(172, 138, 98), (160, 126, 88)], unit_m=(3.0, 0.1), joint_m=0.015, joint=(120, 94, 64))
    weather(canvas.image, grain(canvas.image.shape, rng, 6, stretch=(1, 8)))
    scenery.material("roof_beam", canvas.image)
    canvas = Canvas.blank(30.0, 0.5, 60, (152, 154, 156))
    courses(canvas, rng, [(158, 160, 162), (148, 150, 152)], unit_m=(1.5, 0.5), joint_m=0.04, joint=(104, 106, 108))
    weather(canvas.image, grain(canvas.image.shape, rng, 6))
    scenery.material("duct", canvas.image)
    for x in np.arange(-10.0, 10.1, 5.0):
        scenery.box("roof_beam", "roof_beam", (x, 0, height - 0.3), (0, 1, 0), (width, 0.24, 0.6))
    for y in (-7.0, 7.0):
        scenery.box("duct", "duct", (0, y, height - 0.9), (1, 0, 0), (length, 0.5, 0.5))
    for x in np.arange(-12.5, 12.6, 5.0):
        for y in (-8.6, -4.5, -1.5, 1.5, 4.5, 8.6):
            scenery.box("lamp", "lamp", (x, y, height - 0.15), (1, 0, 0), (2.6, 0.35, 0.1))
