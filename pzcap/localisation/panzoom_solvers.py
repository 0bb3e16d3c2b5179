"""The solutions of section 4: pan and zoom from matches between a frame and the panorama.

Eq. 15, the paper's final one, is linear; eq. 11 is solved for the calibrated camera, with all of tilt, roll, principal
point and distortion in place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.solver.robust import geman_mcclure_weights
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
        weight = geman_mcclure_weights(length, scale)
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
