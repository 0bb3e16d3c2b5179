"""Work on the cameras by as many processes as there are cores: developing and encoding keep one core busy each."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from pzcap.runtime import free_cores, processes
from pzcap.types import PzcapError

FEW: Final = 300
"""Pictures that one process has sooner than others have started and set up the hall."""

_REPORT_S: Final = 0.25

T = TypeVar("T")
Work = Callable[..., Generator[int, None, T]]
"""``work(cameras, ...)`` yields the number of pictures that are done, and returns what it found."""


class Progress(NamedTuple):
    stage: str
    done: int
    total: int


def side_by_side(stage: str, cameras: int, total: int, work: Work[T], *args: Any) -> Generator[Progress, None, list[T]]:
    """Have ``work(some, *args)`` done for so many ``cameras``, some by each process; yield the progress.

    Return the results, in the order of the cameras. Raises PzcapError if a process was killed.
    """
    count = 1 if total < FEW else min(cameras, free_cores())
    groups = [group.tolist() for group in np.array_split(np.arange(cameras), count)]
    if count == 1:
        steps = work(groups[0], *args)
        while True:
            try:
                done = next(steps)
            except StopIteration as end:
                return [end.value]
            yield Progress(stage, done, total)
    with TemporaryDirectory() as folder, processes(count) as pool:
        path = Path(folder) / "counts"
        counts = np.memmap(path, np.int64, "w+", shape=count)
        jobs = [pool.submit(_counted, path, k, work, group, args) for k, group in enumerate(groups)]
        try:
            while wait(jobs, _REPORT_S, FIRST_EXCEPTION).not_done and not any(_failed(job) for job in jobs):
                yield Progress(stage, int(counts.sum()), total)
            results = [job.result() for job in jobs if job.done()]
        except BrokenProcessPool as error:
            raise PzcapError(
                "a process that films was killed, most often because memory ran out; free some and run again"
            ) from error
    yield Progress(stage, total, total)
    return results


def _failed(job: Any) -> bool:
    return job.done() and job.exception() is not None


def _counted(path: Path, k: int, work: Work[T], cameras: Sequence[int], args: tuple[Any, ...]) -> T:
    counts = np.memmap(path, np.int64, "r+")
    steps = work(cameras, *args)
    while True:
        try:
            counts[k] = next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
