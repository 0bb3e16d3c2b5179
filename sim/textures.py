"""Surfaces to paint textures on, and the materials of a sports hall: masonry, boards, speckled floor, wear.

Everything here is red-green-blue (MuJoCo's order) and painted in metres, so that a texture's resolution is one number.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.types import Image

Colour = tuple[float, float, float]  # red, green, blue, 0..255
_SHIFT: Final = 4  # fractional bits of OpenCV's drawing coordinates


class Canvas:
    """A flat rectangle painted in metres: x to the right and y up from its lower left corner."""

    def __init__(self, width_m: float, height_m: float, px_per_m: float, colour: Colour) -> None:
        self.width_m, self.height_m, self.px_per_m = width_m, height_m, px_per_m
        shape = (max(8, round(height_m * px_per_m)), max(8, round(width_m * px_per_m)), 3)
        self.image: Image = np.empty(shape, np.uint8)
        self.image[:] = np.array(colour, np.uint8)

    def polygon(self, points_m: Sequence[Sequence[float]] | NDArray[np.float64], colour: Colour) -> None:
        cv2.fillPoly(self.image, [self._fixed(points_m)], colour, cv2.LINE_AA, _SHIFT)

    def rectangle(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        self.polygon([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], colour)

    def frame(self, x: float, y: float, width: float, height: float, thickness: float, colour: Colour) -> None:
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        self.line([*corners, corners[0]], thickness, colour)

    def line(self, points_m: Sequence[Sequence[float]] | NDArray[np.float64], thickness: float, colour: Colour) -> None:
        """A polyline, never thinner than a pixel."""
        width = max(1, round(thickness * self.px_per_m))
        cv2.polylines(self.image, [self._fixed(points_m)], False, colour, width, cv2.LINE_AA, _SHIFT)

    def ellipse(
        self, x: float, y: float, radius_x: float, radius_y: float, colour: Colour, thickness: float = 0.0
    ) -> None:
        """Filled, or with `thickness` > 0 its outline."""
        angles = np.linspace(0.0, 2 * np.pi, 49)
        points = np.stack([x + radius_x * np.cos(angles), y + radius_y * np.sin(angles)], axis=1)
        if thickness > 0:
            self.line(points, thickness, colour)
        else:
            self.polygon(points, colour)

    def text(
        self, x: float, y: float, height: float, string: str, colour: Colour, weight: float = 0.14, width: float = np.inf
    ) -> None:
        """A line of capitals of the given height, its lower left at (x, y); `weight` is the stroke over the height.

        A line longer than `width` is set smaller.
        """
        font = cv2.FONT_HERSHEY_DUPLEX
        (width_1, height_1), _ = cv2.getTextSize(string, font, 1.0, 1)
        scale = min(height / height_1, width / width_1 if string else np.inf) * self.px_per_m
        left, bottom = self._fixed([(x, y)])[0] >> _SHIFT
        thickness = max(1, round(weight * scale * height_1))
        cv2.putText(self.image, string, (int(left), int(bottom)), font, scale, colour, thickness, cv2.LINE_AA)

    def region(self, x: float, y: float, width: float, height: float) -> Image:
        """The pixels of a rectangle, a view to write to; clipped to the canvas."""
        rows, columns = self.image.shape[:2]
        left, right = (int(np.clip(round(v * self.px_per_m), 0, columns)) for v in (x, x + width))
        top, bottom = (int(np.clip(rows - round(v * self.px_per_m), 0, rows)) for v in (y + height, y))
        return self.image[top:bottom, left:right]

    def paste(self, image: Image, x: float, y: float, width: float, height: float) -> None:
        """Set `image` into a rectangle, resampled."""
        target = self.region(x, y, width, height)
        if target.size:
            cv2.resize(image, target.shape[1::-1], dst=target, interpolation=cv2.INTER_AREA)

    def _fixed(self, points_m: Sequence[Sequence[float]] | NDArray[np.float64]) -> NDArray[np.int32]:
        """Metres to OpenCV's fixed-point coordinates, whose integers are pixel centres."""
        points = np.asarray(points_m, np.float64) * self.px_per_m
        points[:, 1] = self.image.shape[0] - points[:, 1]
        return np.round((points - 0.5) * (1 << _SHIFT)).astype(np.int32)


def grain(
    shape: tuple[int, int],
    rng: np.random.Generator,
    amplitude: float,
    *,
    persistence: float = 0.75,
    octaves: int = 11,
    stretch: tuple[int, int] = (1, 1),
) -> NDArray[np.int16]:
    """Noise with structure at every scale, (H, W), zero mean, finest octave of uniform `amplitude` grey levels.

    Each coarser octave is 1 / `persistence` stronger; `stretch` draws the grain out (rows, columns), as in wood.
    """
    rows, columns = -(-shape[0] // stretch[0]), -(-shape[1] // stretch[1])
    sizes = [(-(-rows // 2**k), -(-columns // 2**k)) for k in range(octaves)]
    sizes = [size for size in sizes if min(size) >= 2] or sizes[:1]
    field = np.zeros((1, 1), np.int16)
    for k in reversed(range(len(sizes))):
        size = sizes[k]
        field = cv2.resize(field, size[::-1], interpolation=cv2.INTER_LINEAR).reshape(size)
        strength = amplitude / persistence**k
        octave = np.frombuffer(rng.bytes(size[0] * size[1]), np.uint8).reshape(size)
        table = np.round((np.arange(256) - 127.5) * (strength / 127.5)).astype(np.int16)
        field = field + table[octave]
    if stretch != (1, 1):
        field = cv2.resize(field, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(field[: shape[0], : shape[1]])


def weather(image: Image, field: NDArray[np.int16]) -> None:
    """Lighten and darken an image by a field of grey levels, in place, saturating."""
    cv2.add(image, cv2.merge([field, field, field]), dst=image, dtype=cv2.CV_8U)


def courses(
    image: Image,
    px_per_m: float,
    rng: np.random.Generator,
    colours: Sequence[Colour],
    *,
    unit_m: tuple[float, float],
    joint_m: float,
    joint: Colour,
    spread: float = 8.0,
) -> None:
    """Fill an image with courses of bricks, boards or panels of (width, height) `unit_m`, in place.

    Each unit takes one of the `colours`, lighter or darker by `spread` grey levels RMS; each course is shifted by a
    random amount, so nothing repeats.
    """
    rows, columns = image.shape[:2]
    y = np.arange(rows) / (px_per_m * unit_m[1])
    course = y.astype(int)
    count = course[-1] + 1
    shifts = rng.uniform(0, 1, count) if count > 1 else np.zeros(1)
    x = np.arange(columns) / (px_per_m * unit_m[0])
    units = int(x[-1]) + 2
    palette = np.asarray(colours, np.float64)[rng.integers(len(colours), size=(count, units))]
    palette = np.clip(palette + rng.normal(0, spread, (count, units, 1)), 0, 255).astype(np.uint8)
    joint_x, joint_y = joint_m / unit_m[0], joint_m / unit_m[1]
    for i in range(count):
        here = np.flatnonzero(course == i)
        position = x + shifts[i]
        line = palette[i, position.astype(int)]
        line[(position % 1.0) < joint_x] = joint
        image[here[0] : here[-1] + 1] = line
        image[here[(y[here] % 1.0) < joint_y]] = joint
