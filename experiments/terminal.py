"""The terminal, as every command prints to it."""

from __future__ import annotations

from typing import Any

from rich.console import Console


def terminal(**how: Any) -> Console:
    """A console that takes text for text: brackets and colons in the name of a camera or a folder are no markup.

    What is to be coloured is given as `rich.text.Text`. ``how``: as for `rich.console.Console`.
    """
    return Console(markup=False, emoji=False, **how)
