"""Shoots that tests share, filmed once and kept."""

from __future__ import annotations

import fcntl
from dataclasses import replace
from pathlib import Path

from experiments import footage
from experiments.config import AppConfig
from experiments.footage import SMALL
from sim.session import ShootConfig

CAPTURES = Path(__file__).parent.parent.parent / AppConfig().output.captures
TINY = replace(
    SMALL, motion_frames=2, width=160, height=120, sweep_deg=8.0, zoom_frames=2,
    gym=replace(SMALL.gym, texture_px_per_m=50.0),
)  # fmt: skip


def shot(config: ShootConfig) -> Path:
    """The folder of a shoot, made once and kept for later test runs; safe when tests run side by side."""
    CAPTURES.mkdir(parents=True, exist_ok=True)
    with (CAPTURES / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return footage.shot(config, CAPTURES)
