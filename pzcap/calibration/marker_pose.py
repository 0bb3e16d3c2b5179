"""The camera's pose from the grey values of the printed markers.

The print on the calibration object is known exactly, so that every pixel of a marker, and not its four corners alone,
tells of the pose, whose six parameters are fitted by Gauss-Newton steps. Light and sharpness are nuisance parameters.
Each marker has linear shadings of its own for paper and ink, which are solved for wherever the pose is (variable
projection; Golub and Pereyra, 1973), and two widths of blur, across its upright and across its level edges, which the
Schur complement eliminates. What covers or outshines a part of a marker loses its weight (Tukey's biweight).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from pzcap.calibration.tuning import MARKERS
from pzcap.geometry import lens
from pzcap.geometry.camera import project
from pzcap.solver.robust import normal_sigma
from pzcap.types import Array, CalibrationObject, Camera, Image, Marker


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """Result of `fit_pose`."""

    camera: Camera
    covariance: Array  # (6, 6) of the step of `moved`


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Pixels that show one marker, and its print."""

    ink: Array  # (n, n) 1 where a cell is black, 0 where it is white; row, column
    axes_m: Array  # (3, 3) world, columns: one cell to the right, one cell down, the top left corner
    rays: Array  # (P, 3) camera, z = 1
    ray_by_px: Array  # (P, 2, 2) derivative of a ray's x and y with respect to column and row
    place: Array  # (P, 3) 1, column and row about the patch's middle
    grey: Array  # (P,)


def moved(camera: Camera, step: Array) -> Camera:
    """Move ``camera`` as if the world turned by rotation vector ``step[:3]``, then shifted by ``step[3:]``."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    cam_R_world = turn @ camera.world_T_cam[:3, :3].T
    translation = step[3:] - cam_R_world @ camera.world_T_cam[:3, 3]
    world_T_cam = np.eye(4)
    world_T_cam[:3] = np.column_stack([cam_R_world.T, -cam_R_world.T @ translation])
    return replace(camera, world_T_cam=world_T_cam)


def fit_pose(camera: Camera, image: Image, calibration_object: CalibrationObject, ids: Sequence[int]) -> PoseFit | None:
    """Fit the pose of ``camera`` to the markers ``ids`` as ``image`` (H, W[, 3]) shows them; its lens is held.

    The start has to be right to about half a cell. None where the fit does not converge.
    """
    patches = cut(camera, image, calibration_object, ids)
    blur = np.full((len(patches), 2), MARKERS.blur_px2)
    weights = [np.ones(len(patch.grey)) for patch in patches]
    for number in range(MARKERS.steps):
        parts = [linearise(camera, *part) for part in zip(patches, blur, weights, strict=True)]
        sigmas = _sigmas([part[0] for part in parts], [part[2] for part in parts])
        kept, normal, gradient = [], np.zeros((6, 6)), np.zeros(6)
        for k, (residual, jacobian, _) in enumerate(parts):
            if number < MARKERS.weighed_steps:
                weights[k] = _weigh(residual / sigmas[k], tight=number >= MARKERS.loose_steps) / np.square(sigmas[k])
            whole = jacobian.T @ (weights[k][:, None] * jacobian)
            right = jacobian.T @ (weights[k] * residual)
            whole[[6, 7], [6, 7]] += MARKERS.blur_sigma_px2**-2
            right[6:8] += MARKERS.blur_sigma_px2**-2 * (blur[k] - MARKERS.blur_px2)
            share = np.linalg.solve(whole[6:, 6:], whole[6:, :6])
            normal += whole[:6, :6] - whole[:6, 6:] @ share
            gradient += right[:6] - share.T @ right[6:]
            kept.append((whole, right))
        step = np.asarray(-np.linalg.solve(normal, gradient), np.float64)
        for k, (whole, right) in enumerate(kept):
            change = -np.linalg.solve(whole[6:, 6:], right[6:] + whole[6:, :6] @ step)[:2]
            blur[k] = np.clip(blur[k] + change, MARKERS.least_blur_px2, MARKERS.most_blur_px2)
        camera = moved(camera, step)
        if number > MARKERS.loose_steps and step @ normal @ step < MARKERS.settled**2:
            return PoseFit(camera, np.asarray(np.linalg.inv(normal), np.float64))
    return None


def _sigmas(residuals: list[Array], slopes: list[Array]) -> list[Array]:
    """Robust standard deviation of each pixel's residual: noise, and in proportion to the slope what the model misses,
    as if edges lay a fraction of a pixel off."""
    residual, slope = np.abs(np.concatenate(residuals)), np.concatenate(slopes)
    steep = slope > 0.25 * slope.max()
    noise = max(normal_sigma(residual[~steep]), MARKERS.least_noise)
    excess = normal_sigma(residual[steep]) ** 2 - noise**2
    off_px = math.sqrt(max(excess, 0.0) / float(np.median(np.square(slope[steep]))))
    return [np.hypot(noise, off_px * each) for each in slopes]


def cut(camera: Camera, image: Image, calibration_object: CalibrationObject, ids: Sequence[int]) -> list[Patch]:
    """Cut out a patch for each of the markers ``ids``, where ``camera`` sees it in ``image`` (H, W[, 3])."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, calibration_object.dictionary))
    cells = dictionary.markerSize + 2
    patches = []
    for marker in calibration_object.markers:
        if marker.id not in ids:
            continue
        axes_m = _axes(marker, cells)
        edges = -MARKERS.margin_cells, cells + MARKERS.margin_cells
        corners = np.array([(a, b, 1.0) for a in edges for b in edges])
        around = project(camera, corners @ axes_m.T)[0]
        low = np.maximum(np.floor(around.min(axis=0)), 0).astype(int)
        high = np.minimum(np.ceil(around.max(axis=0)) + 1, [camera.width, camera.height]).astype(int)
        v, u = (g.ravel() for g in np.mgrid[low[1] : high[1], low[0] : high[0]])
        pixels = np.column_stack([u, v]).astype(np.float64)
        rays, ray_by_px = _rays(camera, pixels)
        places, _, _ = _on_print(camera, axes_m, rays)
        seen = image[v, u].reshape(len(pixels), -1)
        # saturated pixels tell nothing of the light
        used = np.all((places > edges[0]) & (places < edges[1]), axis=1) & (seen.max(axis=1) < 255)
        ink = (cv2.aruco.generateImageMarker(dictionary, marker.id, cells) == 0).astype(np.float64)
        place = np.column_stack([np.ones(len(pixels)), (pixels - around.mean(axis=0)) / np.ptp(around, axis=0)])
        # the mean of the colours: their noises differ, and the print is grey
        patches.append(Patch(ink, axes_m, rays[used], ray_by_px[used], place[used], seen[used].mean(axis=1)))
    return patches


def linearise(camera: Camera, patch: Patch, blur_px2: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Predicted minus seen grey values (P,) with the best shadings by ``weight`` (P,), and derivatives (P, 14).

    The columns: the step of `moved` (6), the blurs ``blur_px2`` (2,), the shadings of paper and ink (6).
    Also how steep the prediction is (P,), grey levels a pixel.
    """
    places, by_ray, by_pose = _on_print(camera, patch.axes_m, patch.rays)
    by_px = by_ray @ patch.ray_by_px
    ink = _ink(patch.ink, places, by_px, blur_px2)
    shares = np.column_stack([(1.0 - ink[:, :1]) * patch.place, ink[:, :1] * patch.place])
    root = np.sqrt(weight)
    shading = np.linalg.lstsq(shares * root[:, None], patch.grey * root, rcond=None)[0]
    contrast = patch.place @ (shading[3:] - shading[:3])
    by_step = np.einsum("pi,pij->pj", ink[:, 1:3], by_pose)
    jacobian = np.hstack([contrast[:, None] * by_step, contrast[:, None] * ink[:, 3:], shares])
    slope = np.abs(contrast) * np.linalg.norm(np.einsum("pi,pij->pj", ink[:, 1:3], by_px), axis=1)
    return shares @ shading - patch.grey, jacobian, slope


def _weigh(scaled: Array, *, tight: bool) -> Array:
    if tight:
        return np.square(np.clip(1.0 - np.square(scaled / MARKERS.tukey), 0.0, None))
    return np.minimum(1.0, MARKERS.huber / np.maximum(np.abs(scaled), 1e-9))


def _axes(marker: Marker, cells: int) -> Array:
    """(3, 3) columns: one cell to the right, one down, the top left corner, of the square nearest the corners."""
    a, b, c, d = marker.corners_m
    right, down = ((b - a) + (c - d)) / (2 * cells), ((d - a) + (c - b)) / (2 * cells)
    return np.column_stack([right, down, marker.corners_m.mean(axis=0) - cells / 2 * (right + down)])


def _on_print(camera: Camera, axes_m: Array, rays: Array) -> tuple[Array, Array, Array]:
    """Intersect rays (P, 3) with a print: places (P, 2) in cells to the right and down, and their derivatives,
    (P, 2, 2) by a ray's x and y, (P, 2, 6) by the step of `moved`. With ``H`` the print's axes in the camera's frame a
    ray ``d`` meets it at ``H^-1 d``, up to scale; ``dH = w x H + (0, 0, t)``."""
    rotation, centre = camera.world_T_cam[:3, :3], camera.world_T_cam[:3, 3]
    inverse = np.linalg.inv(rotation.T @ (axes_m - np.column_stack([np.zeros((3, 2)), centre])))
    met = rays @ inverse.T
    places = met[:, :2] / met[:, 2:]
    rows = (inverse[None, :2] - places[:, :, None] * inverse[2]) / met[:, 2, None, None]
    by_pose = np.concatenate([-np.cross(rays[:, None], rows), -met[:, 2, None, None] * rows], axis=2)
    return places, rows[:, :, :2], by_pose


def _rays(camera: Camera, pixels: Array) -> tuple[Array, Array]:
    """Rays (P, 3) of pixels (P, 2), z = 1, and derivatives of their x and y (P, 2, 2) by column and row."""
    xy = lens.undistort((pixels - camera.principal_px) / camera.focal_px, lens.of(camera))
    bend = lens.jacobian(xy, lens.of(camera))
    return np.column_stack([xy, np.ones(len(xy))]), np.asarray(np.linalg.inv(bend) / camera.focal_px, np.float64)


NODES, SHARES = (values / 2 for values in np.polynomial.legendre.leggauss(3))
_ROOT_2, _ROOT_2PI = math.sqrt(2.0), math.sqrt(2.0 * math.pi)
_SURE = 8.3  # standard deviations: beyond them a Gaussian's share is 0 or 1 to the last digit


@njit(cache=True, nogil=True, error_model="numpy")
def _ink(cells: Array, places: Array, by_px: Array, blur_px2: Array) -> Array:
    """The share of ink in each pixel, its derivatives by the place (to the right, down) and by the two blurs: (P, 5).

    A straight edge is exact: blurred by a Gaussian, and averaged over the pixel's square, on which the print is seen
    under a linear map. Where two edges meet they are taken to blur one after the other, which is exact where they stand
    upright and level in the image, and else wrong by the same amount on either side.
    """
    count = len(cells)
    ink = np.zeros((len(places), 5))
    across, down = np.empty((count, 3)), np.empty((count, 3))
    for p in range(len(places)):
        _profile(places[p, 0], by_px[p, 0], blur_px2[0], across)
        _profile(places[p, 1], by_px[p, 1], blur_px2[1], down)
        for j in range(count):
            for i in range(count):
                if cells[j, i] != 0.0:
                    ink[p, 0] += cells[j, i] * down[j, 0] * across[i, 0]
                    ink[p, 1] += cells[j, i] * down[j, 0] * across[i, 1]
                    ink[p, 2] += cells[j, i] * down[j, 1] * across[i, 0]
                    ink[p, 3] += cells[j, i] * down[j, 0] * across[i, 2]
                    ink[p, 4] += cells[j, i] * down[j, 2] * across[i, 0]
    return ink


@njit(cache=True, nogil=True, error_model="numpy")
def _profile(place: float, by_px: Array, blur_px2: float, shares: Array) -> None:
    """The shares of a pixel in each of so many cells in a row, and the derivatives by the place and by the blur, into
    ``shares`` (count, 3)."""
    narrow, wide = min(abs(by_px[0]), abs(by_px[1])), max(abs(by_px[0]), abs(by_px[1]))
    squared = wide * wide + narrow * narrow
    sigma = math.sqrt(blur_px2 * squared)
    shares[:] = 0.0
    for edge in range(len(shares) + 1):
        share, by_place, by_blur = 0.0, 0.0, 0.0  # of what lies beyond the edge
        # the square's longer side is integrated over exactly, the shorter one at a few places
        for node in range(len(NODES)):
            weight = SHARES[node]
            low = (place - edge + NODES[node] * narrow - 0.5 * wide) / sigma
            high = low + wide / sigma
            if low > _SURE:
                share += weight
            elif high > -_SURE:
                low_share, high_share = 0.5 * math.erfc(-low / _ROOT_2), 0.5 * math.erfc(-high / _ROOT_2)
                low_density = math.exp(-0.5 * low * low) / _ROOT_2PI
                high_density = math.exp(-0.5 * high * high) / _ROOT_2PI
                blurred = high * high_share + high_density - low * low_share - low_density
                share += weight * sigma * blurred / wide
                by_place += weight * (high_share - low_share) / wide
                by_blur += weight * (high_density - low_density) * 0.5 * squared / sigma / wide
        for cell, sign in ((edge, 1.0), (edge - 1, -1.0)):
            if 0 <= cell < len(shares):
                shares[cell, 0] += sign * share
                shares[cell, 1] += sign * by_place
                shares[cell, 2] += sign * by_blur
