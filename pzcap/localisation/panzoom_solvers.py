"""The solutions of section 4: pan and zoom from matches between a frame and the panorama.

Eq. 15, the paper's final one, is linear; eq. 11 is solved for the calibrated camera, with all of tilt, roll, principal
point and distortion in place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.types import Array, Mask, Panorama, PanZoomCamera


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Of eq. 11."""

    pan_rad: float
    tilt_rad: float
    focal_px: float
    covariance: Array  # (2, 2) of (pan, log focal), from the residuals alone
    inliers: Mask  # (N,)


def solve_eq11(
    panorama: Panorama,
    camera: PanZoomCamera,
    pan_rad: float,
    focal_px: float,
    points_px: Array,
    azimuth_rad: Array,
    slope: Array,
    *,
    free_tilt: bool = False,
) -> Solution:
    """Eq. 11 for matches (N,): pan, log focal, and tilt if that is free, from a start at the camera's tilt.

    Gauss-Newton with falling weights (Geman and McClure); the residuals are pixels of the frame.
    """
    scale, tilt_rad = 8.0, camera.tilt_rad
    free = 3 if free_tilt else 2
    if free_tilt:
        view = geometry.view_at(camera, pan_rad, tilt_rad, focal_px)
        tilt_rad += float(np.median(slope - geometry.pixel_to_direction(view, points_px)[1]))
    for _ in range(30):
        view = geometry.view_at(camera, pan_rad, tilt_rad, focal_px)
        directions = cylinder.from_centre(panorama, view, azimuth_rad, slope)
        seen, _ = geometry.direction_to_pixel(view, *directions)
        residual = seen - points_px
        length = np.hypot(residual[:, 0], residual[:, 1])
        weight = (scale**2 / (scale**2 + length**2)) ** 2
        jacobian = geometry.pan_zoom_derivatives(camera, view, *directions)[:, :, :free]
        weighted = (jacobian * weight[:, None, None]).reshape(-1, free)
        normal = weighted.T @ jacobian.reshape(-1, free) + 1e-9 * np.eye(free)
        step = -np.linalg.solve(normal, weighted.T @ residual.ravel())
        pan_rad += float(step[0])
        focal_px *= float(np.exp(np.clip(step[1], -0.3, 0.3)))
        tilt_rad += float(step[2]) if free_tilt else 0.0
        next_scale = max(3.0 * float(np.median(length)) / 1.1774, 0.3)
        if np.abs(step).max() < 1e-8 and abs(next_scale - scale) < 0.01 * scale:
            break
        scale = max(next_scale, scale / 2)
    inliers = length < 2.0 * scale
    variance = float(np.sum(weight * length**2) / (2 * weight.sum()))
    covariance = np.asarray(variance * np.linalg.inv(normal)[:2, :2], np.float64)
    return Solution(pan_rad, tilt_rad, focal_px, covariance, inliers)


def solve_eq15(relative_px: Array, places_px: Array) -> tuple[Array, Array]:
    """Eq. 15 for matches (N, 2) on the frame's cylinder, relative to its origin, and on the panorama.

    Returns ``(1 / zoom ratio, p_0, q_0)`` and its covariance (3, 3).
    """
    count = len(relative_px)
    system = np.zeros((count, 2, 3))
    system[:, :, 0] = relative_px
    system[:, 0, 1] = system[:, 1, 2] = 1.0
    flat = system.reshape(-1, 3)
    solution = np.linalg.lstsq(flat, places_px.ravel(), rcond=None)[0]
    residual = flat @ solution - places_px.ravel()
    variance = float(residual @ residual) / max(2 * count - 3, 1)
    covariance = variance * np.linalg.pinv(flat.T @ flat)
    return np.asarray(solution, np.float64), np.asarray(covariance, np.float64)


def ransac_eq15(relative_px: Array, places_px: Array, *, draws: int = 1000, tolerance_px: float = 5.0) -> Mask:
    """Which matches (N,) agree on one zoom ratio and place: random samples of two, always the same ones."""
    best = np.zeros(len(relative_px), bool)
    if len(relative_px) < 2:
        return best
    rng = np.random.default_rng(0)
    for i, j in rng.integers(len(relative_px), size=(draws, 2)):
        span = relative_px[j] - relative_px[i]
        squared = float(span @ span)
        if squared < 20.0**2:
            continue
        shrink = float(span @ (places_px[j] - places_px[i])) / squared
        if not 0.1 < shrink < 10:
            continue
        off = places_px - places_px[i] - shrink * (relative_px - relative_px[i])
        agree = np.hypot(off[:, 0], off[:, 1]) < tolerance_px
        if agree.sum() > best.sum():
            best = agree
    return best
