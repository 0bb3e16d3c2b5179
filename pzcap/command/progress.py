"""Progress on stderr: one line that is written over on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Final, TextIO

_WIDTH: Final = 30
_REDRAW_S: Final = 0.1
_SAY_S: Final = 10.0


class ProgressLine:
    """Says how far long work is. Stages may run side by side: the line shows the one that was heard of last."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._start = self._said = time.monotonic()
        self._drawn = 0

    def update(self, stage: str, done: int, total: int) -> None:
        """``done`` of ``total`` of a stage; a total of 0 is not known yet."""
        now = time.monotonic()
        if now - self._said < (_REDRAW_S if self._terminal else _SAY_S):
            return
        self._said = now
        share = f"{done}/{total}" if total else str(done)
        elapsed = f"{int(now - self._start) // 60}:{int(now - self._start) % 60:02}"
        if not self._terminal:
            print(f"{elapsed} {stage} {share}", file=self._stream, flush=True)
            return
        filled = _WIDTH * done // total if total else 0
        line = f"{elapsed} [{'#' * filled}{'.' * (_WIDTH - filled)}] {share} {stage}"
        print(f"\r{line:{self._drawn}}", end="", file=self._stream, flush=True)
        self._drawn = len(line)

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._drawn:
            print(f"\r{'':{self._drawn}}\r", end="", file=self._stream, flush=True)
