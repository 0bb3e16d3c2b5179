"""The processes that do a sweep's jobs end with the sweep: when it is killed, it cannot tell them.

Each looks for it in the process table; and a process of its own, ``python -m experiments.workers PROCESS``, ends what
else a launcher has started and would leave behind, such as the agents of Ray. What a queue such as Slurm's runs, on
this or another machine, goes on.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import cache
from typing import Final

import psutil

SWEEP: Final = "PZCAP_SWEEP"
"""Environment variable, which workers inherit: where the sweep is, and its process."""
POLL_S: Final = 0.5


def announce() -> None:
    """This process is a sweep: those that it starts from now on end with it."""
    mark, quiet = f"{_here()} {os.getpid()}", subprocess.DEVNULL
    if os.environ.get(SWEEP) != mark:
        os.environ[SWEEP] = mark
        line = [sys.executable, "-m", __name__, str(os.getpid())]
        subprocess.Popen(line, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)


def end_with_sweep() -> None:
    """End this process, whatever it does, as soon as the sweep that started it is gone; at once if it is by now."""
    where, _, sweep = os.environ.get(SWEEP, "").rpartition(" ")
    if where == _here() and int(sweep) != os.getpid():
        _watched(int(sweep), os.getpid())


def _here() -> str:
    return f"{socket.gethostname()} {os.environ.get('SLURM_JOB_ID')}"


@cache
def _watched(sweep: int, us: int) -> threading.Thread:  # noqa: ARG001  # a fork has no threads of its parent's
    if not _alive(sweep):
        os._exit(1)
    watch = threading.Thread(target=_outlive, args=(sweep,), name="end with sweep", daemon=True)
    watch.start()
    return watch


def _outlive(sweep: int) -> None:
    while _alive(sweep):
        time.sleep(POLL_S)
    os._exit(1)


def _alive(process: int) -> bool:
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _end_children(sweep: int) -> None:
    """Wait until the sweep is gone, then kill what it, and what it started, had started."""
    started: set[psutil.Process] = set()
    while _alive(sweep):
        with suppress(psutil.NoSuchProcess):
            started |= set(psutil.Process(sweep).children(recursive=True))
        time.sleep(POLL_S)
    for process in started - {psutil.Process()}:
        with suppress(psutil.NoSuchProcess):  # nor is one killed that has the number of another by now
            process.kill()


if __name__ == "__main__":
    _end_children(int(sys.argv[1]))
