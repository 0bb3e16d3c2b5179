"""A canvas that is painted in metres, and the materials of a sports hall: masonry, boards, flecks, grain, wear.

Colours are red-green-blue, the order that MuJoCo's textures have.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.types import Image, Mask

Colour = tuple[float, ...]  # red, green, blue, 0..255; or one value on a grey canvas
Points = Sequence[Sequence[float]] | NDArray[np.float64]  # (N, 2) metres
_SHIFT: Final = 4  # fractional bits of OpenCV's drawing coordinates
_FONT: Final = cv2.FONT_HERSHEY_DUPLEX


class Canvas:
    """A flat rectangle painted in metres: x to the right, y up, from its lower left corner."""

    def __init__(self, image: Image, px_per_m: float) -> None:
        self.image = image
        self.px_per_m = px_per_m
        self.height_m, self.width_m = (n / px_per_m for n in image.shape[:2])

    @classmethod
    def blank(cls, width_m: float, height_m: float, px_per_m: float, colour: Colour) -> Canvas:
        image = np.empty((max(8, round(height_m * px_per_m)), max(8, round(width_m * px_per_m)), 3), np.uint8)
        canvas = cls(image, px_per_m)
        canvas.fill(colour)
        return canvas

    def part(self, x: float, y: float, width: float, height: float) -> Canvas:
        """A rectangle of this canvas as a canvas of its own, on the same pixels; clipped to this one."""
        rows, columns = self.image.shape[:2]
        left, right = (int(np.clip(round(v * self.px_per_m), 0, columns)) for v in (x, x + width))
        top, bottom = (int(np.clip(rows - round(v * self.px_per_m), 0, rows)) for v in (y + height, y))
        return Canvas(self.image[top:bottom, left:right], self.px_per_m)

    def fill(self, colour: Colour) -> None:
        cv2.rectangle(self.image, (0, 0), self.image.shape[1::-1], colour, cv2.FILLED)

    def polygon(self, points: Points, colour: Colour) -> None:
        cv2.fillPoly(self.image, [self._fixed(points)], colour, cv2.LINE_AA, _SHIFT)

    def rectangle(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        self.polygon([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], colour)

    def border(self, thickness: float, colour: Colour, inset: float = 0.0) -> None:
        """A frame along the canvas's edge, `inset` from it."""
        a = inset + thickness / 2
        right, top = self.width_m - inset - thickness / 2, self.height_m - inset - thickness / 2
        self.line([(a, a), (right, a), (right, top), (a, top), (a, a)], thickness, colour)

    def line(self, points: Points, thickness: float, colour: Colour) -> None:
        """A polyline, never thinner than a pixel."""
        width = max(1, round(thickness * self.px_per_m))
        cv2.polylines(self.image, [self._fixed(points)], False, colour, width, cv2.LINE_AA, _SHIFT)

    def disc(self, x: float, y: float, radius: float, colour: Colour) -> None:
        self.polygon(arc(x, y, radius), colour)

    def ring(self, x: float, y: float, radius: float, thickness: float, colour: Colour) -> None:
        self.line(arc(x, y, radius), thickness, colour)

    def text(
        self,
        x: float,
        y: float,
        height: float,
        string: str,
        colour: Colour,
        *,
        weight: float = 0.14,
        width: float = 1e9,
    ) -> None:
        """A line of capitals of the given height, its lower left at (x, y), set smaller if longer than `width`.

        `weight` is the stroke's thickness over the height.
        """
        (width_1, height_1), _ = cv2.getTextSize(string, _FONT, 1.0, 1)
        scale = min(height / height_1, width / max(width_1, 1)) * self.px_per_m
        left, bottom = self._fixed([(x, y)])[0] >> _SHIFT
        thickness = max(1, round(weight * scale * height_1))
        cv2.putText(self.image, string, (int(left), int(bottom)), _FONT, scale, colour, thickness, cv2.LINE_AA)

    def _fixed(self, points: Points) -> NDArray[np.int32]:
        """Metres to OpenCV's fixed-point coordinates, whose integers are pixel centres."""
        pixels = np.array(points, np.float64) * self.px_per_m
        pixels[:, 1] = self.image.shape[0] - pixels[:, 1]
        return np.round((pixels - 0.5) * (1 << _SHIFT)).astype(np.int32)


def arc(x: float, y: float, radius: float, start: float = 0.0, stop: float = 2 * np.pi) -> NDArray[np.float64]:
    """Points (N, 2) along an arc from angle `start` to `stop`, radians from the x axis."""
    angles = np.linspace(start, stop, 49)
    return np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], axis=1)


def grain(
    shape: tuple[int, ...], rng: np.random.Generator, amplitude: float, *,
    persistence: float = 0.85, octaves: int = 9, stretch: tuple[int, int] = (1, 1),
) -> NDArray[np.int16]:  # fmt: skip
    """Noise with structure at every scale, (H, W), zero mean; `amplitude` grey levels in the finest octave.

    Each coarser octave is 1 / `persistence` stronger; `stretch` draws the grain out along (rows, columns), as in wood.
    """
    rows, columns = -(-shape[0] // stretch[0]), -(-shape[1] // stretch[1])
    sizes = [(-(-rows // 2**k), -(-columns // 2**k)) for k in range(octaves)]
    field: NDArray[np.int16] = np.zeros((1, 1), np.int16)
    for k in reversed(range(octaves)):
        size = sizes[k]
        coarse = cv2.resize(field, size[::-1], interpolation=cv2.INTER_LINEAR).reshape(size)
        levels = np.round((np.arange(256) - 127.5) * (amplitude / persistence**k / 127.5)).astype(np.int16)
        field = coarse.astype(np.int16) + levels[np.frombuffer(rng.bytes(size[0] * size[1]), np.uint8).reshape(size)]
    if stretch != (1, 1):
        drawn = cv2.resize(field, (columns * stretch[1], rows * stretch[0]), interpolation=cv2.INTER_LINEAR)
        field = drawn.astype(np.int16)
    return np.ascontiguousarray(field[: shape[0], : shape[1]])


def weather(image: Image, field: NDArray[np.int16]) -> None:
    """Lighten and darken an image by a field of grey levels (H, W), in place, saturating."""
    cv2.add(image, cv2.merge([field, field, field]), dst=image, dtype=cv2.CV_8U)


def flecks(shape: tuple[int, ...], rng: np.random.Generator, size_px: float, share: float) -> Mask:
    """Irregular blots of about `size_px` that cover about a `share` of the image."""
    small = (max(2, int(shape[0] / size_px)), max(2, int(shape[1] / size_px)))
    noise = np.frombuffer(rng.bytes(small[0] * small[1]), np.uint8).reshape(small)
    field = cv2.resize(noise, shape[1::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field > np.quantile(field[::7, ::7], 1.0 - share))


def tint(image: Image, mask: Mask, change: Colour) -> None:
    """Add a colour to the masked pixels, in place, saturating."""
    cv2.add(image, np.array([*change, 0.0]), dst=image, mask=mask.view(np.uint8))


def speckle(canvas: Canvas, rng: np.random.Generator, kinds: Sequence[tuple[float, float, float]]) -> None:
    """Add grey `flecks` of kinds (size in metres, share of the canvas, change in grey levels)."""
    for size_m, share, change in kinds:
        tint(canvas.image, flecks(canvas.image.shape, rng, size_m * canvas.px_per_m, share), (change, change, change))


def scuff(canvas: Canvas, rng: np.random.Generator, per_m2: float, depth: int = 40) -> None:
    """Marks of use: dark streaks of 2 cm to 0.6 m and a few faint prints of balls, up to `depth` grey levels."""
    marks = np.zeros(canvas.image.shape[:2], np.uint8)
    layer = Canvas(marks, canvas.px_per_m)
    for _ in range(round(per_m2 * canvas.width_m * canvas.height_m)):
        x, y = rng.uniform(0, canvas.width_m), rng.uniform(0, canvas.height_m)
        shade = rng.uniform(0.3, 1.0) * depth
        size, angle = 0.02 * 30 ** rng.random(), rng.uniform(0, 2 * np.pi)
        if rng.random() < 0.1:
            layer.disc(x, y, 0.12, (0.25 * shade,))
        else:
            bend = arc(x, y, size / rng.uniform(0.3, 2.0), angle, angle + rng.uniform(0.2, 1.0))
            layer.line(bend, rng.uniform(0.003, 0.015), (shade,))
    cv2.subtract(canvas.image, cv2.merge([marks, marks, marks]), dst=canvas.image)


def wear(canvas: Canvas, rng: np.random.Generator) -> None:
    """Marks of wear on everything within reach: specks of 5 mm to 3 cm, smudges, streaks."""
    speckle(canvas, rng, ((0.006, 0.02, -26), (0.008, 0.015, 22), (0.014, 0.02, -18), (0.03, 0.02, 12)))
    weather(canvas.image, grain(canvas.image.shape, rng, 3, octaves=7))
    scuff(canvas, rng, 4.0)


def courses(
    canvas: Canvas, rng: np.random.Generator, colours: Sequence[Colour], *,
    unit_m: tuple[float, float], joint_m: float, joint: Colour, spread: float = 8.0, stagger: bool = True,
) -> None:  # fmt: skip
    """Cover a canvas with courses of bricks, boards or panels of (width, height) `unit_m`.

    Each unit takes one of the `colours`, lighter or darker by `spread` grey levels RMS. With `stagger` each course is
    shifted by a random amount. Units are up to four texels off what is asked for, see `_off_grid`.
    """
    rows, columns = canvas.image.shape[:2]
    width, height = (_off_grid(canvas.px_per_m * side) for side in unit_m)
    y, x = np.arange(rows) / height, np.arange(columns) / width
    count, units = int(y[-1]) + 1, int(x[-1]) + 2
    shifts = rng.uniform(0, 1, count) if stagger else np.zeros(count)
    palette = np.asarray(colours, np.float64)[rng.integers(len(colours), size=(count, units))]
    palette = np.clip(palette + rng.normal(0, spread, (count, units, 1)), 0, 255).astype(np.uint8)
    starts = [*np.searchsorted(y, np.arange(count)), rows]
    joint_rows = round(joint_m * canvas.px_per_m)
    for i in range(count):
        position = x + shifts[i]
        course = palette[i, position.astype(int)]
        course[(position % 1.0) < joint_m * canvas.px_per_m / width] = joint
        canvas.image[starts[i] : starts[i + 1]] = course
        canvas.image[starts[i] : starts[i] + joint_rows] = joint


def _off_grid(unit_px: float) -> float:
    """The size nearest to this, texels, whose multiples are spread evenly over the remainders by 2, 4 and 8.

    A renderer shows what is far away by means over 2 x 2, 4 x 4... texels, and a joint by the mean that it falls in.
    With joints every 12 texels all of them fall in the same part of theirs, and the floor as a whole shows beside its
    place: by up to 0.17 px in a picture 640 px wide, where the multiples of the golden section leave 0.05.
    """
    rest = 8.0 * (np.sqrt(5.0) - 1.0) / 2.0
    return 8.0 * max(0.0, np.round((unit_px - rest) / 8.0)) + rest
