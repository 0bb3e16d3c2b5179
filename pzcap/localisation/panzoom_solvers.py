"""Solution of eq. 11 (section 4): pan and zoom from matches between a frame and the panorama.

It is solved for the calibrated camera, with all of tilt, roll, principal point and distortion in place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.localisation.panorama_sampler import PanTiltZoom
from pzcap.solver.gauss_newton import NormalEquations, Schedule, minimise
from pzcap.solver.robust import geman_mcclure
from pzcap.types import Array, Mask, Panorama, PanZoomCamera


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    pan_rad: float
    tilt_rad: float
    focal_px: float
    covariance: Array  # (2, 2) of (pan, log focal), from the residuals alone
    inliers: Mask  # (N,)


def solve_eq11(
    panorama: Panorama, camera: PanZoomCamera, pan_rad: float, focal_px: float, points_px: Array, azimuth_rad: Array,
    slope: Array, *, free_tilt: bool = False,
) -> Solution:  # fmt: skip
    """Pan, log focal, and tilt if that is free, of a frame whose ``points_px`` (N, 2) show directions of the panorama
    (N,), from a start at the camera's tilt.

    Minimises the Geman-McClure cost of the distances between points and directions, in pixels of the frame.
    """
    at, free = PanTiltZoom(pan_rad, camera.tilt_rad, focal_px), 3 if free_tilt else 2
    if free_tilt:
        seen = geometry.pixel_to_direction(geometry.view_at(camera, *at), points_px)[1]
        at = at._replace(tilt_rad=at.tilt_rad + float(np.median(slope - seen)))
    length, weight = np.empty(len(points_px)), np.empty(len(points_px))

    def linearise(at: PanTiltZoom, scale: float) -> NormalEquations:
        view = geometry.view_at(camera, *at)
        directions = cylinder.from_centre(panorama, view, azimuth_rad, slope)
        residual = geometry.direction_to_pixel(view, *directions)[0] - points_px
        length[:] = np.hypot(*residual.T)
        weight[:] = geman_mcclure(length, scale)
        jacobian = geometry.pan_zoom_derivatives(camera, view, *directions)[:, :, :free]
        weighted = (jacobian * weight[:, None, None]).reshape(-1, free)
        normal = weighted.T @ jacobian.reshape(-1, free) + 1e-9 * np.eye(free)
        # the median length of a normally distributed pair is 1.1774 of one coordinate's sigma
        sigma = float(np.median(length)) / 1.1774
        return NormalEquations(normal, weighted.T @ residual.ravel(), sigma, float(np.sum(weight * length**2)))

    solution = minimise(
        at, linearise, lambda at, step: at.stepped(step, 0.3), lambda step: np.abs(step).max() < 1e-8,
        Schedule(30, 8.0, least_scale=0.3, fall=2.0, steady=0.01),
    )  # fmt: skip
    variance = solution.report.cost / float(2 * weight.sum())
    covariance = np.asarray(variance * np.linalg.inv(solution.normal)[:2, :2], np.float64)
    return Solution(*solution.state, covariance, length < 2.0 * solution.scale)
