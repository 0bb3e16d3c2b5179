"""Findings of a check."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Level(Enum):
    """Gravity of a finding."""

    OK = "ok"
    WARN = "look"
    FAIL = "again"  # shoot it again


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of a check: how grave, of which camera (none: of all together) and which file, what, and what to do."""

    level: Level
    camera: str
    subject: str
    text: str

    def line(self) -> str:
        """As the terminal shows it."""
        whose = f"camera {self.camera} {self.subject}" if self.camera else self.subject
        return f"{self.level.value:5}  {whose}: {self.text}"


def graded(value: float, warn: float, fail: float) -> Level:
    """The level of a value of which less is better."""
    return Level.FAIL if value > fail else Level.WARN if value > warn else Level.OK


def worst(findings: Iterable[Finding]) -> Level:
    """The gravest level there is."""
    order = list(Level)
    return max((finding.level for finding in findings), key=order.index, default=Level.OK)
