"""Interpolation against the plainest way to say the same."""

from __future__ import annotations

import numpy as np

from pzcap.imaging.interpolation import bilinear, bilinear_with_gradient


def test_slope_is_that_of_the_values_beside() -> None:
    image = np.random.default_rng(1).integers(0, 256, (12, 14)).astype(np.uint8)

    def at(x: float, y: float) -> float:
        return float(bilinear(image, x, y))

    for x, y in np.random.default_rng(2).uniform(2.0, 8.0, (20, 2)):
        expected = at(x, y), 0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1))
        np.testing.assert_allclose(bilinear_with_gradient(image, x, y), expected, atol=1e-9)
