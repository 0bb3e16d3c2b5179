"""The first run on a machine, small and thrown away: part of `make setup`.

    python -m experiments.first_run

It shows that everything works here, graphics and codecs included, and leaves what every later run would have to make
first: compiled kernels (Numba keeps them beside the code), and the small capture that tests share.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from experiments.config import CONVERTER, AppConfig
from experiments.errors import guard, reported
from experiments.footage import SMALL
from experiments.run import run
from experiments.terminal import terminal


def _job() -> None:
    config = replace(AppConfig(), shoot=SMALL)
    with reported(), TemporaryDirectory() as folder:
        run(config, CONVERTER.unstructure(config), Path(folder), terminal(stderr=True))


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_job)


if __name__ == "__main__":
    sys.exit(main())
