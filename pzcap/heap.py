"""Memory that is free, and that the allocator holds on to."""

from __future__ import annotations

import ctypes
import sys


def give_back() -> None:
    """Let the system have what is free: where several threads work, glibc keeps hundreds of MiB of it."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:  # glibc alone has it
        trim(0)
