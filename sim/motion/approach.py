"""Somebody who strolls up to camera 3, from five metres to two."""

from __future__ import annotations

from typing import Final

import numpy as np

from sim.motion._clip import MotionClip
from sim.motion.pedestrian import walk

_START_M: Final = np.array([6.6, 5.0])
_END_M: Final = np.array([8.8, 6.7])
_BULGE_M: Final = 0.3


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Walk once along the arc, as `pedestrian.make`."""
    return walk(measurements, rng, _START_M, _END_M, _BULGE_M)
