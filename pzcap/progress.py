"""Progress of long work, as whoever called for it hears of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

Report: TypeAlias = Callable[[str, int, int], None]
"""Called with a stage, how much of it is done, and of how much (0: not known)."""


def no_report(stage: str, done: int, total: int) -> None:
    """Discard progress."""
