"""Parallax: what is seen from a projection centre beside the pan axis, against what would be seen from the axis."""

from __future__ import annotations

import numpy as np
from numba import njit

from pzcap.geometry.camera import View
from pzcap.types import Array


def parallax(view: View, azimuth_rad: Array, slope: Array, inverse_distance: Array) -> tuple[Array, Array]:
    """Change of azimuth and slope (...) from a point on the pan axis to the projection centre of ``view``.

    ``inverse_distance`` (...), 1 / m, is that of what is seen, from the axis. Back again it is `parallax_back`.
    """
    forward, left, up = view.centre_m
    sin_a, cos_a = np.sin(azimuth_rad - view.pan_rad), np.cos(azimuth_rad - view.pan_rad)
    across = inverse_distance * (forward * sin_a - left * cos_a)
    ahead = 1.0 - inverse_distance * (forward * cos_a + left * sin_a)
    return np.arctan2(across, ahead), (slope - inverse_distance * up) / np.hypot(across, ahead) - slope


@njit(cache=True, nogil=True, error_model="numpy")
def parallax_back(
    cos_a: float, sin_a: float, slope: float, near: float, forward: float, left: float, up: float
) -> tuple[float, float]:
    """Change of azimuth from the projection centre, ``forward``, ``left`` and ``up`` of the pan axis, to a point on
    that, and the slope there, for kernels. ``cos_a`` and ``sin_a`` are of the azimuth from the pan, and ``near`` is the
    inverse distance from the axis."""
    across = near * (left * cos_a - forward * sin_a)
    reach = np.sqrt(max(1.0 - across * across, 0.0)) - near * (forward * cos_a + left * sin_a)
    return np.arcsin(min(max(across, -1.0), 1.0)), near * up + reach * slope
