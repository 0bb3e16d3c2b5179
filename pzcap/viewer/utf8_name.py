"""Paths for a library that takes no names but those of UTF-8."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def with_utf8_name(path: Path) -> Iterator[Path]:
    """``path``, for a library that takes no other names than those of UTF-8: where the folder has another one, by a
    link to it that is gone in the end."""
    if _is_utf8(path):
        yield path
        return
    with tempfile.TemporaryDirectory() as place:
        link = Path(place) / "folder"
        link.symlink_to(path.parent.absolute(), target_is_directory=True)
        yield link / path.name


def _is_utf8(path: Path) -> bool:
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True
