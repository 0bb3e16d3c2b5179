"""The panorama finer than the frames it is made of.

A pixel is the mean of a square, and squares are too far apart for all the detail that they let through: what is finer
than two pixels comes back as coarser structure that moves as the frame's pixels do, and not as the hall does. It puts
an aligned frame a thousandth of a pixel beside itself, several times what noise does. A mean of frames does not know of
it. But twenty frames of a sweep have twenty places for their pixels: they tell what *any* pixel would show, wherever
its middle lay (Tsai and Huang, 1984). So the panorama is a spline with ``fineness`` nodes to a pixel, through all
pixels of all frames where these are, by least squares; what they leave open is smooth. A frame at the sweep's zoom is
then predicted pixel by pixel, coarse structure included (`pzcap.cameras.align`).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.cameras.align import BORDER
from pzcap.cameras.cylinder import smooth_map, to_unwrapped
from pzcap.cameras.panorama import agreement
from pzcap.cameras.rays import looking
from pzcap.cameras.sampling import STEPS, Stored, smoothed, spline
from pzcap.types import Array, Panorama, PanZoomCamera

ITERATIONS = 14  # of conjugate gradients
SMOOTH = 3.7e-4  # squared noise over the squared second differences of what pixels show, as believed
COARSE = 4.0  # variance, square pixels: what is left of a difference when it is smoothed by so much shows somebody
UNSEEN = 1e-4  # pixels' worth of a node that no frame shows: it stays what it was
BLOCK_PX, AROUND_PX = 700, 10  # columns of the panorama that are solved for at a time, and with them so many more

Fine = NDArray[np.float32]
"""(H * fineness, W * fineness) coefficients of a spline."""


def super_resolve(
    panorama: Panorama,
    camera: PanZoomCamera,
    level: Callable[[int], NDArray[np.float32]],
    fineness: int,
    report: Callable[[int, int], None],
) -> Stored:
    """`Panorama.fine` of a panorama, (H * fineness, W * fineness), from the frames that it was stitched of.

    ``level(k)`` (H, W) is grey frame k of the sweep, all of them made as bright as the panorama and even in sharpness.
    What shows somebody counts little. ``report(done, total)`` hears of the blocks.
    """
    height, width = panorama.image.shape[:2]
    fine = np.empty((height * fineness, width * fineness), np.uint16)
    edges = np.linspace(0, width, max(1, round(width / BLOCK_PX)) + 1).astype(int)
    for number, (left, right) in enumerate(pairwise(edges.tolist())):
        block = _Block(panorama, camera, level, fineness, left - AROUND_PX, right + AROUND_PX).solved()
        around = AROUND_PX * fineness
        stored = np.clip(np.rint(block[:, around:-around] * STEPS), 0, 65535)
        fine[:, left * fineness : right * fineness] = stored
        report(number + 1, len(edges) - 1)
    return fine


class _Block:
    """The spline of some columns of the panorama, ``left`` to ``right``, and the frames that show them."""

    def __init__(
        self,
        panorama: Panorama,
        camera: PanZoomCamera,
        level: Callable[[int], NDArray[np.float32]],
        fineness: int,
        left: int,
        right: int,
    ) -> None:
        self._panorama, self._camera = panorama, camera
        self._fineness, self._left = fineness, left
        mode = "wrap" if panorama.full_turn else "clip"
        part = panorama.image.take(range(left, right), axis=1, mode=mode)  # type: ignore[call-overload]
        self._grey = cv2.cvtColor(part, cv2.COLOR_BGR2GRAY).astype(np.float32)
        self._smooth = np.float32(SMOOTH * fineness**4)
        size = ((right - left) * fineness, part.shape[0] * fineness)
        self._start: Fine = np.asarray(cv2.resize(self._grey, size, interpolation=cv2.INTER_CUBIC), np.float32)
        self._count, self._told = np.full_like(self._start, UNSEEN), UNSEEN * self._start
        self._frames: list[tuple[float, NDArray[np.float32]]] = []  # pan of each that shows the block; its weights
        for k, pan_rad in enumerate(panorama.sweep_pan_rad.tolist()):
            for turned_rad in (pan_rad - 2 * np.pi, pan_rad, pan_rad + 2 * np.pi) if panorama.full_turn else (pan_rad,):
                if self._shows(turned_rad):
                    shown = level(k)
                    columns, rows = self._placed(turned_rad)
                    trust = self._trust(shown, columns, rows)
                    _scatter(self._count, columns, rows, trust)
                    _scatter(self._told, columns, rows, trust * shown.ravel())
                    self._frames.append((turned_rad, trust))

    def solved(self) -> Fine:
        """The spline, by conjugate gradients (Hestenes and Stiefel, 1952)."""
        fine = self._start
        rest = self._told - self._applied(fine)
        scaled = 1.0 / (self._count + 20.0 * self._smooth)  # the diagonal of the squared Laplacian
        along = rest * scaled
        worth = float(np.vdot(rest, along))
        for _ in range(ITERATIONS):
            applied = self._applied(along)
            length = np.float32(worth / float(np.vdot(along, applied)))
            fine += length * along
            rest -= length * applied
            better = rest * scaled
            before, worth = worth, float(np.vdot(rest, better))
            along = better + np.float32(worth / before) * along
        return fine

    def _applied(self, fine: Fine) -> Fine:
        """The normal matrix of the spline, times ``fine``."""
        out = np.asarray(UNSEEN * fine + self._smooth * _laplacian(_laplacian(fine)), np.float32)
        for pan_rad, trust in self._frames:
            _gather_and_scatter(fine, *self._placed(pan_rad), trust, out)
        return out

    def _shows(self, pan_rad: float) -> bool:
        lens, panorama = self._camera.lens, self._panorama
        reach = np.arctan(lens.width / lens.reference_focal_px) * panorama.px_per_rad  # twice that of a frame
        middle = panorama.origin_px[0] - pan_rad * panorama.px_per_rad - self._left
        return bool(-reach < middle < self._grey.shape[1] + reach)

    def _placed(self, pan_rad: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Columns and rows (N,) of the block's spline where the pixels of a frame lie."""
        lens, tilt_rad = self._camera.lens, self._camera.tilt_rad

        def to_block(points_px: Array) -> Array:
            looks = looking(
                self._panorama, self._camera, points_px.reshape(-1, 2), pan_rad, tilt_rad, lens.reference_focal_px
            )
            places = to_unwrapped(self._panorama, pan_rad + looks[:, 0], looks[:, 1]).reshape(points_px.shape)
            return (places - np.array([self._left, 0.0]) + 0.5) * self._fineness - 0.5

        columns, rows = smooth_map(to_block, lens.width, lens.height)
        return columns.ravel(), rows.ravel()

    def _trust(
        self, level: NDArray[np.float32], columns: NDArray[np.float32], rows: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """(N,) weights of a frame's pixels by what they differ from the panorama around them; 0 at the frame's edge."""
        column, row = (((one + 0.5) / self._fineness - 0.5).reshape(level.shape) for one in (columns, rows))
        there = cv2.remap(self._grey, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        # what is finer than pixels differs from frame to frame, and is no somebody
        trust = agreement(smoothed(level - there, COARSE))
        inside = np.zeros_like(trust)
        inside[BORDER:-BORDER, BORDER:-BORDER] = 1.0
        return np.asarray(trust * inside, np.float32).ravel()


def _laplacian(fine: Fine) -> Fine:
    return np.asarray(cv2.Laplacian(fine, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE), np.float32)


@njit(cache=True, nogil=True, inline="always")
def _corner(column: float, row: float, shape: tuple[int, int]) -> tuple[bool, int, int, float, float]:
    """Whether all sixteen nodes around a place are there; row and column of the first, and what it lies beyond the
    second."""
    i, j = int(np.floor(row)), int(np.floor(column))
    return 1 <= i < shape[0] - 2 and 1 <= j < shape[1] - 2, i - 1, j - 1, row - i, column - j


@njit(cache=True, nogil=True)
def _scatter(out: Fine, columns: NDArray[np.float32], rows: NDArray[np.float32], values: NDArray[np.float32]) -> None:
    """Add each value to the nodes around its place, by their share in it."""
    for n in range(len(columns)):
        inside, i, j, beyond_row, beyond_column = _corner(columns[n], rows[n], out.shape)
        if not inside or values[n] == 0.0:
            continue
        across, down = spline(beyond_column)[0], spline(beyond_row)[0]
        for k in range(4):
            for m in range(4):
                out[i + k, j + m] += down[k] * across[m] * values[n]


@njit(cache=True, nogil=True)
def _gather_and_scatter(
    fine: Fine, columns: NDArray[np.float32], rows: NDArray[np.float32], weight: NDArray[np.float32], out: Fine
) -> None:
    """`_scatter` of what the spline has at each place, times a weight."""
    for n in range(len(columns)):
        inside, i, j, beyond_row, beyond_column = _corner(columns[n], rows[n], fine.shape)
        if not inside or weight[n] == 0.0:
            continue
        across, down = spline(beyond_column)[0], spline(beyond_row)[0]
        value = 0.0
        for k in range(4):
            for m in range(4):
                value += down[k] * across[m] * fine[i + k, j + m]
        value *= weight[n]
        for k in range(4):
            for m in range(4):
                out[i + k, j + m] += down[k] * across[m] * value
