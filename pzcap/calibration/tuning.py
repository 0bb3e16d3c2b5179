"""Constants of the calibration, a table a topic; what a user may want to set stands in the settings instead."""

from __future__ import annotations

from typing import NamedTuple


class BundleTuning(NamedTuple):
    """`bundle_adjustment`."""

    settled_rad: float = 1e-5
    """Largest change of a pan that ends the adjustment: a hundredth of a pixel."""
    least_sigma_px: float = 0.01
    """No match is better than this, however well all agree."""


class PhotometricTuning(NamedTuple):
    """`photometric_bundle_adjustment`."""

    tile_px: int = 16
    """Side of the squares that each give the same number of edges, so that they come from everywhere."""
    border: float = 6.0
    """Pixels at the edge left out, times the smoothing, which reaches beyond."""
    steps: int = 4
    """Gauss-Newton steps, at most."""
    doubt: float = 10.0
    """What is left over is no noise but the same in neighbouring pixels: so many are worth one. Fitted to captures."""
    settled_rad: float = 2e-7
    """Largest change of a pan that ends the adjustment: a five thousandth of a pixel."""


BUNDLE = BundleTuning()
PHOTOMETRIC = PhotometricTuning()
