"""A second process that works beside this one: what holds the interpreter's lock would only take turns on a thread.

Every thread that asks has its own.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from typing import Final, ParamSpec, TypeVar

import cv2
from loky import get_reusable_executor
from threadpoolctl import threadpool_limits

from pzcap.heap import give_back
from pzcap.types import PzcapError

_IDLE_S: Final = 20.0  # after so long without work it ends, and gives its memory back; more work starts it again

P = ParamSpec("P")
T = TypeVar("T")


def submit(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
    """Have ``work`` done by the process; jobs are done one after the other. All that goes there and back is copied."""
    if multiprocessing.current_process().daemon:  # such a process may not start another
        done: Future[T] = Future()
        done.set_result(work(*args, **kwargs))
        return done
    executor = _executor()
    future: Future[T] = executor.submit(work, *args, **kwargs)
    executor.submit(_tidy)  # a job of its own: only now nothing of the one before is in use any more
    return future


def taken(future: Future[T]) -> T:
    """What came out, once it has. Raises PzcapError if the process was killed."""
    try:
        return future.result()
    except BrokenProcessPool as error:
        raise PzcapError(
            "the process that solves intervals between keyframes was killed, most often because memory ran out; "
            "free some and run again"
        ) from error


def _executor():  # type: ignore[no-untyped-def]  # loky has no types
    return get_reusable_executor(max_workers=1, timeout=_IDLE_S, initializer=_alone)


def _alone() -> None:
    """This process is to be busy on one core, no more."""
    cv2.setNumThreads(1)
    threadpool_limits(1, "blas")
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _tidy() -> None:
    """Keep nothing while there is no work: what comes next on this side may need the memory."""
    gc.collect()
    give_back()


def _end_with(parent: int) -> None:
    """End when the process that started this one has: one that was killed cannot say so."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
