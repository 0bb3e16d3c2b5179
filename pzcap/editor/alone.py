"""The editors' folder of a capture, in which one of them works at a time."""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import BinaryIO, Final

from pzcap.types import PzcapError

FOLDER: Final = "editing"  # beside capture.json: what was changed, backups, and what was tracked anew
BACKUPS: Final = "backups"
_LOCK: Final = "lock"


def alone(folder: Path) -> BinaryIO:
    """A file in the editor's ``folder`` of a capture, locked while it is open: nobody else edits this capture.
    PzcapError where somebody does."""
    folder.mkdir(exist_ok=True)
    file = (folder / _LOCK).open("wb")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.close()
        raise PzcapError(f"{folder.parent}: another editor is at work on it; use its page, or end it") from error
    return file
