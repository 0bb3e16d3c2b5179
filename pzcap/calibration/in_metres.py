"""A calibrated camera in metres: calibration's lengths are heights of the camera over the floor."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pzcap.calibration.correspondences import height_of
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.geometry import camera as geometry
from pzcap.types import Camera, InverseDepthMap, PanZoomCamera


def in_metres(model: CalibrationParameters, origin_rad: float, taken: Camera) -> tuple[PanZoomCamera, InverseDepthMap]:
    """Convert the parameters, in camera heights, to metres; azimuths count from the reference image's pan.

    The floor is taken to be at world height 0, where the calibration object stands. If it is not, offset and distances
    are wrong by the same factor, and the parallax, which depends on their ratio alone, is still right.
    """
    height_m = height_of(taken)
    camera = PanZoomCamera(
        model.lens(taken.width, taken.height), np.eye(4), model.tilt_rad, model.roll_rad,
        offset_m=model.offset * height_m, travel_m=model.travel * height_m,
    )  # fmt: skip
    return geometry.mount(taken, camera), _rotated(model.surroundings, origin_rad, height_m)


def _rotated(hall: InverseDepthMap, origin_rad: float, height_m: float) -> InverseDepthMap:
    """Convert a map in camera heights to metres, its azimuths counted from ``origin_rad``."""
    places = np.mod(origin_rad / (2 * np.pi), 1.0) * len(hall.walls)
    walls = ndimage.shift(hall.walls, -places, order=1, mode="grid-wrap")
    departures = ndimage.shift(hall.departures, (0.0, -places), order=1, mode="grid-wrap")
    cos, sin = np.cos(origin_rad), np.sin(origin_rad)
    lean = np.array([[cos, sin], [-sin, cos]]) @ hall.lean
    return InverseDepthMap(height_m, walls / height_m, departures, hall.slopes, lean=lean)
