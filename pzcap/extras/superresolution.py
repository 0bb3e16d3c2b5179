"""The panorama finer than the frames it is made of.

A pixel is the mean of a square, and squares are too far apart for all the detail that they let through: what is finer
than two pixels comes back as coarser structure that moves as the frame's pixels do, and not as the hall does. It puts
an aligned frame a thousandth of a pixel beside itself, several times what noise does. A mean of frames does not know of
it. But twenty frames of a sweep have twenty places for their pixels: together they tell what the hall is like within
pixels (Tsai and Huang, 1984). So the panorama is made of cells, ``ACROSS`` to a pixel and ``DOWN``, whose means over
the squares of all frames' pixels are what these show, by least squares. What twenty places leave open is decided as in
total variation (Rudin, Osher and Fatemi, 1992): halls are flat between sharp edges. Any frame, of whatever zoom, is
then predicted pixel by pixel, coarse structure included (`pzcap.localisation.photometric_alignment`).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.stitching import agreement
from pzcap.extras.superresolved_alignment import half_extents
from pzcap.geometry.cylinder import smooth_map, to_unwrapped
from pzcap.imaging.bspline import STEPS, Stored, smoothed
from pzcap.localisation.panorama_sampler import ViewPlace, axis_directions
from pzcap.localisation.tuning import ALIGNMENT
from pzcap.types import Array, Mask, Panorama, PanZoomCamera

ACROSS, DOWN = 7, 5  # cells to a pixel: uprights stand between pixels alike in all rows, and need more of them
ROUNDS, ITERATIONS = 3, 10  # of weighing what neighbours differ by anew; of conjugate gradients in each
FLAT = 0.02  # weight of the squared difference of neighbours, to that of a pixel,
EDGE = 2.0  # grey levels: less of a difference that is more
COARSE = 4.0  # variance, square pixels: what is left of a difference when it is smoothed by so much shows somebody
UNSEEN = 1e-4  # pixels' worth of a cell that no frame shows: it stays what it was
WIDE, HIGH = ACROSS + 1, DOWN + 1  # cells that a pixel covers, at most
BLOCK_PX, AROUND_PX = 700, 10  # columns of the panorama that are solved for at a time, and with them so many more

Fine = NDArray[np.float32]
"""(H * DOWN, W * ACROSS) grey levels of cells."""
Levels = Callable[[int], NDArray[np.float32]]
"""(H, W) grey frame k of the sweep, all of them made as bright as the panorama."""
_Pixels = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
"""Of a frame, those inside a block: columns and rows (N,) among its cells, the first of which spans 0 to 1; half of
what each covers, across and down (N, 2); weights (N,)."""


def super_resolve(
    panorama: Panorama, camera: PanZoomCamera, level: Levels, report: Callable[[int, int], None]
) -> Stored:
    """`Panorama.fine` of a panorama, (H * DOWN, W * ACROSS), from the frames of the sweep at its ``sweep_pan_rad``.

    What shows somebody counts little. ``report(done, total)`` hears of the blocks.
    """
    height, width = panorama.image.shape[:2]
    fine = np.empty((height * DOWN, width * ACROSS), np.uint16)
    edges = np.linspace(0, width, max(1, round(width / BLOCK_PX)) + 1).astype(int)
    for number, (left, right) in enumerate(pairwise(edges.tolist())):
        block = _Block(panorama, camera, level, left - AROUND_PX, right + AROUND_PX).solved()
        around = AROUND_PX * ACROSS
        fine[:, left * ACROSS : right * ACROSS] = np.clip(np.rint(block[:, around:-around] * STEPS), 0, 65535)
        report(number + 1, len(edges) - 1)
    return fine


class _Block:
    """The cells of some columns of the panorama, ``left`` to ``right``, and the frames that show them."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, level: Levels, left: int, right: int) -> None:
        self._panorama, self._camera, self._left = panorama, camera, left
        lens = camera.lens
        u, v = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
        half = half_extents(camera, np.stack([u.ravel(), v.ravel()], axis=1), lens.reference_focal_px)
        self._half = (half * panorama.px_per_rad * np.array([ACROSS, DOWN])).astype(np.float32)
        part = np.asarray(_columns(panorama, panorama.image, left, right), np.uint8)
        self._grey = cv2.cvtColor(part, cv2.COLOR_BGR2GRAY).astype(np.float32)
        size = (self._grey.shape[1] * ACROSS, self._grey.shape[0] * DOWN)
        self._start = np.asarray(cv2.resize(self._grey, size, interpolation=cv2.INTER_CUBIC), np.float32)
        self._count, self._told = np.full_like(self._start, UNSEEN), UNSEEN * self._start
        self._shown: list[_Pixels] = []  # of each frame that shows the block
        for k, pan_rad in enumerate(panorama.sweep_pan_rad.tolist()):
            for turned_rad in (pan_rad - 2 * np.pi, pan_rad, pan_rad + 2 * np.pi) if panorama.full_turn else (pan_rad,):
                if self._shows(turned_rad):
                    shown = level(k)
                    columns, rows = self._placed(turned_rad)
                    trust = self._trust(shown, columns, rows)
                    inside = trust * _inside(columns, rows, self._half, self._start.shape) > 0.0
                    pixels = columns[inside], rows[inside], self._half[inside], trust[inside]
                    _spread(self._count, *pixels)
                    _spread(self._told, *pixels[:3], pixels[3] * shown.ravel()[inside])
                    self._shown.append(pixels)

    def solved(self) -> Fine:
        """The cells, by conjugate gradients (Hestenes and Stiefel, 1952) under weights that are found again in each
        round."""
        fine = self._start
        for _ in range(ROUNDS):
            across, down = (_ties(np.diff(fine, axis=axis)) for axis in (1, 0))
            ties: Fine = np.zeros_like(fine)
            ties[:, 1:] += across
            ties[:, :-1] += across
            ties[1:] += down
            ties[:-1] += down
            scaled = 1.0 / (self._count * np.float32(2.0 / (ACROSS * DOWN)) + ties)
            rest = self._told - self._applied(fine, across, down)
            along: Fine = rest * scaled
            worth = float(np.vdot(rest, along))
            for _ in range(ITERATIONS):
                applied = self._applied(along, across, down)
                length = np.float32(worth / float(np.vdot(along, applied)))
                fine = fine + length * along
                rest -= length * applied
                better = rest * scaled
                before, worth = worth, float(np.vdot(rest, better))
                along = better + np.float32(worth / before) * along
        return fine

    def _applied(self, fine: Fine, across: Fine, down: Fine) -> Fine:
        """The normal matrix of the cells, times ``fine``; ``across`` and ``down`` weigh what neighbours differ by."""
        out = np.asarray(UNSEEN * fine, np.float32)
        beside, below = across * np.diff(fine, axis=1), down * np.diff(fine, axis=0)
        out[:, 1:] += beside
        out[:, :-1] -= beside
        out[1:] += below
        out[:-1] -= below
        for pixels in self._shown:
            _gather_and_spread(fine, *pixels, out)
        return out

    def _shows(self, pan_rad: float) -> bool:
        lens, panorama = self._camera.lens, self._panorama
        reach = np.arctan(lens.width / lens.reference_focal_px) * panorama.px_per_rad  # twice that of a frame
        middle = panorama.origin_px[0] - pan_rad * panorama.px_per_rad - self._left
        return bool(-reach < middle < self._grey.shape[1] + reach)

    def _placed(self, pan_rad: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Columns and rows (N,) among the block's cells, the first of which spans 0 to 1, of a frame's pixels."""
        lens, tilt_rad = self._camera.lens, self._camera.tilt_rad

        def to_block(points_px: Array) -> Array:
            at = ViewPlace(pan_rad, tilt_rad, lens.reference_focal_px)
            looks = axis_directions(self._panorama, self._camera, points_px.reshape(-1, 2), at)
            places = to_unwrapped(self._panorama, pan_rad + looks[:, 0], looks[:, 1]).reshape(points_px.shape)
            return (places - np.array([self._left, 0.0]) + 0.5) * np.array([ACROSS, DOWN])

        columns, rows = smooth_map(to_block, lens.width, lens.height)
        return columns.ravel(), rows.ravel()

    def _trust(
        self, level: NDArray[np.float32], columns: NDArray[np.float32], rows: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """(N,) weights of a frame's pixels by what they differ from the panorama around them; 0 at the frame's edge."""
        column, row = ((columns / ACROSS - 0.5).reshape(level.shape), (rows / DOWN - 0.5).reshape(level.shape))
        there = cv2.remap(self._grey, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        # what is finer than pixels differs from frame to frame, and is no somebody
        trust = agreement(smoothed(level - there, COARSE))
        inside = np.zeros_like(trust)
        edge = ALIGNMENT.border_px
        inside[edge:-edge, edge:-edge] = 1.0
        return np.asarray(trust * inside, np.float32).ravel()


def _ties(differences: Fine) -> Fine:
    """Weights of differences between neighbours."""
    return np.asarray(FLAT / np.hypot(1.0, differences / EDGE), np.float32)


def _inside(
    columns: NDArray[np.float32], rows: NDArray[np.float32], half: NDArray[np.float32], shape: tuple[int, ...]
) -> Mask:
    """(N,) whether all cells that a pixel may cover are there."""
    left, top = columns - half[:, 0], rows - half[:, 1]
    return np.asarray((left >= 0) & (left + WIDE < shape[1]) & (top >= 0) & (top + HIGH < shape[0]), np.bool_)


def _columns(panorama: Panorama, image: NDArray[np.generic], left: int, right: int) -> NDArray[np.generic]:
    """Columns of an image of the panorama, beyond its ends those that follow."""
    mode = "wrap" if panorama.full_turn else "clip"
    return image.take(range(left, right), axis=1, mode=mode)  # type: ignore[call-overload]


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _shares(middle: np.float32, half: np.float32, shares: Fine) -> int:
    """The first cell of a row that a pixel covers; and the shares of this and the next in it."""
    one, none = np.float32(1.0), np.float32(0.0)
    left, right = middle - half, middle + half
    first = int(left)
    by_width = one / (right - left)
    for m in range(len(shares)):
        cell = np.float32(first + m)
        shares[m] = max(min(right, cell + one) - max(left, cell), none) * by_width
    return first


@njit(cache=True, nogil=True, fastmath=True)
def _spread(
    out: Fine, columns: NDArray[np.float32], rows: NDArray[np.float32], half: NDArray[np.float32],
    values: NDArray[np.float32],
) -> None:  # fmt: skip
    """Add each value to the cells that its pixel covers, by their share in it."""
    across, down = np.empty(WIDE, np.float32), np.empty(HIGH, np.float32)
    for n in range(len(columns)):
        i, j = _shares(rows[n], half[n, 1], down), _shares(columns[n], half[n, 0], across)
        for k in range(HIGH):
            value = values[n] * down[k]
            for m in range(WIDE):
                out[i + k, j + m] += value * across[m]


@njit(cache=True, nogil=True, fastmath=True)
def _gather_and_spread(
    fine: Fine, columns: NDArray[np.float32], rows: NDArray[np.float32], half: NDArray[np.float32],
    weight: NDArray[np.float32], out: Fine,
) -> None:  # fmt: skip
    """`_spread` of the mean over each pixel, times a weight."""
    across, down = np.empty(WIDE, np.float32), np.empty(HIGH, np.float32)
    for n in range(len(columns)):
        i, j = _shares(rows[n], half[n, 1], down), _shares(columns[n], half[n, 0], across)
        mean = np.float32(0.0)
        for k in range(HIGH):
            row = np.float32(0.0)
            for m in range(WIDE):
                row += across[m] * fine[i + k, j + m]
            mean += down[k] * row
        mean *= weight[n]
        for k in range(HIGH):
            value = mean * down[k]
            for m in range(WIDE):
                out[i + k, j + m] += value * across[m]
