"""Ranges of settings: they stand in the annotation of the field, ``width: Annotated[int, Range(32, 8192, step=2)]``."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, get_type_hints


@dataclass(frozen=True, slots=True)
class Range:
    """Values that a setting may have, both ends included; ``step``: multiples of it alone."""

    low: float
    high: float
    step: float | None = None

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high and (self.step is None or value % self.step == 0.0)

    def __str__(self) -> str:
        multiple = "" if self.step is None else f"a multiple of {self.step:g} "
        low, high = (f"{end:.0f}" if end == round(end) else f"{end:g}" for end in (self.low, self.high))
        return f"{multiple}from {low} to {high}"


Share = Annotated[float, Range(0.0, 1.0)]
Degrees = Annotated[float, Range(0.0, 360.0)]
Metres = Annotated[float, Range(0.0, 100.0)]
Seconds = Annotated[float, Range(0.0, 3600.0)]
Pixels = Annotated[float, Range(0.0, 1000.0)]


def out_of_range(settings: Any, path: str = "") -> Iterator[str]:
    """A sentence for each number in ``settings``, a dataclass of them, that is outside its range or not a number."""
    hints = get_type_hints(type(settings), include_extras=True)
    for field in fields(settings):
        value, key = getattr(settings, field.name), f"{path}{field.name}"
        ranges = [each for each in getattr(hints[field.name], "__metadata__", ()) if isinstance(each, Range)]
        if is_dataclass(value):
            yield from out_of_range(value, f"{key}.")
        elif any(value not in each for each in ranges):
            yield f"{key} is {value}; give {ranges[0]}"
        elif isinstance(value, float) and math.isnan(value):
            yield f"{key} is not a number; give one"
