"""The harness: what a comparison leaves, also where it does not come to its end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from experiments.comparisons.harness import Column, Comparison, Row, execute
from experiments.config import AppConfig
from pzcap.types import PzcapError


def test_the_rows_that_there_are_stay_where_a_later_one_fails(tmp_path: Path) -> None:
    def rows(*_: object) -> Iterator[Row[None]]:
        yield Row("one", "one", {"error": 1.0})
        raise PzcapError("the second cannot be")

    comparison: Comparison[None] = Comparison("kept", (Column("error", "error", "mm"),), rows, "floor_exercise")
    with pytest.raises(PzcapError):
        execute(comparison, AppConfig(), {}, tmp_path, Console(quiet=True))
    assert (tmp_path / "kept.csv").read_text().splitlines() == ["group,key,label,error [mm]", ",one,one,1.0"]
    assert not (tmp_path / "metrics.json").exists()
