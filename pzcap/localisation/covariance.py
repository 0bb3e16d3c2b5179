"""The part of a frame's covariance that no single frame shows: systematic errors of pan and focal length."""

from __future__ import annotations

import numpy as np

from pzcap.calibration.settings import PanZoomConfig
from pzcap.geometry.camera import wrapped
from pzcap.types import Array, Lens, PanZoomCamera


def systematic(config: PanZoomConfig, camera: PanZoomCamera, pan_rad: Array, focal_px: Array) -> Array:
    """The covariance (..., 2, 2) at pans and focal lengths (...) of what no single frame shows and all share: a floor;
    calibration's own errors; and in the focal length what the distortion may do unseen. A frame that was not
    found has the focal length 0: there it is that of the reference's, and says nothing."""
    lens = camera.lens
    focal_px = np.where(focal_px > 0.0, focal_px, lens.reference_focal_px)
    floor = np.array([config.floor_px / lens.reference_focal_px, config.floor_edge_px / (0.5 * lens.width)])
    covariance = np.asarray(np.diag(floor**2) + _of_calibration(camera, wrapped(pan_rad), focal_px))
    covariance[..., 1, 1] += _distortion_sigma(lens, focal_px, config.beliefs.k1) ** 2
    return covariance


def _of_calibration(camera: PanZoomCamera, pan_rad: Array, focal_px: Array) -> Array:
    """(..., 2, 2) by `pzcap.calibration.propagation`, interpolated; without that, of the sweep's scale alone, which
    stretches focal lengths and shrinks pans together."""
    known, zooms = camera.shared_covariance, np.log(camera.shared_zooms)
    if known.size == 0:
        scale = np.stack([-pan_rad, np.ones_like(pan_rad)], axis=-1) * camera.focal_sigma
        return np.asarray(scale[..., :, None] * scale[..., None, :])
    column = np.mod(pan_rad / (2 * np.pi), 1.0) * len(known)
    row = np.interp(np.log(focal_px / camera.lens.reference_focal_px), zooms, np.arange(len(zooms)))
    left, low = column.astype(np.int64), np.minimum(row.astype(np.int64), max(len(zooms) - 2, 0))
    right, high = (left + 1) % len(known), np.minimum(low + 1, len(zooms) - 1)
    left %= len(known)
    beyond, above = (column - np.floor(column))[..., None, None], (row - low)[..., None, None]
    below = (1.0 - beyond) * known[left, low] + beyond * known[right, low]
    return np.asarray(
        (1.0 - above) * below + above * ((1.0 - beyond) * known[left, high] + beyond * known[right, high])
    )


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
