"""Clothing, skin and hair of the athlete, as textures that go round a limb.

An image shows a garment unrolled: its middle is the front of the body part, its right the body's left, its top the end
that is up in the zero pose. MuJoCo wraps a primitive from its x axis, so images are rolled by half before use.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.types import Image, without_side
from sim.hall.textures import Canvas, Colour, arc, grain, weather

_PX_PER_M: Final = 480.0
_PALETTES: Final[tuple[tuple[Colour, Colour, Colour], ...]] = (
    ((186, 32, 44), (245, 240, 230), (38, 42, 60)),
    ((28, 62, 150), (250, 205, 60), (52, 54, 58)),
    ((20, 120, 92), (240, 240, 244), (30, 34, 48)),
    ((236, 236, 232), (200, 40, 60), (30, 48, 104)),
    ((240, 130, 36), (32, 36, 66), (60, 62, 70)),
    ((112, 44, 130), (238, 226, 120), (40, 40, 44)),
)  # shirt, print, trousers
_SKIN: Final[tuple[Colour, ...]] = ((224, 172, 142), (205, 150, 118), (170, 118, 88), (120, 82, 60))
_HAIR: Final[tuple[Colour, ...]] = ((40, 30, 26), (84, 56, 36), (150, 112, 66), (28, 26, 28))
_TEAMS: Final = ("GYMNAS", "TURNEN", "VOLTE", "SALTO", "KIPPE", "ARENA")


@dataclass(frozen=True, slots=True)
class Wardrobe:
    """The colours of one person, and whether the cloth is printed."""

    rich: bool
    shirt: Colour
    accent: Colour
    trousers: Colour
    skin: Colour
    hair: Colour
    team: str
    number: str

    @classmethod
    def draw(cls, rich: bool, rng: np.random.Generator) -> Wardrobe:
        """Choose what to wear."""
        shirt, accent, trousers = _PALETTES[rng.integers(len(_PALETTES))]
        skin = _SKIN[rng.choice(4, p=(0.4, 0.3, 0.2, 0.1))]
        hair = _HAIR[rng.integers(len(_HAIR))]
        team = _TEAMS[rng.integers(len(_TEAMS))]
        return cls(rich, shirt, accent, trousers, skin, hair, team, f"{rng.integers(2, 99):02d}")


def paint(part: str, girth_m: float, length_m: float, wardrobe: Wardrobe, rng: np.random.Generator) -> Image:
    """Paint the texture (H, W, 3), red-green-blue, of one body part of the given girth and length.

    Parts: chest, yoke, waist, hips, seat, sleeve, {left,right}_thigh, {left,right}_shank, skin, hair, shoe, sock.
    """
    kind = without_side(part)
    cloth = dict.fromkeys(("chest", "yoke", "waist", "sleeve"), wardrobe.shirt)
    cloth |= {"hair": wardrobe.hair, "skin": wardrobe.skin, "shoe": (226, 226, 222), "sock": (236, 236, 236)}
    canvas = Canvas.blank(girth_m, length_m, _PX_PER_M, cloth.get(kind, wardrobe.trousers))
    outside = 0.25 if part.startswith("right") else 0.75
    if wardrobe.rich:
        {"chest": _chest, "waist": _waist, "sleeve": _sleeve, "yoke": _yoke}.get(kind, lambda *_: None)(
            canvas, wardrobe, rng
        )
        if kind == "hips":
            _hips(canvas, wardrobe)
        elif kind == "seat":
            canvas.rectangle(0, 0.60 * canvas.height_m, canvas.width_m, 0.008, _shade(wardrobe.trousers, 1.7))
        elif kind in ("thigh", "shank"):
            _leg(canvas, wardrobe, outside, kind, rng)
        elif kind == "shoe":
            _shoe(canvas, wardrobe)
    if kind == "skin":
        _skin(canvas, rng)
    elif kind == "hair":
        weather(canvas.image, _round(canvas.image, rng, 10.0, (6, 1)))
    else:
        weather(canvas.image, _round(canvas.image, rng, 3.5 if wardrobe.rich else 2.5, (1, 1)))
        # folds of the cloth run along the limb
        weather(canvas.image, _round(canvas.image, rng, 2.5 if wardrobe.rich else 1.0, (8, 2)))
    return np.ascontiguousarray(np.roll(canvas.image, canvas.image.shape[1] // 2, axis=1))


def _round(image: Image, rng: np.random.Generator, amplitude: float, stretch: tuple[int, int]) -> np.ndarray:
    """Return grain (H, W) that closes round the limb."""
    field = grain(image.shape, rng, amplitude, stretch=stretch, octaves=5)
    weight = np.minimum(1.0, 4.0 * (0.5 - np.abs(np.linspace(-0.5, 0.5, image.shape[1]))))
    return np.round(weight * field + (1.0 - weight) * np.roll(field, image.shape[1] // 2, axis=1)).astype(np.int16)


def _shade(colour: Colour, factor: float) -> Colour:
    return (colour[0] * factor, colour[1] * factor, colour[2] * factor)


def _chest(canvas: Canvas, wardrobe: Wardrobe, rng: np.random.Generator) -> None:
    w, h, accent = canvas.width_m, canvas.height_m, wardrobe.accent
    dark = _shade(wardrobe.shirt, 0.6)
    # a yoke of chevrons over the shoulders, a broad and two narrow stripes below the letters
    for k in range(5):
        y = 0.74 * h + 0.035 * k
        colour = accent if k % 2 == 0 else dark
        for side in (0, 1):
            x = side * w / 2
            canvas.line([(x, y), (x + w / 4, y - 0.05), (x + w / 2, y)], 0.012, colour)
    canvas.rectangle(0, 0.27 * h, w, 0.05, accent)
    canvas.rectangle(0, 0.27 * h + 0.065, w, 0.012, accent)
    canvas.rectangle(0, 0.27 * h - 0.03, w, 0.018, dark)
    canvas.text(0.5 * w - 0.12, 0.27 * h + 0.10, 0.055, wardrobe.team, accent, width=0.24)
    for x, y, r in ((0.5 * w + 0.09, 0.66 * h, 0.026), (0.5 * w - 0.10, 0.655 * h, 0.018)):
        canvas.disc(x, y, r, accent)
        canvas.ring(x, y, 0.7 * r, 0.006, dark)
        canvas.polygon(arc(x, y, 0.5 * r, 0.3, 2.9), wardrobe.trousers)
    # the number is on the back, which lies half on either edge
    for x in (-0.10, w - 0.10):
        canvas.text(x, 0.27 * h + 0.085, 0.16, wardrobe.number, accent, width=0.20)
    for x in (0.25 * w, 0.75 * w):
        canvas.rectangle(x - 0.022, 0, 0.044, 0.62 * h, dark)
        for y in np.arange(0.02, 0.6 * h, 0.04):
            canvas.rectangle(x - 0.012, y, 0.024, 0.02, accent)
    _specks(canvas, rng, dark, 120, 0.004)


def _yoke(canvas: Canvas, wardrobe: Wardrobe, rng: np.random.Generator) -> None:
    w, h, dark = canvas.width_m, canvas.height_m, _shade(wardrobe.shirt, 0.6)
    canvas.rectangle(0, 0.16 * h, w, 0.02, wardrobe.accent)
    canvas.rectangle(0, 0.16 * h + 0.03, w, 0.012, dark)
    canvas.rectangle(0, 0.55 * h, w, 0.02, dark)
    _specks(canvas, rng, dark, 100, 0.004)


def _waist(canvas: Canvas, wardrobe: Wardrobe, rng: np.random.Generator) -> None:
    w, h, dark = canvas.width_m, canvas.height_m, _shade(wardrobe.shirt, 0.62)
    count = round(w / 0.10)
    for k in range(-count, 2 * count):
        x = k * w / count
        canvas.line([(x, 0), (x + 3 * w / count, h)], 0.024, wardrobe.accent if k % 2 else dark)
    canvas.rectangle(0, 0.58 * h, w, 0.03, wardrobe.shirt)
    canvas.text(0.5 * w + 0.03, 0.59 * h, 0.018, "PAN ZOOM", wardrobe.accent)
    _specks(canvas, rng, wardrobe.shirt, 120, 0.004)


def _sleeve(canvas: Canvas, wardrobe: Wardrobe, rng: np.random.Generator) -> None:
    w, h = canvas.width_m, canvas.height_m
    canvas.rectangle(0, 0.10 * h, w, 0.04, wardrobe.accent)
    canvas.rectangle(0, 0.10 * h + 0.052, w, 0.012, _shade(wardrobe.shirt, 0.6))
    canvas.rectangle(0, 0.55 * h, w, 0.02, _shade(wardrobe.shirt, 0.6))
    canvas.rectangle(0, 0.55 * h + 0.03, w, 0.02, wardrobe.accent)
    for x in (0.25 * w, 0.75 * w):
        canvas.disc(x, 0.38 * h, 0.024, wardrobe.accent)
        canvas.ring(x, 0.38 * h, 0.014, 0.006, wardrobe.trousers)
    _specks(canvas, rng, _shade(wardrobe.shirt, 0.75), 100, 0.004)


def _hips(canvas: Canvas, wardrobe: Wardrobe) -> None:
    w, h = canvas.width_m, canvas.height_m
    light, dark = _shade(wardrobe.trousers, 1.7), _shade(wardrobe.trousers, 0.55)
    canvas.rectangle(0, 0.66 * h, w, 0.035, wardrobe.accent)
    for x in np.arange(0.0, w, w / 24):
        canvas.rectangle(x, 0.66 * h, 0.008, 0.035, dark)
    canvas.line([(0.5 * w, 0), (0.5 * w, 0.66 * h)], 0.006, dark)
    for side in (-1, 1):
        canvas.line([(0.5 * w + side * 0.08, 0.64 * h), (0.5 * w + side * 0.16, 0.42 * h)], 0.007, light)
        canvas.rectangle((0.5 + 0.25 * side) * w - 0.015, 0, 0.03, 0.66 * h, wardrobe.accent)
        for x in ((0.5 + 0.5 * side) * w - side * 0.09,):
            canvas.rectangle(x - 0.05, 0.42 * h, 0.10, 0.008, light)


def _leg(canvas: Canvas, wardrobe: Wardrobe, outside: float, kind: str, rng: np.random.Generator) -> None:
    w, h = canvas.width_m, canvas.height_m
    light, dark = _shade(wardrobe.trousers, 1.7), _shade(wardrobe.trousers, 0.55)
    stripe = outside * w
    canvas.rectangle(stripe - 0.025, 0, 0.05, h, wardrobe.accent)
    canvas.rectangle(stripe - 0.008, 0, 0.016, h, wardrobe.shirt)
    canvas.rectangle((1 - outside) * w - 0.003, 0, 0.006, h, dark)
    canvas.rectangle(0.5 * w - 0.003, 0, 0.006, h, light)
    for _ in range(12):
        x, y, lean = rng.uniform(0.03, w - 0.03), rng.uniform(0, h), rng.uniform(-0.03, 0.03)
        bend = [(x - 0.03, y), (x, y + lean), (x + 0.03, y + 0.5 * lean)]
        canvas.line(bend, 0.005, light if rng.random() < 0.5 else dark)
    if kind == "thigh":
        canvas.text(0.5 * w - 0.06, 0.55 * h, 0.035, wardrobe.team, light, width=0.12)
        canvas.rectangle(0, 0.22 * h, w, 0.006, dark)
    else:
        canvas.rectangle(0, 0.62 * h, w, 0.012, light)
        canvas.rectangle(0, 0.20 * h, w, 0.02, wardrobe.accent)
        canvas.rectangle(0, 0.14 * h, w, 0.010, wardrobe.shirt)
    _specks(canvas, rng, light, 100, 0.003)


def _shoe(canvas: Canvas, wardrobe: Wardrobe) -> None:
    w, h = canvas.width_m, canvas.height_m
    for k in range(3):
        y = (0.35 + 0.13 * k) * h
        canvas.rectangle(0, y, w, 0.014, wardrobe.shirt if k % 2 == 0 else wardrobe.trousers)


def _skin(canvas: Canvas, rng: np.random.Generator) -> None:
    weather(canvas.image, _round(canvas.image, rng, 1.2, (1, 1)))
    mean = canvas.image.reshape(-1, 3).mean(axis=0)
    brown = (float(mean[0]) * 0.8, float(mean[1]) * 0.74, float(mean[2]) * 0.74)
    _specks(canvas, rng, brown, 40, 0.003)


def _specks(canvas: Canvas, rng: np.random.Generator, colour: Colour, per_m2: float, radius_m: float) -> None:
    for _ in range(round(per_m2 * canvas.width_m * canvas.height_m)):
        x, y = rng.uniform(0.0, canvas.width_m), rng.uniform(0.0, canvas.height_m)
        canvas.disc(x, y, radius_m * float(rng.uniform(0.5, 1.0)), colour)
