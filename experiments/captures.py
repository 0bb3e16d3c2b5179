"""Footage that is kept, and the room that it takes: captures, and the light that they were developed from.

    python -m experiments.captures                     # a table, what was used last at first
    python -m experiments.captures --remove light      # or captures, or all

Whatever is removed is shot again when a run asks for it. Light beyond ``output.light_gb`` goes by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.config import AppConfig
from experiments.errors import guard
from experiments.terminal import command_line, table, terminal
from sim.capture_cache import Kept, kept, remove


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    parser = command_line("captures", __doc__)
    parser.add_argument("--folder", type=Path, default=Path(AppConfig().output.captures), help="where they are kept")
    parser.add_argument("--remove", choices=("light", "captures", "all"), help="what to remove")
    options = parser.parse_args(arguments)
    return guard(lambda: _captures(options.folder, options.remove))


def _captures(folder: Path, unwanted: str | None) -> None:
    found = kept(folder)
    gone = [one for one in found if unwanted in ("all", "light" if one.is_light else "captures")]
    for one in gone:
        remove(one.folder)
    rows = [
        ("light" if one.is_light else "capture", one.folder.name, f"{one.size_bytes / 1e6:.0f}", _ago(one.used_s))
        for one in found
        if one not in gone
    ]
    console = terminal()
    if gone:
        console.print(f"removed {len(gone)}, {_gigabytes(gone)}")
    left = [one for one in found if one not in gone]
    console.print(table(f"{folder}: {_gigabytes(left)}", ("kind", "name", ">MB", "used"), rows))


def _gigabytes(some: Sequence[Kept]) -> str:
    return f"{sum(one.size_bytes for one in some) / 1e9:.2f} GB"


def _ago(seconds: float) -> str:
    for size, unit in ((86400.0, "days"), (3600.0, "hours"), (60.0, "minutes")):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit} ago"
    return "just now"


if __name__ == "__main__":
    sys.exit(main())
