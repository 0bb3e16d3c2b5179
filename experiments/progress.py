"""Progress bars on stderr, one a stage, from the (stage, done, total) that long work yields."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

_SAY_S: Final = 5.0  # where no bar can be drawn


class _Count(ProgressColumn):
    """Done of total, or what is done where nobody knows the total."""

    def render(self, task: Task) -> Text:
        of = f"/{task.total:.0f}" if task.total else ""
        return Text(f"{task.completed:.0f}{of}", style="progress.download")


class Bars:
    """A bar for every stage that reports itself, in the order of their first report.

    Stages of one subject ("camera 1: sweep", "camera 1: zoom") follow each other: the next one ends the one before.
    """

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=32),
            _Count(),
            TimeElapsedColumn(),
            console=console,
        )
        self._tasks: dict[str, TaskID] = {}
        self._console, self._said_s = console, time.monotonic()

    def update(self, stage: str, done: int, total: int) -> None:
        """Say how far ``stage`` is; ``total`` 0 if nobody knows."""
        if stage not in self._tasks:
            self._progress.start()  # not before: without a bar it would leave an empty line
            self._end(lambda other: other.partition(":")[0] == stage.partition(":")[0])
            self._tasks[stage] = self._progress.add_task(stage, total=total or None)
        self._progress.update(self._tasks[stage], completed=done, total=total or None)
        if not self._console.is_terminal and time.monotonic() > self._said_s + _SAY_S:  # no bar is drawn there
            self._console.print(f"{stage} {done}/{total}" if total else f"{stage} {done}")
            self._said_s = time.monotonic()

    def __enter__(self) -> Bars:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._tasks:
            return
        if kind is None:
            self._end(lambda _: True)
        self._progress.stop()

    def _end(self, which: Callable[[str], bool]) -> None:
        for task in self._progress.tasks:
            if which(task.description):
                self._progress.update(task.id, total=task.completed)
                self._progress.stop_task(task.id)
