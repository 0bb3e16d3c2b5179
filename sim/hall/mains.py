"""Mains light: lamps that go dark and bright twice in each period of the mains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.types import Array
from sim.hall.gym import GymConfig

_UNSTEADY: Final = 5e-4  # largest departure of the mains' frequency from its nominal one


@dataclass(frozen=True, slots=True)
class Mains:
    """Brightness of the light over time, which is 1 in the mean."""

    share: float
    hz: float
    phase_rad: float

    def __call__(self, times_s: Array | float) -> Array:
        return np.asarray(1.0 + self.share * np.sin(2 * np.pi * self.hz * np.asarray(times_s) + self.phase_rad))


def draw_mains(config: GymConfig, shutter_s: float, taken: np.random.Generator, lamps: np.random.Generator) -> Mains:
    """The light of one take, as an open shutter sees it.

    taken: draws when it was taken. lamps: draws what share of a camera's light comes from lamps of each phase.
    """
    shares = lamps.dirichlet(np.ones(config.mains_phases))
    mixed = shares @ np.exp(2j * np.pi * np.arange(config.mains_phases) / config.mains_phases)
    hz = config.mains_hz * (1 + taken.uniform(-_UNSTEADY, _UNSTEADY))
    phase_rad = taken.uniform(0, 2 * np.pi) + float(np.angle(mixed))
    return Mains(config.mains_share * float(abs(mixed)) * float(np.sinc(hz * shutter_s)), hz, phase_rad)
