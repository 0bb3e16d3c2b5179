"""Paintings of fittings on the walls: posters, doors, windows, banners, signs. Each function fills its canvas."""

from __future__ import annotations

from typing import Final

import numpy as np

from sim.hall.textures import Canvas, Colour, courses, flecks, grain, tint, weather

INK: Final[Colour] = (38, 38, 42)
PAPER: Final[Colour] = (205, 202, 192)
TRIM: Final[Colour] = (92, 96, 100)

_HUES: Final[tuple[Colour, ...]] = (
    (168, 60, 52), (52, 92, 150), (60, 122, 84), (196, 152, 60), (120, 74, 128), (62, 128, 140), (190, 104, 52),
    (84, 88, 98), (150, 144, 130), (44, 60, 96), (128, 140, 66), (176, 96, 116),
)  # fmt: skip
_WORDS: Final = (
    "GYM", "CITY", "CUP", "SPORT", "CLUB", "1862", "NORTH", "HALL", "TEAM", "SEASON", "JUNIOR", "FINALS", "TRAINING",
    "OPEN", "LEAGUE", "MEET", "1994", "GALA", "COURSE", "YOGA", "PLAN", "INFO", "DATES", "MASTERS", "YOUTH", "HAND",
    "BALL", "VOLLEY", "BASKET", "DANCE", "SQUAD", "BARS", "RINGS", "FLOOR", "VAULT", "HIGH BAR", "HORSE", "BEAM",
)  # fmt: skip
_FIRMS: Final = (
    "BECKER BUILD", "AQUA POWER", "WOOD & HALL", "NOVA OPTICS", "CROWN BREAD", "ALPINA BIKES", "MERKUR BANK",
    "ZENIT TRAVEL", "LINDEN PHARMACY", "OTTO PRINT", "FALCON TAXI", "SILVER & SON", "VITA JUICE", "RHINE COFFEE",
    "DELTA SOFT", "MAX TILES",
)  # fmt: skip


def hue(rng: np.random.Generator) -> Colour:
    """A muted print colour."""
    base = np.asarray(_HUES[rng.integers(len(_HUES))]) + rng.normal(0, 10, 3)
    red, green, blue = np.clip(1.1 * base, 25, 210)
    return float(red), float(green), float(blue)


def phrase(rng: np.random.Generator, words: int) -> str:
    return " ".join(_WORDS[i] for i in rng.integers(len(_WORDS), size=words))


def small_print(canvas: Canvas, rng: np.random.Generator, line_m: float, colour: Colour) -> None:
    """Ragged lines of text of the given pitch."""
    y = canvas.height_m - line_m
    while y > 0.2 * line_m:
        words = phrase(rng, int(rng.integers(2, 5)))
        canvas.text(0, y, 0.6 * line_m, words, colour, weight=0.1, width=canvas.width_m * rng.uniform(0.6, 1.0))
        y -= line_m


def gymnast(canvas: Canvas, rng: np.random.Generator, colour: Colour) -> None:
    """The silhouette of a person in mid-movement."""
    size = 0.46 * min(canvas.width_m, canvas.height_m)
    centre = np.array([canvas.width_m / 2, canvas.height_m / 2])

    def limb(start: np.ndarray, angle: float, length: float, thickness: float) -> np.ndarray:
        end = start + size * length * np.array([np.cos(angle), np.sin(angle)])
        canvas.line(np.stack([start, end]), size * thickness, colour)
        return end

    lean = rng.uniform(0, 2 * np.pi)
    shoulder = limb(centre, lean, 0.42, 0.2)
    head = shoulder + size * 0.22 * np.array([np.cos(lean), np.sin(lean)])
    canvas.disc(head[0], head[1], size * 0.11, colour)
    for side in (-1, 1):
        hand = limb(shoulder, lean + side * rng.uniform(0.3, 1.6), 0.27, 0.1)
        limb(hand, lean + side * rng.uniform(-0.4, 1.2), 0.27, 0.08)
        knee = limb(centre, lean + np.pi + side * rng.uniform(0.2, 1.3), 0.38, 0.15)
        limb(knee, lean + np.pi + side * rng.uniform(0.0, 1.0), 0.4, 0.11)


def poster(canvas: Canvas, rng: np.random.Generator) -> None:
    """A printed poster: fields of colour, a figure, a title, and small print."""
    width, height = canvas.width_m, canvas.height_m
    canvas.fill(hue(rng))
    for _ in range(int(rng.integers(3, 7))):
        x, y, size = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0.1, 0.5) * width
        kind = rng.integers(4)
        if kind == 0:
            canvas.disc(x, y, size, hue(rng))
        elif kind == 1:
            canvas.ring(x, y, size, 0.1 * width, hue(rng))
        elif kind == 2:
            canvas.polygon(rng.uniform(0, 1, (3, 2)) * (width, height), hue(rng))
        else:
            canvas.line([(0, y), (width, y + rng.uniform(-1, 1) * size)], 0.06 * width, hue(rng))
    gymnast(canvas.part(0.1 * width, 0.3 * height, 0.8 * width, 0.5 * height), rng, hue(rng))
    canvas.text(0.06 * width, 0.86 * height, 0.09 * height, phrase(rng, 2), PAPER, width=0.88 * width)
    canvas.rectangle(0, 0, width, 0.22 * height, PAPER)
    small_print(canvas.part(0.06 * width, 0.02 * height, 0.88 * width, 0.19 * height), rng, 0.036 * height, INK)
    canvas.border(0.02 * width, PAPER)


def sheet(canvas: Canvas, rng: np.random.Generator) -> None:
    """A printed sheet of paper: a heading, then text, a table or a picture."""
    width, height = canvas.width_m, canvas.height_m
    shade = rng.uniform(175, 210)
    canvas.fill((shade, shade - rng.uniform(0, 25), shade - rng.uniform(0, 50)))
    canvas.text(0.08 * width, 0.86 * height, 0.07 * height, phrase(rng, 2), hue(rng), width=0.84 * width)
    body = canvas.part(0.08 * width, 0.06 * height, 0.84 * width, 0.74 * height)
    kind = rng.integers(3)
    if kind == 0:
        small_print(body, rng, rng.uniform(0.018, 0.03), INK)
    elif kind == 1:
        for k in range(1, 8):
            body.rectangle(
                0, (k - 1) * body.height_m / 7, rng.uniform(0.2, 1) * body.width_m, body.height_m / 12, hue(rng)
            )
            body.line([(0, k * body.height_m / 7), (body.width_m, k * body.height_m / 7)], 0.004, INK)
        for x in np.linspace(0, body.width_m, 5):
            body.line([(x, 0), (x, body.height_m)], 0.003, INK)
    else:
        body.fill(hue(rng))
        weather(body.image, grain(body.image.shape, rng, 10, octaves=6))
        gymnast(body, rng, hue(rng))


def notice_board(canvas: Canvas, rng: np.random.Generator) -> None:
    """A framed cork board full of papers."""
    canvas.fill((142, 108, 72))
    weather(canvas.image, grain(canvas.image.shape, rng, 12))
    x = 0.08
    while x < canvas.width_m - 0.25:
        width = rng.uniform(0.18, 0.34)
        y = rng.uniform(0.07, 0.14)
        while y < canvas.height_m - 0.3:
            height = min(width * rng.uniform(1.0, 1.5), canvas.height_m - y - 0.05)
            paper = canvas.part(x + rng.uniform(0, 0.02), y, min(width, canvas.width_m - x - 0.07), height)
            poster(paper, rng) if rng.random() < 0.3 else sheet(paper, rng)
            canvas.disc(x + width / 2, y + height - 0.02, 0.009, hue(rng))
            y += height + rng.uniform(0.02, 0.07)
        x += width + rng.uniform(0.02, 0.06)
    canvas.border(0.045, (104, 100, 94))


def door(canvas: Canvas, rng: np.random.Generator, colour: Colour, leaves: int = 1) -> None:
    """A door of one or two leaves with a glass pane, a handle, a kick plate and a sign."""
    canvas.fill(colour)
    weather(canvas.image, grain(canvas.image.shape, rng, 4, stretch=(12, 1)))
    width, height = canvas.width_m / leaves, canvas.height_m
    for k in range(leaves):
        leaf = canvas.part(k * width, 0, width, height)
        leaf.rectangle(0.12, 0.05, width - 0.24, 0.22, (136, 138, 138))
        pane = leaf.part(width * 0.3, height * 0.52, width * 0.4, height * 0.34)
        pane.fill((74, 88, 92))
        weather(pane.image, grain(pane.image.shape, rng, 5, octaves=8))
        pane.line([(0, 0), (pane.width_m, pane.height_m)], 0.02, (110, 124, 126))
        pane.border(0.025, TRIM)
        handle = 0.14 if k == 1 else width - 0.14
        leaf.rectangle(handle - 0.03, 0.95, 0.06, 0.22, (168, 168, 164))
        leaf.line([(handle, 1.08), (handle + (0.13 if k == 1 else -0.13), 1.08)], 0.025, (196, 196, 190))
        leaf.text(width * 0.3, height * 0.45, 0.05, phrase(rng, 1), PAPER, width=0.4 * width)
        sheet(leaf.part(width * 0.35, height * 0.25, 0.21, 0.3), rng)
        sheet(pane.part(0.04, 0.05, 0.15, 0.2), rng)
        leaf.border(0.02, (64, 58, 52))
    canvas.border(0.06, (112, 110, 104))


def shutter(canvas: Canvas, rng: np.random.Generator, title: str) -> None:
    """The slatted gate of the equipment room."""
    courses(
        canvas, rng, [(174, 144, 106), (180, 150, 112), (166, 136, 98)], unit_m=(canvas.width_m, 0.11), joint_m=0.012,
        joint=(82, 64, 46), stagger=False,
    )  # fmt: skip
    weather(canvas.image, grain(canvas.image.shape, rng, 5, stretch=(1, 10)))
    canvas.rectangle(0.3, 1.35, canvas.width_m - 0.6, 0.3, (70, 84, 110))
    canvas.text(0.4, 1.42, 0.16, title, PAPER, width=canvas.width_m - 0.8)
    canvas.rectangle(canvas.width_m / 2 - 0.2, 0.9, 0.4, 0.06, (60, 60, 62))
    for x in rng.uniform(0.3, canvas.width_m - 0.6, 5):
        sheet(canvas.part(x, rng.uniform(1.7, 1.95), 0.21, 0.3), rng)
        small_print(canvas.part(x, rng.uniform(0.4, 0.6), 0.4, 0.22), rng, 0.05, (74, 62, 50))
    canvas.border(0.08, TRIM)


def window(canvas: Canvas, rng: np.random.Generator, panes: tuple[int, int]) -> None:
    """A window of (columns, rows) panes with trees and sky behind."""
    rows = canvas.image.shape[0]
    sky = np.linspace((206, 210, 208), (184, 202, 216), rows)
    canvas.image[:] = sky[:, None].astype(np.uint8)
    weather(canvas.image, grain(canvas.image.shape, rng, 1.5, persistence=0.75))
    height = np.linspace(1.0, 0.0, rows)[:, None]
    crowns = grain(canvas.image.shape, rng, 3.0, persistence=0.7) / 110.0
    canvas.image[height + 0.5 * crowns < rng.uniform(0.3, 0.55)] = (88, 112, 82)
    canvas.image[height + 0.6 * crowns < rng.uniform(0.15, 0.3)] = (66, 88, 66)
    weather(canvas.image, grain(canvas.image.shape, rng, 7, octaves=5))
    frame = (196, 196, 190)
    for k in range(1, panes[0]):
        x = canvas.width_m * k / panes[0]
        canvas.line([(x, 0), (x, canvas.height_m)], 0.06, frame)
    for k in range(1, panes[1]):
        y = canvas.height_m * k / panes[1]
        canvas.line([(0, y), (canvas.width_m, y)], 0.05, frame)
    canvas.border(0.09, frame)
    canvas.border(0.02, (110, 112, 110))


def banner(canvas: Canvas, rng: np.random.Generator, lines: tuple[str, ...], ground: Colour | None = None) -> None:
    """A cloth banner with an emblem, lines of text and stripes."""
    width, height = canvas.width_m, canvas.height_m
    canvas.fill(ground or hue(rng))
    weather(canvas.image, grain(canvas.image.shape, rng, 3, stretch=(6, 1)))
    stripe = hue(rng)
    canvas.rectangle(0, 0.04 * height, width, 0.05 * height, stripe)
    canvas.rectangle(0, 0.91 * height, width, 0.05 * height, stripe)
    upright = height > 1.2 * width
    size = 0.3 * (width if upright else height)
    emblem_x, emblem_y = (width / 2, height - 0.45 * width) if upright else (0.6 * height, height / 2)
    emblem(canvas.part(emblem_x - size, emblem_y - size, 2 * size, 2 * size), rng)
    if upright:
        left, top, room = 0.1 * width, height - 0.95 * width, height - 1.1 * width
    else:
        left, top, room = 1.2 * height, 0.86 * height, 0.74 * height
    pitch = room / len(lines)
    for k, line in enumerate(lines):
        y = top - (k + 0.85) * pitch
        canvas.text(left, y, 0.66 * pitch, line, PAPER, weight=0.18, width=width - left - 0.1 * min(width, height))


def emblem(canvas: Canvas, rng: np.random.Generator) -> None:
    """A round club badge with a gymnast."""
    radius = canvas.width_m / 2
    for share in (0.98, 0.86, 0.78):
        canvas.disc(radius, radius, share * radius, PAPER if share == 0.86 else hue(rng))
    gymnast(canvas.part(0.3 * radius, 0.3 * radius, 1.4 * radius, 1.4 * radius), rng, PAPER)
    for angle in np.linspace(0, 2 * np.pi, 25)[:-1]:
        canvas.disc(radius + 0.82 * radius * np.cos(angle), radius + 0.82 * radius * np.sin(angle), 0.03 * radius, INK)


def advert(canvas: Canvas, rng: np.random.Generator) -> None:
    """A sponsor's board."""
    width, height = canvas.width_m, canvas.height_m
    canvas.fill(PAPER if rng.random() < 0.3 else hue(rng))
    colour = INK if float(canvas.image[0, 0].mean()) > 150 else PAPER
    kind = rng.integers(3)
    mark = hue(rng)
    if kind == 0:
        canvas.disc(0.55 * height, 0.5 * height, 0.36 * height, mark)
        canvas.ring(0.55 * height, 0.5 * height, 0.24 * height, 0.05 * height, colour)
    elif kind == 1:
        canvas.polygon(
            [(0.15 * height, 0.15 * height), (0.95 * height, 0.15 * height), (0.55 * height, 0.88 * height)], mark
        )
    else:
        for k in range(4):
            canvas.rectangle((0.15 + 0.2 * k) * height, 0.15 * height, 0.13 * height, (0.25 + 0.15 * k) * height, mark)
    firm = _FIRMS[rng.integers(len(_FIRMS))]
    canvas.text(1.15 * height, 0.42 * height, 0.4 * height, firm, colour, weight=0.2, width=width - 1.3 * height)
    canvas.text(1.15 * height, 0.14 * height, 0.14 * height, phrase(rng, 4), colour, width=width - 1.3 * height)
    canvas.border(0.02 * height, INK)


def clock(canvas: Canvas, _: np.random.Generator) -> None:
    """A round wall clock on a plate."""
    radius = canvas.width_m / 2
    canvas.disc(radius, radius, radius, (60, 62, 66))
    canvas.disc(radius, radius, 0.9 * radius, PAPER)
    for k in range(60):
        angle, inner = k * np.pi / 30, 0.7 if k % 5 == 0 else 0.8
        direction = np.array([np.cos(angle), np.sin(angle)])
        ends = [radius + inner * radius * direction, radius + 0.86 * radius * direction]
        canvas.line(ends, (0.05 if k % 5 == 0 else 0.015) * radius, INK)
    for angle, length, thickness in ((0.9, 0.45, 0.08), (-0.6, 0.72, 0.05)):
        tip = radius + length * radius * np.array([np.cos(angle), np.sin(angle)])
        canvas.line([(radius, radius), tip], thickness * radius, INK)


def scoreboard(canvas: Canvas, rng: np.random.Generator) -> None:
    """A dark board with lit digits."""
    width, height = canvas.width_m, canvas.height_m
    canvas.fill((46, 50, 54))
    weather(canvas.image, grain(canvas.image.shape, rng, 4))
    canvas.text(0.05 * width, 0.82 * height, 0.09 * height, "HOME", PAPER)
    canvas.text(0.76 * width, 0.82 * height, 0.09 * height, "GUEST", PAPER)
    for x, digits in ((0.05, 2), (0.35, 4), (0.76, 2)):
        string = "".join(str(d) for d in rng.integers(10, size=digits))
        canvas.rectangle(x * width, 0.42 * height, 0.095 * digits * width, 0.34 * height, (26, 26, 28))
        canvas.text(
            (x + 0.01) * width, 0.47 * height, 0.24 * height, string, (206, 116, 44), width=0.09 * digits * width
        )
    for k in range(6):
        canvas.disc((0.12 + 0.15 * k) * width, 0.28 * height, 0.035 * height, (188, 70, 48) if k % 2 else (76, 80, 84))
    small_print(
        canvas.part(0.05 * width, 0.05 * height, 0.9 * width, 0.16 * height), rng, 0.08 * height, (150, 150, 146)
    )
    canvas.border(0.03 * height, (120, 124, 128))


def pad(canvas: Canvas, rng: np.random.Generator, colour: Colour) -> None:
    """Upholstered wall mats, side by side, 1 m each."""
    count = max(1, round(canvas.width_m))
    width = canvas.width_m / count
    for k in range(count):
        mat = canvas.part(k * width, 0, width, canvas.height_m)
        mat.fill(colour if k % 2 == 0 else (colour[0] * 0.9, colour[1] * 0.9, colour[2] * 0.95))
        weather(mat.image, grain(mat.image.shape, rng, 4))
        mat.text(0.2, 0.25, 0.08, phrase(rng, 1), PAPER, width=0.6)
        for x in (0.09, width - 0.09):
            for y in np.arange(0.12, canvas.height_m, 0.3):
                mat.disc(x, y, 0.02, (168, 164, 150))
        mat.border(0.03, (36, 44, 60))
    emblem(canvas.part(canvas.width_m / 2 - 0.4, canvas.height_m * 0.5, 0.8, 0.8), rng)


def vent(canvas: Canvas, _: np.random.Generator) -> None:
    """A ventilation grille."""
    canvas.fill((120, 122, 120))
    for y in np.arange(0.06, canvas.height_m - 0.05, 0.07):
        canvas.rectangle(0.06, y, canvas.width_m - 0.12, 0.035, (58, 60, 62))
    canvas.border(0.04, (150, 150, 146))


def slats(canvas: Canvas, rng: np.random.Generator) -> None:
    """Acoustic panels of perforated wood."""
    courses(
        canvas, rng, [(190, 160, 120), (182, 152, 112), (198, 168, 130)], unit_m=(1.25, 0.62), joint_m=0.02,
        joint=(84, 66, 48), spread=6, stagger=False,
    )  # fmt: skip
    weather(canvas.image, grain(canvas.image.shape, rng, 6, stretch=(1, 8)))
    holes = flecks(canvas.image.shape, rng, 0.045 * canvas.px_per_m, 0.12)
    tint(canvas.image, holes, (-34, -30, -24))


def hose_cabinet(canvas: Canvas, rng: np.random.Generator) -> None:
    """A fire-hose cabinet with its signs."""
    width, height = canvas.width_m, canvas.height_m
    canvas.fill((166, 52, 44))
    canvas.part(0.1 * width, 0.5 * height, 0.8 * width, 0.4 * height).fill((186, 184, 176))
    canvas.ring(0.5 * width, 0.7 * height, 0.15 * width, 0.04, (150, 44, 40))
    canvas.text(0.12 * width, 0.36 * height, 0.07 * height, "FIRE", PAPER, width=0.76 * width)
    small_print(canvas.part(0.12 * width, 0.06 * height, 0.76 * width, 0.24 * height), rng, 0.035, PAPER)
    canvas.border(0.02, (100, 36, 34))


def exit_sign(canvas: Canvas, _: np.random.Generator) -> None:
    """A green sign over a door."""
    canvas.fill((48, 128, 84))
    canvas.text(
        0.1 * canvas.width_m, 0.28 * canvas.height_m, 0.45 * canvas.height_m, "EXIT", PAPER, width=0.5 * canvas.width_m
    )
    tip = (0.92 * canvas.width_m, 0.5 * canvas.height_m)
    canvas.line([(0.68 * canvas.width_m, tip[1]), tip], 0.12 * canvas.height_m, PAPER)
    canvas.border(0.015, PAPER)
