"""Comparison of a frame with the super-resolved panorama (`pzcap.extras.superresolution`), where there is one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from pzcap.imaging.bspline import smoothed
from pzcap.localisation.frame_pixels import FramePixels, shading
from pzcap.localisation.panorama_sampler import KNOWN, PanoramaSampler, PanTiltZoom, Rays, half_extents
from pzcap.localisation.tuning import ALIGNMENT, SUPERRESOLVED
from pzcap.types import Array, Image, Mask, PanZoomCamera

Look = Callable[[Rays, PanTiltZoom], Array]
"""Samples (N, 7) of the panorama along rays (N), extrapolated to a pan, tilt and focal length."""


def every_pixel(
    sampler: PanoramaSampler, camera: PanZoomCamera, frame: Image, hidden: Mask | None, focal_px: float
) -> tuple[FramePixels, Look]:
    """All pixels of a ``frame`` (H, W) but those near its border or ``hidden`` (H, W), and what predicts them: the mean
    of the super-resolved panorama over the square that each covers.

    Frame and prediction are smoothed alike. The prediction is smoothed last, so that it contains what the frame's
    pixels are too coarse for as the frame does.
    """
    assert sampler.superresolved is not None
    border = ALIGNMENT.border_px
    inner = slice(border, -border)
    soft = smoothed(frame, SUPERRESOLVED.smoothing_px2)[inner, inner]
    visible = np.ones(soft.shape, np.uint8) if hidden is None else (~hidden[inner, inner]).astype(np.uint8)
    reach = np.ones((7, 7), np.uint8)  # of the smoothing; what it takes from further off is negligible
    rows, columns = np.mgrid[border : frame.shape[0] - border, border : frame.shape[1] - border]
    points = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
    half = half_extents(camera, points, focal_px) * sampler.px_per_rad / np.array(sampler.superresolved.scale)
    layer = replace(sampler.superresolved, half=half)

    def look(rays: Rays, at: PanTiltZoom) -> Array:
        samples = sampler.sample(layer, rays, at)
        for column in range(KNOWN):  # value and derivatives
            image = samples[:, column].reshape(soft.shape).astype(np.float32)
            samples[:, column] = smoothed(image, SUPERRESOLVED.smoothing_px2).ravel()
        known = (samples[:, KNOWN].reshape(soft.shape) > 0).astype(np.uint8) & visible
        samples[:, KNOWN] = cv2.erode(known, reach, borderType=cv2.BORDER_CONSTANT, borderValue=0).ravel()
        return samples

    return FramePixels(points, soft.ravel().astype(np.float64), shading(points, camera.lens, focal_px)), look
