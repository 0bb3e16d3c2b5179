"""The synthetic hall as the library would know it: its panorama, and the camera that films it."""

from __future__ import annotations

import numpy as np

from pzcap.types import Lens, Panorama, PanZoomCamera
from tests.scenes import synthetic


def whole_turn(seed: int) -> Panorama:
    """The synthetic hall itself as a panorama."""
    image = synthetic.hall(seed)
    height, width = image.shape[:2]
    px_per_rad = width / (2 * np.pi)
    origin = np.array([width / 2 - 0.5, synthetic.SLOPES * px_per_rad - 0.5])
    empty = np.zeros(0)
    return Panorama(
        image, np.ones((height, width), bool), px_per_rad, origin, True, empty, empty.astype(np.int64), 0.0, 0.0
    )


def camera_of(optics: synthetic.Optics) -> PanZoomCamera:
    """The library's camera of the synthetic hall's ``optics``."""
    lens = Lens(
        optics.width, optics.height, optics.reference_focal_px,
        np.array([optics.principal_px, optics.principal_slope_px]), np.array([optics.k1, optics.k1_slope]),
    )  # fmt: skip
    return PanZoomCamera(lens, np.eye(4), optics.tilt_rad, optics.roll_rad)
