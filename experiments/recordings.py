"""Recordings of runs, opened: one that is damaged gets one line, and costs nobody another."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from rerun.chunk import RrdReader

from experiments.errors import explain
from pzcap.io.files import checked
from pzcap.types import PzcapError

T = TypeVar("T")


@contextmanager
def opened(path: Path) -> Iterator[RrdReader]:
    """A recording, to be read in here. Raises PzcapError where it is damaged, whenever that comes out."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # several lines on a recording that was never finished
            yield RrdReader(checked(path))
    except UnicodeEncodeError as error:
        raise PzcapError(f"{path}: Rerun reads no path that is not UTF-8; rename its folder") from error
    except (RuntimeError, ValueError, LookupError) as error:
        first = str(error).partition("\n")[0].replace(f" at {path}", "").replace(str(path), "it")
        raise PzcapError(f"{path}: damaged, or never finished ({first}); make the run again") from error


def check(path: Path) -> None:
    """Raise PzcapError if any part of a recording is damaged: where two are read at once, nobody says which it is."""
    with opened(path) as reader:
        for _ in reader.store().stream():
            pass


def recording_id(path: Path) -> str:
    """The id by which the viewer and a catalog know a recording. Raises PzcapError if it is damaged."""
    with opened(path) as reader:
        ids = [entry.recording_id for entry in reader.recordings()]
        reader.store()  # a recording without its end is not to be served
    if not ids:
        raise PzcapError(f"{path}: holds no recording; make the run again")
    return ids[0]


def readable(paths: Sequence[Path]) -> list[Path]:
    """Those of the recordings that are whole, one of each id: a copied run would be merged with the run itself.

    What is left out gets a line on stderr.
    """
    found: dict[str, Path] = {}

    def add(path: Path) -> None:
        other = found.setdefault(recording_id(path), path)
        if other is not path:
            raise PzcapError(f"{path}: left out, since it is a copy of {other}; make the run again to have both")

    list(each(add, paths))
    return list(found.values())


def each(do: Callable[[Path], T], paths: Iterable[Path]) -> Iterator[T]:
    """``do`` each path; for one at which a PzcapError is raised, its line on stderr, and the others go on."""
    for path in paths:
        try:
            yield do(path)
        except PzcapError as error:
            print(f"error: {explain(error)}", file=sys.stderr, flush=True)
