"""Ranges of settings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.config import AppConfig
from pzcap.types import PzcapError
from sim.ranges import Range, out_of_range
from sim.session import ShootConfig, assemble
from tests.scenes.captures import TINY


@dataclass(frozen=True)
class Inner:
    even: Annotated[int, Range(0, 10, step=2)] = 0
    open: float = 0.0


@dataclass(frozen=True)
class Outer:
    inner: Inner
    share: Annotated[float, Range(0.0, 1.0)] = 0.5


@given(st.floats(), st.integers(-20, 20), st.floats())
def test_what_is_outside_is_named_with_its_place_and_nothing_else_is(share: float, even: int, free: float) -> None:
    found = list(out_of_range(Outer(Inner(even, free), share)))
    expected = []
    if not (0 <= even <= 10 and even % 2 == 0):
        expected.append(f"inner.even is {even}; give a multiple of 2 from 0 to 10")
    if math.isnan(free):
        expected.append("inner.open is not a number; give one")
    if not 0.0 <= share <= 1.0:
        expected.append(f"share is {share}; give from 0 to 1")
    assert found == expected


def test_the_defaults_are_within_their_ranges() -> None:
    assert list(out_of_range(AppConfig())) == []


def test_every_number_of_the_simulator_has_a_range() -> None:
    assert list(_without_range(ShootConfig())) == []


def _without_range(config: Any, path: str = "") -> Iterator[str]:
    hints = get_type_hints(type(config), include_extras=True)
    for field in fields(config):
        value = getattr(config, field.name)
        if is_dataclass(value):
            yield from _without_range(value, f"{path}{field.name}.")
        elif type(value) in (int, float) and not hasattr(hints[field.name], "__metadata__"):
            yield f"{path}{field.name}"


def test_a_picture_that_no_machine_can_draw_is_refused_before_it_is_tried() -> None:
    config = replace(TINY, width=8192, height=6144)
    with pytest.raises(PzcapError, match=r"pictures of \d+ x \d+ px .*, and 16384 is the most"):
        assemble(config).stage()
