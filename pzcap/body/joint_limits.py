"""Ranges of the joints: how far each rotation vector of a trained gymnast reaches."""

from __future__ import annotations

from typing import Final

import numpy as np

from pzcap.body.skeleton import DOF_SEGMENT
from pzcap.types import DOF, SEGMENTS, Array, without_side

# Ranges of the rotation vector about x, y, z (degrees) that a trained gymnast can reach, generously; mirrored for the
# right side. They only keep a hidden limb from folding up, so they are soft and wide. A shoulder reaches half a turn,
# where rotation vectors change sign: it is left free. A hip turns by 45 degrees about the thigh, and takes it 30 across
# the other one (American Academy of Orthopaedic Surgeons, 1965): a leg that goes further explains an arm.
_LIMITS_DEG: Final[dict[str, tuple[tuple[float, float], ...]]] = {
    "lumbar": ((-40, 40), (-50, 70), (-40, 40)),
    "thorax": ((-40, 40), (-50, 60), (-50, 50)),
    "head": ((-55, 55), (-75, 75), (-85, 85)),
    "forearm": ((-8, 160),),
    "hand": ((-60, 60), (-90, 90), (-95, 95)),
    "thigh": ((-35, 100), (-150, 80), (-55, 55)),
    "shank": ((-8, 160),),
    "foot": ((-45, 45), (-60, 90), (-50, 50)),
}


def _limits() -> tuple[Array, Array]:
    low, high = np.full(DOF, -np.inf), np.full(DOF, np.inf)
    for index, name in enumerate(SEGMENTS):
        ranges = _LIMITS_DEG.get(without_side(name))
        if ranges is None:
            continue
        for row, axis, (a, b) in zip(np.flatnonzero(index == DOF_SEGMENT), range(3), ranges, strict=False):
            if name.startswith("right_") and len(ranges) == 3 and axis != 1:
                a, b = -b, -a
            low[row], high[row] = np.deg2rad(a), np.deg2rad(b)
    return low, high


LIMIT_LOW, LIMIT_HIGH = _limits()  # (43,) Range of each rotation vector component, radians; infinite for the root
