"""Lock files, which one process holds at a time."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from pzcap.types import PzcapError

POLL_S: Final = 0.1
_NO_LOCKS: Final = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)  # on the file systems of some clusters


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
