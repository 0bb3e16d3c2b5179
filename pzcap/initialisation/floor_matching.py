"""Heads placed by the floor that their sweeps have in common.

A plane is the one surface whose look from elsewhere follows from the cameras alone. Each panorama is rectified to the
floor (inverse perspective mapping); square patches of it, as the camera that sees them finest has them, are sought in
the others by normalised cross-correlation; and where one is found, the rays to it meet on the floor:

    d = R' (X - t) / |X - t|        X the patch in its own camera, the patch and its displacement in the others

By these rays `camera_poses.adjust` places the heads, as it does by those of keypoints, and the patches are sought
anew, nearer and finer. Keypoints are off by centimetres, and alike in frames that are alike; a patch is off by a
fraction of a pixel, and each by itself. Where all lean alike no ray tells; the floor, which is level, does.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.geometry.cylinder import to_panorama
from pzcap.initialisation.camera_poses import HeadRays, Heads, adjust
from pzcap.initialisation.tuning import FLOOR
from pzcap.scoring.body_errors import similarity_of
from pzcap.solver.robust import geman_mcclure, normal_sigma
from pzcap.types import Array, Image, Mask, Panorama


class FloorView(NamedTuple):
    """A panorama rectified to a square of the floor, rows from far to near along y."""

    image: Image  # (N, N) grey
    valid: Mask  # (N, N)
    cell_m: float
    px_m: Array  # (N, N) metres of floor that one pixel of the panorama covers, along the ray

    def point(self, row: float, column: float) -> Array:
        """(3,) of the floor."""
        middle = (len(self.image) - 1) / 2.0
        return np.array([(column - middle) * self.cell_m, (middle - row) * self.cell_m, 0.0])


def place_by_floor(panoramas: Sequence[Panorama | None], heads: Heads) -> Heads | None:
    """Place ``heads`` finely that stand roughly right, in metres, z = 0 about the floor and the origin amid what is
    done: their lengths as they were, the floor level at height 0. None where the floor does not tell, for want of
    texture or of floor in common, or where it contradicts them."""
    found = heads
    for cell_m, search_m in zip(FLOOR.cells_m, FLOOR.search_m, strict=True):
        rays = match_floor(panoramas, found, cell_m, search_m)
        matched = (rays.confidence > 0.0).sum(axis=1)
        if np.any(matched[found.placed] < FLOOR.fewest):
            return None
        adjusted = adjust(rays, found.rotation, found.place, found.placed)
        if not adjusted.seen.any():
            return None
        found = levelled(adjusted)
    agree = found.sigma_rad < FLOOR.largest_sigma_rad and found.seen.mean() > FLOOR.least_agreement
    return found if agree and _near(found, heads) else None


def match_floor(panoramas: Sequence[Panorama | None], heads: Heads, cell_m: float, search_m: float) -> HeadRays:
    """Rays to the patches of the floor that two cameras or more have in common, sought as far as ``search_m`` from
    where the ``heads`` have them, in pictures with a pixel every ``cell_m``."""
    views = [
        rectified(panorama, heads.rotation[c], heads.place[c], cell_m) if panorama and heads.placed[c] else None
        for c, panorama in enumerate(panoramas)
    ]
    size = _pixels(2.0 * FLOOR.reach_m, cell_m) + 1
    half, margin = _pixels(0.5 * FLOOR.patch_m, cell_m), _pixels(search_m, cell_m)
    grid = range(half + margin, size - half - margin, _pixels(FLOOR.step_m, cell_m))
    found = [_matched(views, row, column, half, margin) for row, column in product(grid, grid)]
    common = [points for points in found if len(points) > 1]
    places, confidence = np.zeros((len(views), len(common), 3)), np.zeros((len(views), len(common)))
    for n, points in enumerate(common):
        for c, point in points.items():
            places[c, n], confidence[c, n] = point, 1.0
    directions = np.einsum("cji,cnj->cni", heads.rotation, places - heads.place[:, None])
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return HeadRays(np.zeros_like(directions), directions, confidence, FLOOR.doubt, on_floor=True)


def _pixels(length_m: float, cell_m: float) -> int:
    return round(length_m / cell_m)


def _matched(views: Sequence[FloorView | None], row: int, column: int, half: int, margin: int) -> dict[int, Array]:
    """Points (3,) of the floor at which cameras see the patch about a pixel; none if it is bare, or seen by one."""
    around = half + margin
    window = np.s_[row - around : row + around + 1, column - around : column + around + 1]
    seeing = {c: view for c, view in enumerate(views) if view is not None and view.valid[window].all()}
    if len(seeing) < 2:
        return {}
    finest = min(seeing, key=lambda c: float(seeing[c].px_m[row, column]))
    patch = seeing[finest].image[row - half : row + half + 1, column - half : column + half + 1]
    if patch.std() < FLOOR.least_contrast:
        return {}
    lobe = _pixels(FLOOR.lobe_m, seeing[finest].cell_m)
    shifts = {c: displacement(patch, view.image[window], lobe) for c, view in seeing.items() if c != finest}
    found = {c: seeing[c].point(row + by[0], column + by[1]) for c, by in shifts.items() if by is not None}
    return found | {finest: seeing[finest].point(row, column)}


def rectified(panorama: Panorama, rotation: Array, place_m: Array, cell_m: float) -> FloorView:
    """The floor about the origin as the ``panorama`` of a head there shows it."""
    along = np.arange(_pixels(2.0 * FLOOR.reach_m, cell_m) + 1) * cell_m - FLOOR.reach_m
    x, y = np.meshgrid(along, along[::-1])
    way = np.stack([x, y, np.zeros_like(x)], axis=-1) - place_m
    local = way @ rotation
    out = np.hypot(local[..., 0], local[..., 1])
    at_px = to_panorama(panorama, np.arctan2(local[..., 1], local[..., 0]), local[..., 2] / out).astype(np.float32)
    pictures = cv2.cvtColor(panorama.image, cv2.COLOR_BGR2GRAY), panorama.valid.astype(np.uint8)
    if panorama.full_turn:  # the last column's neighbour is the first
        pictures = np.hstack([pictures[0], pictures[0][:, :1]]), np.hstack([pictures[1], pictures[1][:, :1]])
    columns, rows = at_px[..., 0], at_px[..., 1]
    grey, known = (cv2.remap(each, columns, rows, cv2.INTER_LINEAR) for each in pictures)
    distance = np.linalg.norm(way, axis=-1)
    px_m = distance**2 / (max(abs(place_m[2]), FLOOR.lowest_m) * panorama.px_per_rad)
    return FloorView(np.asarray(grey, np.uint8), np.asarray(known > 0), cell_m, px_m)


def displacement(patch: Image, window: Image, lobe: int) -> Array | None:
    """Rows and columns (2,) by which the ``patch`` lies off the middle of the ``window``, to a fraction of a pixel.
    None where it is not found, or at the rim, or nearly as well elsewhere, beyond the ``lobe`` of its peak."""
    score = np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED), np.float64)
    _, best, _, (column, row) = cv2.minMaxLoc(score)
    last = len(score) - 1
    if best < FLOOR.least_correlation or not (0 < row < last and 0 < column < last):
        return None
    elsewhere = score.copy()
    elsewhere[max(row - lobe, 0) : row + lobe + 1, max(column - lobe, 0) : column + lobe + 1] = -1.0
    if elsewhere.max() > best - FLOOR.least_lead:
        return None
    middle = last / 2.0
    down, across = _vertex(score[row - 1 : row + 2, column]), _vertex(score[row, column - 1 : column + 2])
    return np.array([row + down - middle, column + across - middle])


def _vertex(values: Array) -> float:
    """Vertex of the parabola through three values about a peak, from the middle one."""
    before, peak, after = (float(value) for value in values)
    return 0.5 * (before - after) / min(before + after - 2.0 * peak, -1e-6)


def levelled(heads: Heads) -> Heads:
    """The heads with the plane through the points that they have seen level, at height 0."""
    points = heads.points[heads.seen]
    weight = np.ones(len(points))
    for _ in range(FLOOR.steps):
        middle = np.average(points, axis=0, weights=weight)
        off = points - middle
        _, axes = np.linalg.eigh((weight[:, None] * off).T @ off)
        up = axes[:, 0] * np.sign(axes[2, 0])
        height = off @ up
        weight = geman_mcclure(height, FLOOR.tight * max(normal_sigma(height), FLOOR.flat_m))
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0].as_matrix()
    return heads.moved(turn, 1.0, middle - turn @ middle - [0.0, 0.0, middle[2]])


def _near(found: Heads, before: Heads) -> bool:
    """True where the heads stand as they stood before, but for what was claimed of these and a similarity: a floor
    whose pattern repeats fits elsewhere, too."""
    placed = np.flatnonzero(before.placed)
    if len(placed) < 3:
        return True
    similarity = similarity_of(found.place[placed], before.place[placed])
    if similarity is None:
        return False
    off_m = np.linalg.norm(similarity.apply(found.place[placed]) - before.place[placed], axis=1)
    variance = np.diag(before.covariance).reshape(-1, 6)[placed, 3:].sum(axis=1)
    return bool(np.all(off_m < FLOOR.apart * np.sqrt(variance)))
