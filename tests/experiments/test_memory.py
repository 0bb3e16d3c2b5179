"""The peak of a part of a process's life."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from experiments import memory

MIB = 1024**2
IN_ANOTHER = "import sys; held = b'1' * (200 << 20); print(len(held), flush=True); sys.stdin.read()"


def test_what_was_given_back_is_in_this_peak_and_not_in_the_next() -> None:
    with memory.watched() as first:
        before = first.mib
        pieces = [np.ones(MIB // 128) for _ in range(3200)]  # 64 KiB each: of those the allocator keeps what is freed
    kept = pieces[::64]
    del pieces
    assert first.mib > before + 150.0
    with memory.watched() as second:
        pass
    assert second.mib < before + 50.0
    assert len(kept) == 50


def test_what_another_process_holds_that_was_started_here_counts() -> None:
    with memory.watched() as alone:
        pass
    with subprocess.Popen([sys.executable, "-c", IN_ANOTHER], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline().strip() == b"209715200"
        with memory.watched() as both:
            pass
        other.communicate()
    assert both.mib > alone.mib + 200.0
