"""The small capture and the pipeline's compiled kernels, which most tests wait for.

`make test` makes them while the checks run, which leave a core free.
"""

from __future__ import annotations

from experiments.footage import SMALL
from pzcap.io.capture import read_capture
from pzcap.pipeline import Config, reconstruct
from tests.scenes.captures import shot

if __name__ == "__main__":
    reconstruct(read_capture(shot(SMALL) / "capture"), Config())
