"""Peak resident memory of a part of this process's life, the processes that it started included."""

from __future__ import annotations

import gc
import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import psutil

from pzcap.runtime import give_back

_EVERY_S: Final = 0.05
_FAMILY: Final = 20
"""Looks after which it is found out anew which processes there are: that takes milliseconds."""


@dataclass(slots=True)
class Peak:
    """The largest sum seen so far."""

    mib: float


@contextmanager
def watched() -> Iterator[Peak]:
    """Look every twentieth of a second while the block runs; the peak is up to date at its end, too.

    What is free is given back to the system before: a shoot leaves 400 MiB of that, and an earlier job of a sweep what
    only the garbage collector finds, and neither is the pipeline's.
    """
    gc.collect()
    give_back()
    peak, enough = Peak(_resident_mib(_family())), threading.Event()

    def keep_looking() -> None:
        for look in itertools.count():
            if look % _FAMILY == 0:
                family = _family()
            peak.mib = max(peak.mib, _resident_mib(family))
            if enough.wait(_EVERY_S):
                return

    watcher = threading.Thread(target=keep_looking, name="memory", daemon=True)
    watcher.start()
    try:
        yield peak
    finally:
        enough.set()
        watcher.join()
        peak.mib = max(peak.mib, _resident_mib(_family()))


def _family() -> list[psutil.Process]:
    """This process and all that descend from it."""
    here = psutil.Process()
    return [here, *here.children(recursive=True)]


def _resident_mib(family: list[psutil.Process]) -> float:
    """Memory held now, together. Libraries that several have loaded count for each of them: never too little."""
    total = 0
    for process in family:
        try:
            total += process.memory_info().rss
        except psutil.Error:  # it has just ended
            continue
    return total / 1024**2
