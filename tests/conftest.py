"""What several rooms' tests share."""

from __future__ import annotations

import fcntl
from pathlib import Path

import pytest
from hypothesis import settings

from sim.gym import GymConfig
from sim.optics import OpticsConfig
from sim.shoot import ShootConfig, shoot_cached

settings.register_profile("gate", derandomize=True)  # the same examples every time: a gate must not open by luck
settings.load_profile("gate")

CAPTURES = Path(__file__).parent.parent / "outputs" / "test_captures"

SMALL = ShootConfig(
    motion="pedestrian",
    motion_frames=8,
    width=320,
    height=240,
    sweep_deg=80.0,
    zoom_frames=8,
    optics=OpticsConfig(zoom_max=1.8),  # no more than the coarse textures can serve
    gym=GymConfig(texture_px_per_m=80.0),
)
"""Every effect on, as by default, but little of it: four cameras, 320 x 240, 40 sweep frames, 8 frames of motion."""


def shot(config: ShootConfig) -> Path:
    """The folder of a shoot, made once and kept for later test runs; safe when tests run side by side."""
    CAPTURES.mkdir(parents=True, exist_ok=True)
    with (CAPTURES / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        shooting = shoot_cached(config, CAPTURES)
        while True:
            try:
                next(shooting)
            except StopIteration as end:
                return Path(end.value)


@pytest.fixture(scope="session")
def small_capture() -> Path:
    """A folder with ``capture/`` and ``truth/`` of a short, small shoot. Read only."""
    return shot(SMALL)
