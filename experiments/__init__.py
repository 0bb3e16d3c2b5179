"""Hydra apps: the only rooms that know both the estimate and the truth."""

import os
import sys
from pathlib import Path

# The work runs in threads of its own; OpenBLAS threads beneath them wait for each other and for the cores. This must be
# said before numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What Rerun's writer has to say when the disk is full, `experiments.errors` says in one line.
os.environ.setdefault("RUST_LOG", "warn,re_sdk=off,re_log_encoding=off")

# Hydra finds its plug-ins by the name of a folder on the path.
sys.path.append(str(Path(__file__).parent / "plugins"))
