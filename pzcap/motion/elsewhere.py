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
from concurrent.futures import Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Final, ParamSpec, TypeAlias, TypeVar

import cv2
from loky import get_reusable_executor

from pzcap.heap import give_back, set_large_apart
from pzcap.types import PzcapError

_SENDING_S: Final = 1.0  # by then a job has been sent
_ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
"""Of linear algebra. Told before it is loaded: numpy and scipy bring one library each, and load theirs when they need
it. A thread that the other process leaves no core for keeps its fellows waiting for a tenth of a second."""
_IDLE_S: Final = 20.0  # after so long without work it ends, and gives its memory back; more work starts it again

P = ParamSpec("P")
T = TypeVar("T")
Job: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
"""What to call, and with what."""


def submit(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
    """Have ``work`` done by the process; jobs are done one after the other. All that goes there and back is copied."""
    if multiprocessing.current_process().daemon:  # such a process may not start another
        done: Future[T] = Future()
        done.set_result(work(*args, **kwargs))
        return done
    future: Future[T] = _executor().submit(_done, _Parcel((work, args, kwargs)))
    return future


def taken(future: Future[T]) -> T:
    """What came out, once it has. Raises PzcapError if the process was killed."""
    try:
        if not wait([future], _SENDING_S).done:
            give_back()  # what was sent, now that it is
        return future.result()
    except BrokenProcessPool as error:
        raise PzcapError(
            "the process that solves intervals between keyframes was killed, most often because memory ran out; "
            "free some and run again"
        ) from error


def _executor():  # type: ignore[no-untyped-def]  # loky has no types
    return get_reusable_executor(
        max_workers=1, timeout=_IDLE_S, initializer=_alone, initargs=(os.getpid(),), env=_ONE_THREAD
    )


def _alone(parent: int) -> None:
    """This process is to be busy on one core, no more, to be small, and to end with the one that started it."""
    set_large_apart()
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


class _Parcel:
    """A job on its way. Once it has been sent there is nothing in it: the executor keeps it until the job is done, and
    an interval's cut-outs come to a megabyte a frame set."""

    def __init__(self, job: Job) -> None:
        self._job: Job | None = job

    def take(self) -> Job:
        assert self._job is not None, "a parcel is opened once"
        job, self._job = self._job, None
        return job

    def __reduce__(self) -> tuple[type[_Parcel], tuple[Job]]:
        return _Parcel, (self.take(),)


def _done(parcel: _Parcel) -> Any:
    """The job is done, and nothing of it kept: whoever works on the other side may need the memory."""
    work, args, kwargs = parcel.take()
    done = work(*args, **kwargs)
    del work, args, kwargs
    gc.collect()
    give_back()
    return done


def _end_with(parent: int) -> None:
    """End when the process that started this one has: one that was killed cannot say so."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
