"""The camera's pose from the grey values of the printed markers themselves.

What is printed on the calibration object is known exactly, so the picture of it can be predicted: every pixel of a
marker, not its four corners alone, says where the camera stands. The six pose parameters are fitted by Gauss-Newton on
the grey values. Light and sharpness are unknown and of no interest. Each marker has linear shadings of its own for paper
and ink, which are solved for wherever the pose is (variable projection; Golub and Pereyra, 1973), and two widths of
blur, across its upright and across its level edges, which the Schur complement eliminates. What covers or outshines a
part of a marker loses its weight (Tukey's biweight).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from pzcap.camera import distort, undistort
from pzcap.types import Array, CalibrationObject, Camera, Image, Marker

MARGIN: Final = 0.4  # cells of the white around a marker that are looked at
LEAST_BLUR_PX, BLUR_PX, MOST_BLUR_PX = 0.25, 0.6, 3.0  # standard deviation beside the pixel's own square
BLUR_SIGMA: Final = 0.7  # of the blur's logarithm about BLUR_PX
ROUNDS: Final = 25
LOOSE: Final = 4  # rounds in which outliers pull a little (Huber), so that none wins by being there first
HUBER, TUKEY = 1.345, 4.685  # in standard deviations
LEAST_NOISE: Final = 0.3  # grey levels: what rounding leaves
DONE: Final = 0.01  # a step of so few standard deviations is the last
SHADING: Final = 6  # of paper and ink, three coefficients each


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    camera: Camera
    covariance: Array  # (6, 6) of the step of `moved`
    noise: float  # grey levels, standard deviation of what is left


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """The pixels that show one marker, and what is printed on it."""

    ink: Array  # (n, n) 1 where a cell is black, 0 where it is white; row, column
    axes_m: Array  # (3, 3) world, columns: one cell to the right, one cell down, the top left corner
    rays: Array  # (P, 3) camera, z = 1
    ray_by_px: Array  # (P, 2, 2) derivative of a ray's x and y with respect to column and row
    place: Array  # (P, 3) 1, column and row about the patch's middle
    grey: Array  # (P,)


def moved(camera: Camera, step: Array) -> Camera:
    """``camera`` when the world before it turns by the rotation vector ``step[:3]``, then shifts by ``step[3:]``."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    cam_R_world = turn @ camera.world_T_cam[:3, :3].T
    translation = step[3:] - cam_R_world @ camera.world_T_cam[:3, 3]
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = cam_R_world.T
    world_T_cam[:3, 3] = -cam_R_world.T @ translation
    return replace(camera, world_T_cam=world_T_cam)


def fit_pose(camera: Camera, image: Image, calibration_object: CalibrationObject, ids: Sequence[int]) -> PoseFit | None:
    """The pose that explains what ``image`` (H, W[, 3]) shows of the markers ``ids``; the lens of ``camera`` is held.

    The start has to be right to half a cell or so. None where the steps do not die out.
    """
    patches = cut(camera, image, calibration_object, ids)
    blur = np.full((len(patches), 2), BLUR_PX)
    weights = [np.ones(len(patch.grey)) for patch in patches]
    for number in range(ROUNDS):
        parts = [linearise(camera, *part) for part in zip(patches, blur, weights, strict=True)]
        noise = max(1.4826 * float(np.median(np.abs(np.concatenate([r for r, _ in parts])))), LEAST_NOISE)
        kept, normal, gradient = [], np.zeros((6, 6)), np.zeros(6)
        for (residual, jacobian), weight, widths in zip(parts, weights, blur, strict=True):
            whole = jacobian.T @ (weight[:, None] * jacobian)
            right = jacobian.T @ (weight * residual)
            prior = (noise / BLUR_SIGMA) ** 2
            whole[[6, 7], [6, 7]] += prior
            right[6:8] += prior * np.log(widths / BLUR_PX)
            share = np.linalg.solve(whole[6:, 6:], whole[6:, :6])
            normal += whole[:6, :6] - whole[:6, 6:] @ share
            gradient += right[:6] - share.T @ right[6:]
            kept.append((whole, right))
        try:
            step = -np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError:
            return None
        for k, (whole, right) in enumerate(kept):
            change = -np.linalg.solve(whole[6:, 6:], right[6:] + whole[6:, :6] @ step)[:2]
            blur[k] = np.clip(blur[k] * np.exp(np.clip(change, -0.5, 0.5)), LEAST_BLUR_PX, MOST_BLUR_PX)
        camera = moved(camera, step)
        weights = [_weigh(residual / noise, tight=number >= LOOSE) for residual, _ in parts]
        if number > LOOSE and step @ normal @ step < (DONE * noise) ** 2:
            return PoseFit(camera, np.linalg.inv(normal) * noise**2, noise)
    return None


def cut(camera: Camera, image: Image, calibration_object: CalibrationObject, ids: Sequence[int]) -> list[Patch]:
    """A patch for each of the markers ``ids``, where ``camera`` sees it in ``image`` (H, W[, 3])."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, calibration_object.dictionary))
    cells = dictionary.markerSize + 2
    patches = []
    for marker in calibration_object.markers:
        if marker.id not in ids:
            continue
        axes_m = _axes(marker, cells)
        corners = np.array([(a, b, 1.0) for a in (-MARGIN, cells + MARGIN) for b in (-MARGIN, cells + MARGIN)])
        around = _project(camera, corners @ axes_m.T)
        low = np.maximum(np.floor(around.min(axis=0)), 0).astype(int)
        high = np.minimum(np.ceil(around.max(axis=0)) + 1, [camera.width, camera.height]).astype(int)
        v, u = (g.ravel() for g in np.mgrid[low[1] : high[1], low[0] : high[0]])
        pixels = np.column_stack([u, v]).astype(np.float64)
        rays, ray_by_px = _rays(camera, pixels)
        places, _, _ = _on_print(camera, axes_m, rays)
        seen = image[v, u].reshape(len(pixels), -1)
        # beyond white nothing is known of the light
        used = np.all((places > -MARGIN) & (places < cells + MARGIN), axis=1) & (seen.max(axis=1) < 255)
        ink = (cv2.aruco.generateImageMarker(dictionary, marker.id, cells) == 0).astype(np.float64)
        place = np.column_stack([np.ones(len(pixels)), (pixels - around.mean(axis=0)) / np.ptp(around, axis=0)])
        # the mean of the colours: they are equal on print, and their noises are not the same
        patches.append(Patch(ink, axes_m, rays[used], ray_by_px[used], place[used], seen[used].mean(axis=1)))
    return patches


def linearise(camera: Camera, patch: Patch, blur_px: Array, weight: Array) -> tuple[Array, Array]:
    """Predicted minus seen grey values (P,), the best shadings found with ``weight`` (P,), and derivatives (P, 14).

    The columns: the step of `moved` (6), the logarithms of ``blur_px`` (2,), the shadings of paper and ink (6).
    """
    places, by_ray, by_pose = _on_print(camera, patch.axes_m, patch.rays)
    by_px = by_ray @ patch.ray_by_px
    ink = np.empty((len(places), 5))
    _ink(patch.ink, places, by_px, blur_px, ink)
    shares = np.column_stack([(1.0 - ink[:, :1]) * patch.place, ink[:, :1] * patch.place])
    root = np.sqrt(weight)
    shading = np.linalg.lstsq(shares * root[:, None], patch.grey * root, rcond=None)[0]
    contrast = patch.place @ (shading[3:] - shading[:3])
    jacobian = np.empty((len(places), 8 + SHADING))
    jacobian[:, :6] = contrast[:, None] * np.einsum("pi,pij->pj", ink[:, 1:3], by_pose)
    jacobian[:, 6:8] = contrast[:, None] * ink[:, 3:]
    jacobian[:, 8:] = shares
    return shares @ shading - patch.grey, jacobian


def _weigh(scaled: Array, *, tight: bool) -> Array:
    if tight:
        return np.square(np.clip(1.0 - np.square(scaled / TUKEY), 0.0, None))
    return np.minimum(1.0, HUBER / np.maximum(np.abs(scaled), 1e-9))


def _axes(marker: Marker, cells: int) -> Array:
    """(3, 3) columns: one cell to the right, one down, the top left corner, of the parallelogram nearest the corners."""
    a, b, c, d = marker.corners_m
    right, down = ((b - a) + (c - d)) / (2 * cells), ((d - a) + (c - b)) / (2 * cells)
    return np.column_stack([right, down, marker.corners_m.mean(axis=0) - cells / 2 * (right + down)])


def _on_print(camera: Camera, axes_m: Array, rays: Array) -> tuple[Array, Array, Array]:
    """Where rays (P, 3) meet a print, (P, 2) in cells to the right and down, and derivatives.

    (P, 2, 2) with respect to a ray's x and y, (P, 2, 6) to the step of `moved`: with ``H`` the print's axes in the
    camera's frame a ray ``d`` meets it at ``H^-1 d``, up to scale; ``dH = w x H + (0, 0, t)``.
    """
    rotation, centre = camera.world_T_cam[:3, :3], camera.world_T_cam[:3, 3]
    inverse = np.linalg.inv(rotation.T @ (axes_m - np.column_stack([np.zeros((3, 2)), centre])))
    met = rays @ inverse.T
    places = met[:, :2] / met[:, 2:]
    rows = (inverse[None, :2] - places[:, :, None] * inverse[2]) / met[:, 2, None, None]
    by_pose = np.empty((len(rays), 2, 6))
    by_pose[:, :, :3] = -np.cross(rays[:, None], rows)
    by_pose[:, :, 3:] = -met[:, 2, None, None] * rows
    return places, rows[:, :, :2], by_pose


def _project(camera: Camera, points_m: Array) -> Array:
    """Pixels (N, 2) of world points (N, 3) before the camera."""
    seen = (points_m - camera.world_T_cam[:3, 3]) @ camera.world_T_cam[:3, :3]
    return camera.principal_px + camera.focal_px * distort(seen[:, :2] / seen[:, 2:], camera.k1)


def _rays(camera: Camera, pixels: Array) -> tuple[Array, Array]:
    """Rays (P, 3) of pixels (P, 2), z = 1, and derivatives of their x and y (P, 2, 2) by column and row."""
    xy = undistort((pixels - camera.principal_px) / camera.focal_px, camera.k1)
    factor = 1.0 + camera.k1 * np.sum(xy * xy, axis=1)
    bend = factor[:, None, None] * np.eye(2) + 2.0 * camera.k1 * xy[:, :, None] * xy[:, None, :]
    return np.column_stack([xy, np.ones(len(xy))]), np.linalg.inv(bend) / camera.focal_px


# Gauss-Legendre's three points integrate over a pixel's side to the fifth order: no stair of samples, no bias
NODES: Final = np.array([-0.5 * math.sqrt(0.6), 0.0, 0.5 * math.sqrt(0.6)])
SHARES: Final = np.array([5 / 18, 8 / 18, 5 / 18])
REACH: Final = 4.5  # standard deviations beyond which an edge is not felt


@njit(cache=True, nogil=True)
def _ink(cells: Array, places: Array, by_px: Array, blur_px: Array, out: Array) -> None:
    """The share of ink in each pixel, and derivatives: ``out`` (P, 5).

    Ink, its derivatives with respect to the place (to the right, down), and to the two widths' logarithms. Blur is
    Gaussian across each edge, as if the edges to the right and downwards were blurred one after the other; then the
    mean over the pixel's square is taken, on which the print is seen under a linear map.
    """
    n = len(cells)
    across, slope, spread = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    for p in range(len(places)):
        sigma_s = blur_px[0] * math.hypot(by_px[p, 0, 0], by_px[p, 0, 1])
        sigma_t = blur_px[1] * math.hypot(by_px[p, 1, 0], by_px[p, 1, 1])
        out[p] = 0.0
        for a in range(3):
            for b in range(3):
                s = places[p, 0] + by_px[p, 0, 0] * NODES[a] + by_px[p, 0, 1] * NODES[b]
                t = places[p, 1] + by_px[p, 1, 0] * NODES[a] + by_px[p, 1, 1] * NODES[b]
                left = max(int(math.floor(s - REACH * sigma_s)), 0)
                right = min(int(math.floor(s + REACH * sigma_s)), n - 1)
                top = max(int(math.floor(t - REACH * sigma_t)), 0)
                bottom = min(int(math.floor(t + REACH * sigma_t)), n - 1)
                if left > right or top > bottom:
                    continue
                weight = SHARES[a] * SHARES[b]
                for i in range(left, right + 2):
                    across[i], slope[i], spread[i] = _edge(s - i, sigma_s)
                for j in range(top, bottom + 1):
                    start, start_slope, start_spread = _edge(t - j, sigma_t)
                    end, end_slope, end_spread = _edge(t - j - 1, sigma_t)
                    for i in range(left, right + 1):
                        full = weight * cells[j, i]
                        out[p, 0] += full * (across[i] - across[i + 1]) * (start - end)
                        out[p, 1] += full * (slope[i] - slope[i + 1]) * (start - end)
                        out[p, 2] += full * (across[i] - across[i + 1]) * (start_slope - end_slope)
                        out[p, 3] += full * (spread[i] - spread[i + 1]) * (start - end)
                        out[p, 4] += full * (across[i] - across[i + 1]) * (start_spread - end_spread)


@njit(cache=True, nogil=True)
def _edge(offset: float, sigma: float) -> tuple[float, float, float]:
    """A blurred step, its derivative by the offset from it, and by the logarithm of its width."""
    z = offset / sigma
    if z < -REACH:
        return 0.0, 0.0, 0.0
    if z > REACH:
        return 1.0, 0.0, 0.0
    density = 0.3989422804014327 * math.exp(-0.5 * z * z)
    return 0.5 * (1.0 + math.erf(0.7071067811865476 * z)), density / sigma, -z * density
