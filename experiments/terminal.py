"""The terminal, as every command is given there, and prints to it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text


def command_line(name: str, about: str | None) -> argparse.ArgumentParser:
    """Arguments of ``python -m experiments.NAME``; its help is ``about``, the module's docstring, as it stands."""
    raw = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(prog=f"python -m experiments.{name}", description=about, formatter_class=raw)


def terminal(**how: Any) -> Console:
    """A console that takes text for text: brackets and colons in the name of a camera or a folder are no markup.

    What is to be coloured is given as `rich.text.Text`. ``how``: as for `rich.console.Console`.
    """
    return Console(markup=False, emoji=False, **how)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str | Text]], *, plain: bool = False) -> Table:
    """A table of ``rows``. A column whose name begins with ``>`` is of numbers: it stands to the right.

    ``plain``: without a frame, which a log file has no room for. `print_whole` keeps its lines whole.
    """
    shown = Table(
        title=Text(title), title_justify="left", header_style="bold", box=box.SIMPLE if plain else box.HEAVY_HEAD
    )
    for name in columns:
        justify: Literal["left", "right"] = "right" if name.startswith(">") else "left"
        shown.add_column(Text(name.removeprefix(">")), justify=justify, no_wrap=True)
    for row in rows:
        shown.add_row(*row)
    return shown


def print_whole(console: Console, shown: Table) -> None:
    """Print ``shown`` with no cell cut or wrapped: a line that is wider than ``console`` beats one without its end."""
    unbounded = console.options.update(max_width=sys.maxsize)
    console.width = max(console.width, console.measure(shown, options=unbounded).maximum)
    console.print(shown)
