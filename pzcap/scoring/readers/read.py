"""Results in whatever format they come."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pzcap.scoring import files
from pzcap.scoring.readers.bvh import read_bvh
from pzcap.scoring.readers.c3d import read_c3d
from pzcap.scoring.readers.colmap import read_colmap
from pzcap.scoring.readers.conventions import Conventions
from pzcap.scoring.readers.soccernet import is_soccernet, read_soccernet
from pzcap.scoring.readers.times import Asked
from pzcap.scoring.readers.trc import read_trc
from pzcap.scoring.records import Results, TrueCapture
from pzcap.scoring.tables import GUIDE
from pzcap.types import PzcapError

BODIES: Final = {".trc": read_trc, ".c3d": read_c3d, ".bvh": read_bvh}
KINDS: Final = "results.json, COLMAP's images.txt, SoccerNet's CAMERA/camera_00000.json, or a .trc, .c3d or .bvh file"


def read(path: Path, truth: TrueCapture | None, said: Conventions) -> Results:
    """The results at ``path``. What other programs wrote needs the ``truth``, for names and number of frames.

    Raises PzcapError, in one line, for everything that they are not.
    """
    if not path.exists():
        raise PzcapError(f"{path}: there is nothing; give a folder with {KINDS}")
    if said != Conventions() and path.suffix.lower() not in BODIES:
        raise PzcapError(f"{path}: --joints, --axes, --unit, --first-frame and --rate are of TRC, C3D and BVH; this is "
                         "none, leave them out and write what docs/benchmark.md says")  # fmt: skip
    if (path / files.HEADER).exists():
        return files.read_results(path)
    reader = BODIES.get(path.suffix.lower())
    colmap = (path / "images.txt").exists()
    if reader is None and not colmap and not is_soccernet(path):
        for table in (files.CAMERAS, files.BODY):
            if path.name == table or (path / table).exists():
                raise _alone(path, table)
        below = sorted(path.glob(f"*/{files.HEADER}"))
        which = f"; {below[0].parent} is one" if below else ""
        raise PzcapError(f"{path}: give a folder with {KINDS}{which}")
    if truth is None:
        raise PzcapError(f"{path}: says not how many frames and cameras there are; give the truth as well")
    frames, names = len(truth.timecodes), truth.camera_names
    body = None if reader is None else reader(path, Asked(frames, truth.frame_rate), said)
    tracks = (None,) * len(names) if reader else (read_colmap if colmap else read_soccernet)(path, names, frames)
    return Results(path.stem, truth.name, frames, None, None, names, tracks, body)


def _alone(path: Path, table: str) -> PzcapError:
    """The error about a table of ours without its header."""
    folder = path.parent if path.name == table else path
    remedy = f"give the folder, {folder}" if (folder / files.HEADER).exists() else f"write {files.HEADER} beside it"
    return PzcapError(f"{path}: {table} alone says not of how many frames and cameras; {remedy} ({GUIDE})")
