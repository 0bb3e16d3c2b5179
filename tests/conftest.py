"""What several rooms' tests share."""

from __future__ import annotations

import fcntl
from pathlib import Path

import pytest
from hypothesis import settings

from experiments import footage
from experiments.config import AppConfig
from experiments.footage import SMALL
from sim.session import ShootConfig

settings.register_profile("gate", derandomize=True)  # the same examples every time: a gate must not open by luck
settings.load_profile("gate")

CAPTURES = Path(__file__).parent.parent / AppConfig().output.captures


def shot(config: ShootConfig) -> Path:
    """The folder of a shoot, made once and kept for later test runs; safe when tests run side by side."""
    CAPTURES.mkdir(parents=True, exist_ok=True)
    with (CAPTURES / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return footage.shot(config, CAPTURES)


@pytest.fixture(scope="session")
def small_capture() -> Path:
    """A folder with ``capture/`` and ``truth/`` of a short, small shoot. Read only."""
    return shot(SMALL)
