"""The peak of a part of a process's life."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import memory

MIB = 1024**2


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux forgets a peak")
def test_what_was_given_back_is_not_in_the_next_peak() -> None:
    memory.reset_peak()
    before = memory.peak_mib()
    pieces = [np.ones(MIB // 128) for _ in range(3200)]  # 64 KiB each: of those the allocator keeps what is freed
    grown = memory.peak_mib()
    kept = pieces[::64]
    del pieces
    assert grown > before + 150.0
    assert memory.peak_mib() > grown - 5.0
    memory.reset_peak()
    assert memory.peak_mib() < before + 50.0
    assert len(kept) == 50
