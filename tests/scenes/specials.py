"""Paths that are no regular files: pipes, folders, sockets, links to devices."""

from __future__ import annotations

import os
import socket
from contextlib import closing
from pathlib import Path


def make(path: Path, kind: str) -> None:
    """A pipe that nobody writes to, an empty folder, a socket, or a link to a device that has no end."""
    if kind == "a pipe":
        os.mkfifo(path)
    elif kind == "a folder":
        path.mkdir()
    elif kind == "a socket":
        parent = os.open(path.parent, os.O_RDONLY)
        with closing(socket.socket(socket.AF_UNIX)) as one:
            one.bind(f"/proc/self/fd/{parent}/{path.name}")  # the path itself may be longer than a socket's name can be
        os.close(parent)
    else:
        path.symlink_to("/dev/zero")
