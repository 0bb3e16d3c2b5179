"""Prior of a frame's alignment: how far it may be off in what is not pan or focal length."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.types import Array


class FramePrior(NamedTuple):
    """Prior of a frame's alignment: standard deviations of tilt, roll, pan shear and zoom shear about those
    of a place. With 0 they are held there."""

    mean: ViewPlace
    tilt_rad: float = 0.0
    roll_rad: float = 0.0
    pan_shear_rad: float = 0.0
    zoom_shear: float = 0.0

    @property
    def free(self) -> int:
        """Number of unknowns of the place, the first of those that `ViewPlace.stepped` steps."""
        sigmas = self[1:]
        return 2 + max((k + 1 for k, sigma in enumerate(sigmas) if sigma > 0.0), default=0)

    def information(self) -> Array:
        """(free,) inverse variances; 0 of pan and log focal, which nobody knows."""
        sigma = np.maximum(np.array(self[1 : self.free - 1]), _HELD)
        return np.concatenate([np.zeros(2), sigma**-2.0])

    def departure(self, at: ViewPlace) -> Array:
        """(free,) unknowns of a place minus the mean; 0 of pan and log focal."""
        mean = self.mean
        off = np.array([
            0.0, 0.0, at.tilt_rad - mean.tilt_rad, at.roll_rad - mean.roll_rad,
            at.pan_shear_rad - mean.pan_shear_rad, at.zoom_shear - mean.zoom_shear,
        ])  # fmt: skip
        return off[: self.free]


_HELD: Final = 1e-9  # standard deviation, radians, of what is held though an unknown after it is free
