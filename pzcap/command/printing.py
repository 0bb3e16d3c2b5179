"""Standard output and error that take any text."""

from __future__ import annotations

import io
import sys


def print_anything() -> None:
    """Have signs that the terminal's encoding lacks printed as escapes: neither bytes of a folder's name that are not
    UTF-8, nor an accent in locale C, end a command whose work is done."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
