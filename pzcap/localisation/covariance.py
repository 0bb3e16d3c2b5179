"""The part of a frame's covariance that no single frame shows: systematic errors of pan and focal length."""

from __future__ import annotations

import numpy as np

from pzcap.calibration.settings import PanZoomConfig
from pzcap.geometry.camera import wrapped
from pzcap.types import Array, Lens, PanZoomCamera


def systematic(config: PanZoomConfig, camera: PanZoomCamera, pan_rad: Array, focal_px: Array) -> Array:
    """The covariance (..., 2, 2) at pans and focal lengths (...) of what no single frame shows and all share: a floor;
    the scale of the sweep, which stretches focal lengths and shrinks pans together; and in the focal length what the
    distortion may do unseen."""
    pan_rad = wrapped(pan_rad)
    scale = np.stack([-pan_rad, np.ones_like(pan_rad)], axis=-1) * camera.focal_sigma
    lens = camera.lens
    floor = np.array([config.floor_px / lens.reference_focal_px, config.floor_edge_px / (0.5 * lens.width)])
    covariance = np.asarray(np.diag(floor**2) + scale[..., :, None] * scale[..., None, :])
    covariance[..., 1, 1] += _distortion_sigma(lens, focal_px, config.beliefs.k1) ** 2
    return covariance


def _distortion_sigma(lens: Lens, focal_px: Array, k1_sigma: float) -> Array:
    """Sigma (...) of log focal length, from a distortion whose change, for each unit of that, is known to ``k1_sigma``.

    Without a zoom run the lens has the sweep's distortion (one coefficient) at every zoom. What is missing, k r^3,
    passes for a longer focal length, a r, by least squares over the image a = k sum r^4 / sum r^2.
    """
    if len(lens.k1) > 1:
        return np.zeros_like(focal_px)
    across, down = lens.width**2, lens.height**2
    mean_square, mean_fourth = (across + down) / 12, (across**2 + down**2) / 80 + across * down / 72
    return k1_sigma * np.abs(np.log(focal_px / lens.reference_focal_px)) * mean_fourth / mean_square / focal_px**2
