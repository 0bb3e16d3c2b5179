"""Other programs in environments of their own (`make test-clients`): they want other versions of libraries."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Final

from pzcap.types import PzcapError

HERE: Final = Path(__file__).parent
_QUIET: Final = {"MPLBACKEND": "Agg", "QT_QPA_PLATFORM": "offscreen", "PYTHONPATH": ""}


def environments() -> Path:
    """The folder that holds them."""
    return Path(os.environ.get("PZCAP_CLIENTS", HERE.parents[2] / ".clients"))


def installed(client: str) -> bool:
    """True where a program has its environment."""
    return python(client).is_file()


def run(client: str, script: Path, *arguments: object, folder: Path) -> str:
    """What a script says in the environment of a program. Raises PzcapError with its last line where it fails."""
    line = [str(python(client)), str(script), *map(str, arguments)]
    done = subprocess.run(line, cwd=folder, env={**os.environ, **_QUIET}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise PzcapError(f"{client}: {(done.stderr.strip().splitlines() or ['it failed'])[-1]}")
    return done.stdout.strip()


def python(client: str) -> Path:
    return environments() / client / "bin" / "python"
