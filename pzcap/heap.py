"""What the allocator does with memory: arrays of a hundred sizes, from several threads, leave holes in it."""

from __future__ import annotations

import ctypes
import sys
from typing import Any, Final

_MMAP_THRESHOLD: Final = -3  # glibc's number of that setting, in its malloc.h
_LARGE_BYTES: Final = 4 << 20


def set_large_apart() -> None:
    """Have what is large mapped by itself from now on in this process, and given back as soon as it is free.

    Left alone, glibc learns from every large array that is freed to keep the next ones, up to 32 MiB, among the small
    ones. What is small and lives on between them then holds hundreds of MiB, more with every job of a sweep.
    """
    if (set_option := _glibc("mallopt")) is not None:
        set_option(_MMAP_THRESHOLD, _LARGE_BYTES)


def give_back() -> None:
    """Let the system have what is free: where several threads work, glibc keeps hundreds of MiB of it."""
    if (trim := _glibc("malloc_trim")) is not None:
        trim(0)


def _glibc(name: str) -> Any | None:
    """A function that glibc alone has; None on any other system."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
