"""Files: checked before they are opened, written whole or not at all."""

from __future__ import annotations

import json
import os
import resource
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Final

from pzcap.types import PzcapError

_ROOM_BYTES: Final = 2**28  # a decoder's threads ask for some hundred MiB at once


def leads_out(name: str) -> bool:
    """True where a path that a file names leaves the folder of that file. Links that were made in there do not
    count."""
    path = PurePosixPath(name)
    return path.is_absolute() or ".." in path.parts


def checked(path: Path) -> Path:
    """``path``, before it is opened: a pipe would be waited for without end, and a device is no footage.

    What is not there passes, since whoever opens it says so. Raises PzcapError for all but a file or a link to one.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return path
    if not stat.S_ISREG(mode):
        kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
        kind = next((name for matches, name in kinds if matches(mode)), "a device")
        raise PzcapError(f"{path}: is {kind}, not a file; put the file itself in its place")
    return path


def memory_ran_out(refused: bool = False) -> bool:
    """True where the address space that this process may have (``ulimit -v``) is all but taken: libraries in C say
    that a file is damaged when they cannot have more.

    ``refused``: memory was asked for and not given. Where nothing limits it, nobody has as much: the file asks for it.
    """
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    if sys.platform != "linux" or most == resource.RLIM_INFINITY:
        return False
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    return refused or taken > most - _ROOM_BYTES


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a path beside ``path`` to write to, and move what stands there to ``path`` in the end, once the disk has it.

    Nobody ever sees half a file: where the writer fails or is killed, ``path`` stays as it was.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        yield partial
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        if error.filename == str(partial):  # nobody knows that name
            error.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> Path:
    """Write a file, whole or not at all; the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as partial:
        partial.write_bytes(content)
    return path


def write_json(path: Path, content: object, indent: int | None = 1) -> Path:
    """Write a JSON file as people read it, or without ``indent`` as small as it is, whole or not at all. Text that no
    UTF-8 holds, such as bytes of a foreign file name, is escaped, and read again as the same."""
    between = (",", ":") if indent is None else None
    text = json.dumps(content, indent=indent, ensure_ascii=False, separators=between) + "\n"
    return write_bytes(path, text.encode(errors="backslashreplace"))
