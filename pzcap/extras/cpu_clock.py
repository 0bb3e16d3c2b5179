"""CPU time of this process and of its worker (`pzcap.runtime`)."""

from __future__ import annotations

import os
import time
from typing import NamedTuple

from pzcap.runtime import submit, taken


class CpuClock(NamedTuple):
    """CPU seconds of this process and of its worker at one time; ``worker`` is its process and its seconds."""

    own: float
    worker: tuple[int, float]

    def seconds(self) -> float:
        """CPU seconds that both have taken since; a worker that was started since then counts from its start."""
        now = cpu_clock()
        since = self.worker[1] if now.worker[0] == self.worker[0] != os.getpid() else 0.0
        return now.own - self.own + (0.0 if now.worker[0] == os.getpid() else now.worker[1] - since)


def cpu_clock() -> CpuClock:
    """Read the CPU time of this process and its worker, which is started where there is none."""
    worker = taken(submit(_cpu_seconds))
    return CpuClock(time.process_time(), worker)


def _cpu_seconds() -> tuple[int, float]:
    return os.getpid(), time.process_time()
