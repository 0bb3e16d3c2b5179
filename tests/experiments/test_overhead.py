"""The overhead of a sweep, measured by its command."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from experiments import overhead
from pzcap.types import PzcapError


def test_the_overhead_of_a_job_is_measured() -> None:
    """All jobs have results, and the table's parts agree: what a job takes is the whole over their number.

    Which sweep took longer is the machine's: a busy one may start two jobs more slowly than four.
    """
    out = io.StringIO()
    overhead.measure(4, "basic", Console(file=out, width=100))
    start_s, whole_s, each_ms, further_ms = (
        float(value) for value in re.findall(r"│ +([-\d.]+) m?s │", out.getvalue())
    )
    assert min(start_s, whole_s) > 0
    assert each_ms == pytest.approx(1e3 * whole_s / 4, abs=30)
    assert further_ms == pytest.approx(1e3 * (whole_s - start_s) / 2, abs=60)


def test_a_launcher_that_is_none_and_too_few_jobs_are_said() -> None:
    with pytest.raises(PzcapError, match=r"0 of 2 jobs have a result: .*nobody"):
        overhead.measure(3, "nobody", Console(file=io.StringIO()))
    with pytest.raises(PzcapError, match="--jobs is 2; give 3 or more"):
        overhead.measure(2, "ray", Console(file=io.StringIO()))
