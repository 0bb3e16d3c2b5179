"""Text from files and folders, as it may be shown: control characters would clear the terminal, or retitle it."""

from __future__ import annotations

import re
from typing import Final

_CONTROLS: Final = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")
"""C0, delete and C1, and the separators of lines and paragraphs."""


def is_plain(text: str) -> bool:
    """True for text of one line without control characters."""
    return _CONTROLS.search(text) is None


def one_line(text: str) -> str:
    """``text`` on one line, control characters as escapes."""
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), " ".join(text.split()))
