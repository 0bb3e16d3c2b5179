"""Report of an iterative solver."""

from __future__ import annotations

from typing import NamedTuple


class SolveReport(NamedTuple):
    converged: bool
    steps: int
    cost: float
