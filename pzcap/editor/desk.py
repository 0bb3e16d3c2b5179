"""The desk at which all pages work: one workspace, the threads that work on it, and the pages that are told."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, TypeVar

from pzcap.editor import showing
from pzcap.editor.showing import Json
from pzcap.editor.workspace import Workspace
from pzcap.types import PzcapError

_REPORT_S: Final = 0.2

T = TypeVar("T")


class Desk:
    """Work on ``workspace`` beside the server's loop; ``tell_all`` tells every page."""

    def __init__(self, workspace: Workspace, tell_all: Callable[[Json], Awaitable[None]]) -> None:
        self.workspace, self._tell_all = workspace, tell_all
        self._solving: threading.Event | None = None  # set to stop what is being tracked
        self._tasks: set[asyncio.Task[None]] = set()
        self._hands = ThreadPoolExecutor(1, "hands")  # poses, one after the other
        self._eyes = ThreadPoolExecutor(2, "eyes")  # pictures
        self._legs = ThreadPoolExecutor(1, "legs")  # tracking anew

    def close(self) -> None:
        """Stop all work."""
        self.stop_solving()
        for pool in (self._hands, self._eyes, self._legs):
            pool.shutdown(wait=False, cancel_futures=True)

    async def pose(self, work: Callable[..., T], *arguments: Any) -> T:
        """Do what poses the body, one after the other."""
        return await asyncio.get_running_loop().run_in_executor(self._hands, work, *arguments)

    async def look(self, work: Callable[..., T], *arguments: Any) -> T:
        """Do what takes pictures, beside the poses."""
        return await asyncio.get_running_loop().run_in_executor(self._eyes, work, *arguments)

    async def changed(self, frame: int) -> None:
        """Tell every page what has changed."""
        shown, overview = await self.pose(self._state, frame)
        await self._tell_all({"shown": shown, "overview": overview})

    def _state(self, frame: int) -> tuple[Json, Json]:
        return showing.frame(self.workspace, frame), showing.overview(self.workspace)

    async def solve(self, frame: int) -> None:
        """Track the interval around a frame anew, beside everything else."""
        if self._solving is not None:
            raise PzcapError("an interval is being solved already")
        self._solving = stop = threading.Event()
        loop, said = asyncio.get_running_loop(), [0.0]

        def report(done: int, total: int) -> None:
            now = time.monotonic()
            if now - said[0] > _REPORT_S:
                said[0] = now
                loop.call_soon_threadsafe(self._say, {"solving": [done, total]})

        async def work() -> None:
            try:
                await self._tell_all({"solving": [0, 1]})
                await loop.run_in_executor(self._legs, self.workspace.solve_again, frame, report, stop.is_set)
                await self._tell_all({"solving": None, "done": "solved again"})
                await self.changed(frame)
            except PzcapError as error:
                await self._tell_all({"solving": None, "error": str(error)})
            except Exception as error:
                await self._tell_all({"solving": None, "error": f"solving failed: {type(error).__name__}: {error}"})
                raise
            finally:
                self._solving = None

        self._begin(work())

    def _say(self, message: Json) -> None:
        self._begin(self._tell_all(message))

    def _begin(self, work: Awaitable[None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def stop_solving(self) -> None:
        """Stop what is being tracked after its present frame."""
        if self._solving is not None:
            self._solving.set()
