"""Folders that a user means: results, and a recording in them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pzcap.io import results
from pzcap.types import PzcapError, Reconstruction

RECONSTRUCTION: Final = "reconstruction"
RECORDING: Final = "recording.rrd"
NO_RERUN: Final = "the viewer is not installed; pip install 'pzcap[rerun]'"


def load_results(folder: Path) -> Reconstruction:
    """The reconstruction in ``folder``, where a run left one, or that ``folder`` is itself. PzcapError if neither."""
    inside = folder / RECONSTRUCTION
    return results.load(inside if inside.is_dir() else folder)


def recording_in(folder: Path) -> Path:
    """The recording in ``folder``. PzcapError if there is none."""
    path = folder / RECORDING
    if not path.is_file():
        raise PzcapError(
            f"{folder}: no {RECORDING} in it; give the RESULTS of pzcap reconstruct, made with the viewer installed"
        )
    return path
