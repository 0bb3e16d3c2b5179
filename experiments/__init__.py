"""Hydra apps: the only rooms that know both the estimate and the truth."""

import os
import resource
import signal
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


def _end_when_interrupted() -> None:
    """Have an interrupt end a command at once until `experiments.errors.guard` takes over: while modules are loaded,
    Python passes over a KeyboardInterrupt now and then, and the command would go on."""
    is_command = sys.argv[:1] == ["-m"]  # so until ``python -m`` has found the module
    if is_command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


_check_room()
_end_when_interrupted()

# The work runs in threads of its own; OpenBLAS threads beneath them wait for each other and for the cores. This must be
# said before numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What Rerun's writer has to say when the disk is full, `experiments.errors` says in one line.
os.environ.setdefault("RUST_LOG", "warn,re_sdk=off,re_log_encoding=off")

# Hydra finds its plug-ins by the name of a folder on the path.
sys.path.append(str(Path(__file__).parent / "plugins"))
