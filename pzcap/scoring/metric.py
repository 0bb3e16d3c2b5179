"""Numbers with a name, a unit and a direction, and the statistics that they are made by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pzcap.types import Array

Direction = Literal["lower", "higher"]


@dataclass(frozen=True, slots=True)
class Metric:
    """One number that a run is judged by. ``value`` is None where the run had not the material for it."""

    key: str
    value: float | None
    unit: str
    direction: Direction = "lower"


def spread(key: str, errors: Array, unit: str) -> list[Metric]:
    """RMS, median, 95th percentile and maximum of errors (N,)."""
    size = np.abs(errors)
    return [
        Metric(f"{key}.rms", rms(errors), unit),
        Metric(f"{key}.median", percentile(size, 50), unit),
        Metric(f"{key}.p95", percentile(size, 95), unit),
        Metric(f"{key}.max", float(size.max()) if size.size else None, unit),
    ]


def rms(values: Array) -> float | None:
    """Root of the mean square; None of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def mean(values: Array) -> float | None:
    """Mean; None of nothing."""
    return float(np.mean(values)) if values.size else None


def percentile(values: Array, percent: float) -> float | None:
    """The value that so many percent lie below; None of nothing."""
    return float(np.percentile(values, percent)) if values.size else None
