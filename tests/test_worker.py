"""The process that works beside this one."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import weakref
from multiprocessing.connection import Connection

import numpy as np
import psutil
import pytest
from threadpoolctl import threadpool_info

from pzcap.runtime import _ONE_THREAD, _executor, submit, taken
from pzcap.types import Array, PzcapError

WAITING = """
import os, time
from pzcap import runtime
print(runtime.submit(os.getpid).result(), flush=True)
time.sleep(60)
"""


def test_work_is_done_by_another_process() -> None:
    assert taken(submit(os.getpid)) != os.getpid()


def test_jobs_are_done_one_after_the_other() -> None:
    jobs = [submit(os.getpid) for _ in range(4)]
    assert len({taken(job) for job in jobs}) == 1


def test_what_goes_wrong_there_is_raised_here() -> None:
    with pytest.raises(ZeroDivisionError):
        taken(submit(divmod, 1, 0))


def test_a_process_that_was_killed_is_a_clear_error_and_the_next_job_starts_another() -> None:
    worker = taken(submit(os.getpid))
    working = submit(time.sleep, 60.0)
    os.kill(worker, signal.SIGKILL)
    with pytest.raises(PzcapError, match="memory"):
        taken(working)
    assert taken(submit(abs, -3)) == 3


def test_it_ends_when_it_has_nothing_to_do_and_the_next_job_starts_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pzcap.runtime._IDLE_S", 0.2)
    first = taken(submit(os.getpid))
    psutil.Process(first).wait(20.0)  # raises if it is still there
    assert taken(submit(os.getpid)) not in (first, os.getpid())


def test_it_ends_when_whoever_started_it_was_killed() -> None:
    with subprocess.Popen([sys.executable, "-c", WAITING], stdout=subprocess.PIPE, text=True) as user:
        assert user.stdout is not None
        worker = psutil.Process(int(user.stdout.readline()))
        user.kill()
    worker.wait(20.0)  # raises if it is still there


def test_linear_algebra_has_one_thread_there_whenever_it_was_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in _ONE_THREAD:
        monkeypatch.delenv(name, raising=False)
    _executor().shutdown(wait=True)  # so that one is started from here on
    libraries = taken(submit(_linear_algebra))
    assert len(libraries) > 1  # numpy's, and scipy's, which is loaded by the job
    assert set(libraries.values()) == {1}


def _linear_algebra() -> dict[str, int]:
    """How many threads each library has."""
    importlib.import_module("scipy.linalg")
    return {library["filepath"]: library["num_threads"] for library in threadpool_info()}


def test_a_process_that_may_start_none_does_the_work_itself() -> None:
    here, there = multiprocessing.get_context("spawn").Pipe(duplex=False)
    daemon = multiprocessing.get_context("spawn").Process(target=_work_in, args=(there,), daemon=True)
    daemon.start()
    assert here.recv() == daemon.pid
    daemon.join()


def _work_in(answer: Connection) -> None:
    answer.send(taken(submit(os.getpid)))


def test_it_keeps_no_memory_of_a_job_that_is_done() -> None:
    worker = psutil.Process(taken(submit(os.getpid)))
    before = worker.memory_info().rss
    assert taken(submit(_entangled, 100)) == 100
    assert worker.memory_info().rss < before + 30 * 2**20


def _entangled(mib: int) -> int:
    """Take so much memory for what only the garbage collector will find."""
    ring: list[object] = [bytearray(b"1" * mib * 2**20)]
    ring.append(ring)
    return mib


def test_what_was_sent_is_let_go_while_the_job_goes_on() -> None:
    taken(submit(os.getpid))
    sent = np.ones(100)
    gone = weakref.ref(sent)
    working = submit(_slow_sum, sent)
    del sent
    for _ in range(100):
        if gone() is None:
            break
        time.sleep(0.02)
    assert gone() is None
    assert not working.done()
    assert taken(working) == 100.0


def _slow_sum(numbers: Array) -> float:
    time.sleep(2.0)
    return float(numbers.sum())
