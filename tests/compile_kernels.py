"""Compile the kernels that most tests need: two processes of tests would each compile all of them.

Needs no test tools, so that `make test` runs it while these are installed.

    python -m tests.compile_kernels
"""

from __future__ import annotations

from experiments.footage import SMALL
from pzcap.io.capture import read_capture
from pzcap.pipeline import Config, reconstruct
from tests.scenes.captures import shot

if __name__ == "__main__":
    reconstruct(read_capture(shot(SMALL) / "capture"), Config())
