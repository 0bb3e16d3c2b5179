"""Folders that a user means: results, and a recording in them."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Final

from pzcap.io import results
from pzcap.io.capture import MANIFEST
from pzcap.types import PzcapError, Reconstruction

RECONSTRUCTION: Final = "reconstruction"
RECORDING: Final = "recording.rrd"
CAPTURE: Final = "capture"  # in results: a link to the capture folder that they were made of
NO_RERUN: Final = "the viewer is not installed; pip install 'pzcap[rerun]'"


def load_results(folder: Path) -> Reconstruction:
    """The reconstruction in ``folder``, where a run left one, or that ``folder`` is itself. PzcapError if neither."""
    if not has_results(folder) and (folder / MANIFEST).is_file():
        raise PzcapError(f"{folder}: a capture, not results; run pzcap reconstruct {folder} --out RESULTS first")
    return results.load(_reconstruction(folder))


def has_results(folder: Path) -> bool:
    """True if ``folder`` holds anything that `load_results` would read."""
    return (_reconstruction(folder) / results.MANIFEST).is_file()


def _reconstruction(folder: Path) -> Path:
    inside = folder / RECONSTRUCTION
    return inside if inside.is_dir() else folder


def recording_in(folder: Path) -> Path:
    """The recording in ``folder``. PzcapError if there is none."""
    path = folder / RECORDING
    if not path.is_file():
        raise PzcapError(
            f"{folder}: no {RECORDING} in it; give the RESULTS of pzcap reconstruct, made with the viewer installed"
        )
    return path


def link_capture(folder: Path, capture: Path) -> None:
    """Leave a link in the results ``folder`` to the ``capture`` that they are made of, where the disk knows links."""
    link = folder / CAPTURE
    if folder.resolve() == capture.resolve():
        return
    if link.is_symlink():
        link.unlink()
    if not link.exists():
        with contextlib.suppress(OSError):
            link.symlink_to(os.path.relpath(capture.resolve(), folder.resolve()), target_is_directory=True)


def made_of(folder: Path) -> Path:
    """The capture folder that the results in ``folder`` were made of. PzcapError where they do not tell."""
    place = folder.parent if folder.name == RECONSTRUCTION else folder
    for capture in (place / CAPTURE, place / CAPTURE / CAPTURE):  # the latter where a truth lies beside it
        if (capture / MANIFEST).is_file():
            return capture.resolve()
    raise PzcapError(f"{folder}: it does not tell which capture it was made of; give --capture FOLDER")
