"""Errors of pictures that were displaced or magnified on purpose are found."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.supersampling import compare
from pzcap.types import Image

WAVES = np.random.default_rng(0).uniform(-0.4, 0.4, (40, 2))  # radians a pixel


def moved(across: float, down: float, magnified: float) -> Image:
    """A pattern of waves, each point shifted and carried away from the middle."""
    v, u = np.indices((240, 320)) - np.array([119.5, 159.5])[:, None, None]
    x, y = (u - across) / (1 + magnified), (v - down) / (1 + magnified)
    level = sum(np.cos(a * x + b * y + k) for k, (a, b) in enumerate(WAVES.tolist()))
    return np.asarray(np.clip(np.rint(128 + 20 * np.asarray(level)), 0, 255)[..., None].repeat(3, axis=2), np.uint8)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_displacement_is_found(sign: int) -> None:
    found = compare([moved(0.2 * sign, -0.1, 0.0)], [moved(0.0, 0.0, 0.0)])
    assert found.across_mpx == pytest.approx(200, rel=0.05)
    assert found.down_mpx == pytest.approx(100, rel=0.05)
    assert found.focal_percent < 0.005
    assert found.field_mpx == pytest.approx(np.hypot(200, 100) / np.sqrt(2), rel=0.05)


def test_a_magnification_is_found() -> None:
    found = compare([moved(0.0, 0.0, 0.002)], [moved(0.0, 0.0, 0.0)])
    assert found.focal_percent == pytest.approx(0.2, rel=0.05)
    assert max(found.across_mpx, found.down_mpx) < 10


def test_the_same_picture_has_no_error() -> None:
    found = compare([moved(0.0, 0.0, 0.0)], [moved(0.0, 0.0, 0.0)])
    assert (found.across_mpx, found.down_mpx, found.focal_percent, found.field_mpx) == (0, 0, 0, 0)
