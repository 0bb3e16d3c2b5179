"""Axes and angles of other tools. The world of pzcap has z up, its cameras x right, y down and z forward."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from pzcap.types import Array

Y_UP_FACING_Z: Final[Array] = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""World to (left, up, forward) of somebody in the zero pose: BVH and glTF."""
Y_UP_FACING_X: Final[Array] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""World to (forward, up, right) of somebody in the zero pose: OpenSim. It is also the plain turn of the z axis upon
the y axis, as Nuke's world has it."""
LOOKING_BACK: Final[Array] = np.diag([1.0, -1.0, -1.0])
"""Axes of a camera that looks along -z, with y up, in the axes of ours: USD, glTF, Nuke."""
Z_DOWN: Final[Array] = np.diag([1.0, -1.0, -1.0])  # world to SoccerNet's, whose z axis points down


class PanTiltRoll(NamedTuple):
    """Degrees; a camera at zero looks along +y. Pan to the left, tilt up, roll clockwise seen from behind."""

    pan: float
    tilt: float
    roll: float


def pan_tilt_roll(rotation: Array) -> PanTiltRoll:
    """Angles of ``rotation`` (3, 3), camera to world: pan about z, then tilt about the camera's x, then roll."""
    right, up, forward = rotation[:, 0], -rotation[:, 1], rotation[:, 2]
    angles = (
        np.arctan2(-forward[0], forward[1]),
        np.arcsin(np.clip(forward[2], -1.0, 1.0)),
        np.arctan2(-right[2], up[2]),
    )
    return PanTiltRoll(*(float(angle) for angle in np.rad2deg(angles)))
