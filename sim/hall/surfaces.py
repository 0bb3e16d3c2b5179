"""Textures of walls, floor, carpet and ceiling of the hall: paintings in metres, one a surface."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from sim.hall import fittings
from sim.hall.scenery import HALL_M, Wall
from sim.hall.textures import Canvas, Colour, arc, courses, flecks, grain, scuff, speckle, tint, wear, weather

LOWER_M: Final = 2.75  # height of the lower part of the walls, which cameras come near to
CARPET_M: Final = 12.0
PILASTERS_U: Final = (5.0, 10.0, 15.0, 20.0, 25.0)  # along the long walls
PILASTER_M: Final = 0.5
PLASTER: Final[Colour] = (150, 190, 176)

Fitting = Callable[[Canvas, np.random.Generator], None]
Place = tuple[Fitting, float, float, float, float]  # what, left, bottom, width, height
Rectangle = tuple[float, float, float, float]  # left, bottom, width, height, metres


def lower_wall(wall: Wall, px_per_m: float, rng: np.random.Generator) -> Canvas:
    """The lower 2.75 m: a robust material, doors, mats, posters, and the marks of use."""
    canvas = Canvas.blank(wall.length, LOWER_M, px_per_m, (128, 128, 128))
    if wall.name in ("south", "north"):
        colours: tuple[Colour, ...] = (
            ((162, 178, 164), (154, 170, 156), (170, 184, 170))
            if wall.name == "south"
            else ((158, 170, 184), (150, 162, 178), (166, 178, 190))
        )
        courses(canvas, rng, colours, unit_m=(0.3, 0.1), joint_m=0.012, joint=(118, 122, 120), spread=9)
        weather(canvas.image, grain(canvas.image.shape, rng, 6))
    else:
        colours = ((198, 166, 124), (186, 154, 114), (206, 176, 134), (194, 160, 116))
        unit = (2.4, 0.14) if wall.name == "east" else (1.25, 0.34)
        courses(canvas, rng, colours, unit_m=unit, joint_m=0.012, joint=(112, 88, 64), spread=7)
        weather(canvas.image, grain(canvas.image.shape, rng, 6, stretch=(1, 8)))
        weather(canvas.image, grain(canvas.image.shape, rng, 4))
    speckle(canvas, rng, ((0.008, 0.04, -34), (0.014, 0.05, -26), (0.03, 0.04, 16), (0.09, 0.03, -12)))
    taken = _hang(canvas, rng, _LOWER[wall.name]) + _pilasters(wall)
    posters = (
        (fittings.poster, 0.6, 0.85),
        (fittings.sheet, 0.3, 0.42),
        (fittings.poster, 0.42, 0.6),
        (_plate, 0.22, 0.16),
    )
    _fill(canvas, rng, taken, posters, 0.5, 2.4, round(2.2 * wall.length))
    wear(canvas, rng)
    canvas.rectangle(0, 0, wall.length, 0.1, (84, 80, 76))
    canvas.rectangle(0, LOWER_M - 0.12, wall.length, 0.12, (118, 104, 86))
    return canvas


def upper_wall(wall: Wall, px_per_m: float, rng: np.random.Generator) -> Canvas:
    """From 2.75 m to the ceiling: blockwork, windows, banners, sponsors' boards, pipes."""
    canvas = Canvas.blank(wall.length, HALL_M[2] - LOWER_M, px_per_m, (128, 128, 128))
    colours = ((196, 192, 180), (188, 184, 172), (204, 200, 188))
    courses(canvas, rng, colours, unit_m=(0.5, 0.25), joint_m=0.02, joint=(150, 146, 138), spread=7)
    weather(canvas.image, grain(canvas.image.shape, rng, 6))
    speckle(canvas, rng, ((0.02, 0.05, -20), (0.06, 0.04, -10), (0.3, 0.08, -5)))
    for y in (0.12, 4.85, 4.98):
        canvas.line([(0, y), (wall.length, y)], 0.05, (128, 132, 134))
        for u in np.arange(rng.uniform(0.3, 1), wall.length, 1.5):
            canvas.rectangle(u, y - 0.05, 0.06, 0.1, (92, 94, 96))
    taken = _hang(canvas, rng, _UPPER[wall.name]) + _pilasters(wall)
    boards = (
        (fittings.advert, 2.4, 0.8), (fittings.advert, 1.6, 0.55), (_pennant, 0.7, 1.5), (fittings.vent, 0.8, 0.5),
        (fittings.poster, 0.8, 1.1),
    )  # fmt: skip
    _fill(canvas, rng, taken, boards, 0.25, 4.7, round(2.5 * wall.length))
    return canvas


def plaster(canvas: Canvas, rng: np.random.Generator) -> None:
    """Paint over all that is on a wall: one colour, faintly mottled."""
    canvas.fill(PLASTER)
    weather(canvas.image, grain(canvas.image.shape, rng, 0.6))


def floor(px_per_m: float, rng: np.random.Generator) -> Canvas:
    """Strip parquet with the lines of four games; the canvas's up is the world's y."""
    canvas = Canvas.blank(HALL_M[0], HALL_M[1], px_per_m, (150, 126, 94))
    colours = ((182, 150, 108), (172, 140, 100), (190, 160, 118), (176, 146, 110))
    courses(canvas, rng, colours, unit_m=(1.1, 0.12), joint_m=0.012, joint=(104, 80, 56), spread=7)
    weather(canvas.image, grain(canvas.image.shape, rng, 5, stretch=(1, 6)))
    speckle(canvas, rng, ((0.02, 0.08, -24), (0.02, 0.05, 18), (0.08, 0.04, -12)))
    x, y = HALL_M[0] / 2, HALL_M[1] / 2
    _court(canvas, x, y, 28.0, 15.0, 0.05, fittings.INK)
    _court(canvas, x, y, 18.0, 9.0, 0.05, (206, 204, 196))
    for side in (-1, 1):
        _court(canvas, x + side * 8.5, y, 6.1, 13.4, 0.04, (52, 112, 78))
        end = x + side * 14
        key = [(end, y - 2.45), (end - side * 5.8, y - 2.45), (end - side * 5.8, y + 2.45), (end, y + 2.45)]
        canvas.line(key, 0.05, fittings.INK)
        canvas.ring(end - side * 5.8, y, 1.8, 0.05, fittings.INK)
        turn = np.pi if side > 0 else 0.0
        canvas.line(arc(end, y, 6.75, turn - np.pi / 2, turn + np.pi / 2), 0.05, fittings.INK)
        canvas.line(arc(end + side, y, 9.0, turn - 0.6, turn + 0.6), 0.05, (188, 104, 44))
        for row in (-1, 1):
            title = "NORTH HALL" if row > 0 else "SPORT CLUB 1862"
            canvas.text(x + side * 9 - 2.6, y + row * 8.7 - 0.3, 0.55, title, (70, 86, 120), weight=0.2, width=5.5)
            fittings.emblem(canvas.part(x + side * 13.2 - 0.6, y + row * 6.0 - 0.6, 1.2, 1.2), rng)
    scuff(canvas, rng, 2.0)
    return canvas


def carpet(px_per_m: float, rng: np.random.Generator) -> Canvas:
    """The floor-exercise carpet: blue with a beige border, rolls 2 m wide, logos, chalk and footprints."""
    size = CARPET_M
    canvas = Canvas.blank(size, size, px_per_m, (178, 160, 126))
    field = canvas.part(1.0, 1.0, size - 2, size - 2)
    courses(field, rng, [(74, 104, 158)], unit_m=(20, 2.0), joint_m=0.012, joint=(56, 80, 126), spread=3, stagger=False)
    weather(canvas.image, grain(canvas.image.shape, rng, 9, persistence=0.95, octaves=7))
    speckle(canvas, rng, ((0.015, 0.10, -26), (0.015, 0.06, 26), (0.05, 0.04, -14), (0.25, 0.10, 7)))
    patches, dust = (
        flecks(canvas.image.shape, rng, size * px_per_m, share) for size, share in ((0.6, 0.04), (0.03, 0.4))
    )
    tint(canvas.image, patches & dust, (34, 32, 28))
    canvas.border(0.05, (206, 204, 196), inset=0.975)
    canvas.border(0.04, (96, 84, 66), inset=0.04)
    for k, title in enumerate(("CITY CUP FINALS", "NORTH HALL", "FLOOR EXERCISE", "CROWN BREAD")):
        canvas.text(2.2, 0.3, 0.36, title, (66, 84, 128), weight=0.2, width=4.0)
        canvas.text(7.2, 0.3, 0.36, "SPORT CLUB 1862", (152, 70, 58), weight=0.13, width=3.0)
        for x in (1.25, 6.3, 10.95):
            fittings.emblem(canvas.part(x - 0.3, 0.18, 0.6, 0.6), rng)
        fittings.emblem(canvas.part(1.5, 1.5, 1.3, 1.3), rng)
        canvas.text(3.1, 1.45, 0.5, f"{k + 1} GYM", (196, 194, 186), weight=0.2)
        canvas = Canvas(np.rot90(canvas.image), px_per_m)
        canvas.image = np.ascontiguousarray(canvas.image)
    canvas.ring(size / 2, size / 2, 1.6, 0.06, (190, 188, 180))
    fittings.emblem(canvas.part(size / 2 - 1.1, size / 2 - 1.1, 2.2, 2.2), rng)
    scuff(canvas, rng, 3.0, 30)
    return canvas


def ceiling(px_per_m: float, rng: np.random.Generator) -> Canvas:
    """Acoustic tiles."""
    canvas = Canvas.blank(HALL_M[0], HALL_M[1], px_per_m, (170, 170, 166))
    courses(
        canvas, rng, [(196, 194, 188), (188, 187, 182)], unit_m=(1.25, 0.625), joint_m=0.04, joint=(120, 118, 114),
        spread=6, stagger=False,
    )  # fmt: skip
    weather(canvas.image, grain(canvas.image.shape, rng, 6))
    speckle(canvas, rng, ((0.08, 0.12, -30),))
    return canvas


def _hang(canvas: Canvas, rng: np.random.Generator, places: tuple[Place, ...]) -> list[Rectangle]:
    """Paint fittings in their places; return these."""
    for fitting, u, y, width, height in places:
        fitting(canvas.part(u, y, width, height), rng)
    return [place[1:] for place in places]


def _fill(
    canvas: Canvas, rng: np.random.Generator, taken: list[Rectangle], choices: tuple[tuple[Fitting, float, float], ...],
    bottom: float, top: float, attempts: int,
) -> None:  # fmt: skip
    """Paint the choices in turn at random places, where nothing is ``taken`` yet."""
    margin = 0.12
    for k in range(attempts):
        fitting, width, height = choices[k % len(choices)]
        width, height = width * rng.uniform(0.8, 1.15), height * rng.uniform(0.8, 1.15)
        u, y = rng.uniform(0.2, canvas.width_m - width - 0.2), rng.uniform(bottom, max(bottom, top - height))
        apart = all(
            u + width + margin < a or a + w + margin < u or y + height + margin < b or b + h + margin < y
            for a, b, w, h in taken
        )
        if apart:
            fitting(canvas.part(u, y, width, height), rng)
            taken.append((u, y, width, height))


def _pilasters(wall: Wall) -> list[Rectangle]:
    if wall.length < HALL_M[0]:
        return []
    return [(u - PILASTER_M / 2, 0.0, PILASTER_M, HALL_M[2]) for u in PILASTERS_U]


def _court(canvas: Canvas, x: float, y: float, length: float, width: float, line: float, colour: Colour) -> None:
    part = canvas.part(x - length / 2, y - width / 2, length, width)
    part.border(line, colour)
    part.line([(length / 2, 0), (length / 2, width)], line, colour)


def _pennant(canvas: Canvas, rng: np.random.Generator) -> None:
    fittings.banner(canvas, rng, (fittings.phrase(rng, 1), str(rng.integers(1950, 2004)), fittings.phrase(rng, 1)))


def _long_banner(canvas: Canvas, rng: np.random.Generator) -> None:
    fittings.banner(canvas, rng, ("CITY CUP GYMNASTICS", fittings.phrase(rng, 3)))


def _shutter(canvas: Canvas, rng: np.random.Generator) -> None:
    fittings.shutter(canvas, rng, f"EQUIPMENT {rng.integers(1, 9)}")


def _plate(canvas: Canvas, rng: np.random.Generator) -> None:
    canvas.fill(fittings.hue(rng))
    fittings.small_print(
        canvas.part(0.02, 0.01, canvas.width_m - 0.04, canvas.height_m - 0.02), rng, 0.04, fittings.PAPER
    )
    canvas.border(0.012, fittings.PAPER)


_door: Final = partial(fittings.door, colour=(158, 130, 102))
_double_door: Final = partial(fittings.door, colour=(116, 138, 150), leaves=2)
_window: Final = partial(fittings.window, panes=(4, 2))
_pads: Final = partial(fittings.pad, colour=(84, 110, 158))

# What hangs where: the left end from inside, the height above the floor (above the lower part), width and height.
_LOWER: Final[dict[str, tuple[Place, ...]]] = {
    "south": (
        (_door, 3.6, 0.1, 1.0, 2.1), (fittings.exit_sign, 3.8, 2.28, 0.6, 0.22),
        (_double_door, 10.9, 0.1, 2.0, 2.15), (fittings.exit_sign, 11.5, 2.32, 0.8, 0.24),
        (fittings.hose_cabinet, 13.4, 0.9, 0.6, 0.75), (_long_banner, 15.6, 1.35, 4.1, 0.95),
        (fittings.advert, 15.6, 0.25, 2.0, 0.85), (fittings.advert, 17.7, 0.25, 2.0, 0.85),
        (_pads, 25.5, 0.1, 2.0, 1.7),
    ),
    "north": (
        (_pads, 2.6, 0.1, 2.0, 1.7), (_long_banner, 5.5, 1.35, 4.1, 0.95),
        (fittings.advert, 5.5, 0.25, 2.0, 0.85), (fittings.advert, 7.6, 0.25, 2.0, 0.85),
        (_double_door, 21.3, 0.1, 2.0, 2.15), (fittings.exit_sign, 21.9, 2.32, 0.8, 0.24),
        (fittings.hose_cabinet, 23.8, 0.9, 0.6, 0.75),
        (_door, 25.6, 0.1, 1.0, 2.1), (fittings.exit_sign, 25.8, 2.28, 0.6, 0.22),
    ),
    "east": ((_door, 3.8, 0.1, 1.0, 2.1), (fittings.exit_sign, 4.0, 2.28, 0.6, 0.22), (_door, 15.2, 0.1, 1.0, 2.1)),
    "west": ((_shutter, 2.7, 0.1, 3.2, 2.35), (_shutter, 14.1, 0.1, 3.2, 2.35), (_pads, 7.0, 0.1, 6.0, 2.0)),
}  # fmt: skip
_UPPER: Final[dict[str, tuple[Place, ...]]] = {
    "south": (*((_window, 0.6 + 5 * k, 2.1, 3.8, 2.4) for k in range(6)), (_long_banner, 10.5, 0.5, 4.0, 1.2)),
    "north": (
        *((_window, 0.6 + 5 * k, 2.1, 3.8, 2.4) for k in (0, 2, 3, 5)),
        *((_pennant, 5.6 + 1.4 * k + j, 1.2, 1.1, 3.2) for j in (0, 15) for k in range(3)),
        (fittings.scoreboard, 10.7, 0.3, 3.4, 1.5),
    ),
    "east": (
        (_long_banner, 5.0, 1.7, 10.0, 1.4), *((fittings.slats, u, 3.3, 5.0, 1.25) for u in (4.8, 10.2)),
        (fittings.emblem, 1.4, 1.6, 2.6, 2.6), (fittings.clock, 17.0, 2.2, 1.3, 1.3),
    ),
    "west": (
        (fittings.slats, 0.5, 1.0, 5.0, 3.7), (fittings.slats, 14.5, 1.0, 5.0, 3.7),
        (fittings.clock, 6.2, 3.0, 1.1, 1.1), (fittings.emblem, 12.0, 2.2, 2.0, 2.0),
        (_pennant, 7.6, 2.4, 0.9, 2.2), (_pennant, 11.0, 2.4, 0.8, 2.0),
    ),
}  # fmt: skip
