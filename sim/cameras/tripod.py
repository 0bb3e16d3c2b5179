"""Unrest of a tripod that should stand still: it settles, rings on a sprung floor, and is bumped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.types import Array

_DECAY_S: Final = 0.2  # time in which the ringing falls to 1/e: a tripod's wood and rubber damp it


@dataclass(frozen=True, slots=True, eq=False)
class Unrest:
    """Heading, tilt and roll of a tripod while the motion is recorded, against those while the hall was."""

    settled_rad: float  # of tilt, all the time
    landings_s: Array  # (L,) each sets it ringing
    rings_rad: Array  # (L, 2) amplitudes of tilt and roll, with sign
    ring_hz: float
    bump_s: float
    bump_rad: Array  # (3,) of heading (to the left), tilt and roll, from then on

    def at(self, time_s: float) -> Array:
        """(3,) heading, tilt and roll at a time."""
        since_s = np.maximum(time_s - self.landings_s, 0.0)
        ringing = np.exp(-since_s / _DECAY_S) * np.sin(2 * np.pi * self.ring_hz * since_s)
        moved = np.array([0.0, self.settled_rad, 0.0])
        moved[1:] += ringing @ self.rings_rad
        return moved + self.bump_rad if time_s >= self.bump_s else moved
