"""Hydra apps: the only rooms that know both the estimate and the truth."""

import os
import resource
import sys
from pathlib import Path
from typing import Final

ROOM_GIB: Final = 3
"""Address space that the libraries of the commands need to be loaded and used."""


def _check_room() -> None:
    """End with a line where this process may have too little address space: libraries would end with riddles."""
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    if most != resource.RLIM_INFINITY and most < ROOM_GIB * 2**30:
        sys.exit(
            f"error: this process may take {most / 2**30:.1f} GiB of address space, and needs {ROOM_GIB}; raise the "
            f"limit, ulimit -v {ROOM_GIB * 2**20}"
        )


_check_room()

# The work runs in threads of its own; OpenBLAS threads beneath them wait for each other and for the cores. This must be
# said before numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What Rerun's writer has to say when the disk is full, `experiments.errors` says in one line.
os.environ.setdefault("RUST_LOG", "warn,re_sdk=off,re_log_encoding=off")

# Hydra finds its plug-ins by the name of a folder on the path.
sys.path.append(str(Path(__file__).parent / "plugins"))
