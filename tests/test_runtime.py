"""The allocator of this system, told what to do with large arrays; and processes that end when they are told to."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys

import pytest

from pzcap import runtime

# what lives between large arrays that are freed pins them, if they stand among the small ones
SCRIPT = """
import sys
import numpy as np
import psutil
from pzcap.runtime import give_back, keep_heap_small

if sys.argv[1] == "apart":
    keep_heap_small()
taught = np.ones(3_000_000)  # 24 MB: so much glibc learns to keep
del taught
before = psutil.Process().memory_info().rss
kept = []
for _ in range(10):
    large = [np.ones(1_000_000) for _ in range(4)]  # 8 MB each
    kept.append(np.ones(1000))
    del large
print((psutil.Process().memory_info().rss - before) / 2**20)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_large_arrays_go_back_to_the_system_as_soon_as_they_are_free() -> None:
    def grown_mib(how: str) -> float:
        run = [sys.executable, "-c", SCRIPT, how]
        return float(subprocess.run(run, capture_output=True, text=True, check=True).stdout)

    assert grown_mib("apart") < 4.0
    assert grown_mib("among") > 20.0  # else this test could not fail


def test_a_process_that_had_a_worker_ends_before_that_has_been_idle_for_long() -> None:
    # joblib's processes are of this kind: a sweep would end that much later
    process = multiprocessing.get_context("spawn").Process(target=_has_worker)
    process.start()
    process.join(runtime._IDLE_S / 2)
    ended = process.exitcode
    process.kill()
    assert ended == 0


def _has_worker() -> None:
    assert runtime.submit(os.getpid).result() != os.getpid()
