"""Files: checked before they are opened, written whole or not at all, locked while one process works with them."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Final

from pzcap.types import PzcapError

POLL_S: Final = 0.1
_NO_LOCKS: Final = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)  # on the file systems of some clusters


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
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def locked(path: Path, busy: str, patience_s: float = 0.0) -> Iterator[None]:
    """Hold the lock file ``path``, which says who does, and remove it in the end.

    The kernel lets go of it when the process dies, so that what a killed one left is taken over. Raises PzcapError,
    which says ``busy`` and who holds the file, where another process still does after ``patience_s``.
    """
    handle = _taken(path, busy, time.monotonic() + patience_s)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held: whoever waits for this one sees that it is not the file there
        os.close(handle)


def _taken(path: Path, busy: str, until: float) -> int:
    us = f"process {os.getpid()} on {socket.gethostname()}"
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if _held(handle):
                holder = os.read(handle, 200).decode(errors="replace")
                if holder == us or time.monotonic() > until:  # nobody outwaits himself
                    raise PzcapError(f"{busy} (it is {holder})" if holder else busy)
            elif _is(path, handle):
                os.truncate(handle, 0)
                os.write(handle, us.encode())
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)
        time.sleep(POLL_S)


def _held(handle: int) -> bool:
    """By another; else it is ours from now on."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    return False


def _is(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False
