"""Side effects on the process: threads of linear algebra and OpenCV, the memory allocator, the worker process.

Nothing else in the library changes a setting of the whole process or starts another one.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache, partial
from multiprocessing.util import Finalize
from typing import Any, Final, ParamSpec, TypeVar

import cv2
from loky import ProcessPoolExecutor, cpu_count, get_reusable_executor
from threadpoolctl import threadpool_limits

from pzcap.types import PzcapError

_MMAP_THRESHOLD: Final = -3  # glibc's numbers of these settings, in its malloc.h
_ARENA_MAX: Final = -8
_LARGE_BYTES: Final = 4 << 20
_SENDING_S: Final = 1.0  # by then a job has been sent
_ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
"""Of linear algebra. Told before it is loaded: numpy and scipy bring one library each, and load theirs when they need
it. A thread that the other process leaves no core for keeps its fellows waiting for a tenth of a second."""
_IDLE_S: Final = 20.0  # after so long without work it ends, and gives its memory back; more work starts it again

P = ParamSpec("P")
T = TypeVar("T")


# --------------------------------------------------------------------------------------------------------------
# Threads


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Limit BLAS and OpenCV to one thread each: what works side by side are our own threads, theirs would only take
    turns with them."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        cv2.setNumThreads(before)


# --------------------------------------------------------------------------------------------------------------
# Memory: arrays of a hundred sizes, from several threads, leave holes in glibc's heap


def keep_heap_small() -> None:
    """Have what is large mapped by itself from now on in this process, and given back as soon as it is free; and one
    heap for all threads.

    Left alone, glibc learns from every large array that is freed to keep the next ones, up to 32 MiB, among the small
    ones. What is small and lives on between them then holds hundreds of MiB, more with every job of a sweep. A heap of
    each thread's own held another 50, and saved no time.
    """
    if (set_option := _glibc("mallopt")) is not None:
        set_option(_MMAP_THRESHOLD, _LARGE_BYTES)
        set_option(_ARENA_MAX, 1)


def give_back() -> None:
    """Let the system have what is free: where several threads work, glibc keeps hundreds of MiB of it."""
    if (trim := _glibc("malloc_trim")) is not None:
        trim(0)


def _glibc(name: str) -> Any | None:
    """A function that glibc alone has; None on any other system."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


# --------------------------------------------------------------------------------------------------------------
# The worker: a second process that works beside this one; what holds the interpreter's lock would only take turns on a
# thread. Every thread that asks has its own.


def submit(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
    """Have ``work`` done by the process; jobs are done one after the other. All that goes there and back is copied."""
    if multiprocessing.current_process().daemon:  # such a process may not start another
        done: Future[T] = Future()
        done.set_result(work(*args, **kwargs))
        return done
    future: Future[T] = _executor().submit(_done, _Parcel(partial(work, *args, **kwargs)))
    return future


def taken(future: Future[T]) -> T:
    """Wait for the result of a job. Raises PzcapError if the process was killed."""
    try:
        if not wait([future], _SENDING_S).done:
            give_back()  # what was sent, now that it is
        return future.result()
    except BrokenProcessPool as error:
        raise PzcapError(
            "the process that solves intervals between keyframes was killed, most often because memory ran out; "
            "free some and run again"
        ) from error


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """So many processes for work that is of one piece each. They end with the block, however it ends, or with us."""
    pool = ProcessPoolExecutor(count, initializer=_alone, initargs=(os.getpid(),), env=_ONE_THREAD)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, kill_workers=True)


def free_cores() -> int:
    """Cores that this process may use; 1 where it may not start another."""
    return 1 if multiprocessing.current_process().daemon else cpu_count()


def _executor():  # type: ignore[no-untyped-def]  # loky has no types
    # a job that comes just as the process ends for idleness gets another; one that was killed is told by `taken`
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning, "loky")
    executor = get_reusable_executor(
        max_workers=1, timeout=_IDLE_S, initializer=_alone, initargs=(os.getpid(),), env=_ONE_THREAD
    )
    _ended_at_exit(executor)
    return executor


@cache
def _ended_at_exit(executor: ProcessPoolExecutor) -> Finalize:
    """End the executor's process with this one, where this one is a process of `multiprocessing`: a job of a sweep.

    Such a process first waits for all that it has started, and the executor's ends when it has been idle.
    """
    return Finalize(None, executor.shutdown, kwargs={"kill_workers": True}, exitpriority=0)


def _alone(parent: int) -> None:
    """This process is to be busy on one core, no more, to be small, and to end with the one that started it."""
    keep_heap_small()
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


class _Parcel:
    """A job on its way. Once it has been sent there is nothing in it: the executor keeps it until the job is done, and
    an interval's cut-outs come to a megabyte a frame set."""

    def __init__(self, job: Callable[[], Any]) -> None:
        self._job: Callable[[], Any] | None = job

    def take(self) -> Callable[[], Any]:
        assert self._job is not None, "a parcel is opened once"
        job, self._job = self._job, None
        return job

    def __reduce__(self) -> tuple[type[_Parcel], tuple[Callable[[], Any]]]:
        return _Parcel, (self.take(),)


def _done(parcel: _Parcel) -> Any:
    """The job is done, and nothing of it kept: whoever works on the other side may need the memory."""
    done = parcel.take()()
    gc.collect()
    give_back()
    return done


def _end_with(parent: int) -> None:
    """End when the process that started this one has: one that was killed cannot say so."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
