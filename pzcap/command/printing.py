"""Standard output and error that take any text."""

from __future__ import annotations

import io
import os
import sys


def print_anything() -> None:
    """Have signs that the terminal's encoding lacks printed as escapes: neither bytes of a folder's name that are not
    UTF-8, nor an accent in locale C, end a command whose work is done.

    Streams that the caller has closed (``>&-``) are opened to nowhere: the next file would take their place, and what a
    library prints would be written into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
