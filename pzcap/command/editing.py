"""`pzcap edit`: the editor of keyframes on a capture, with the cameras found first where they are not known yet, and
`pzcap lengths`: the page on which lengths of the hall are marked."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from pzcap.command.places import has_results, load_results, made_of
from pzcap.command.progress import ProgressLine
from pzcap.extras.reconstruct import Config, stages
from pzcap.io import results
from pzcap.io.capture import MANIFEST, frame_sets, read_capture
from pzcap.pipeline import finished
from pzcap.types import Capture, PzcapError, Reconstruction

RECONSTRUCTION = "reconstruction"  # in the editor's folder of a capture: cameras that it has found itself


def edit(place: Path, capture: Path | None, port: int, browse: bool) -> int:
    """Serve the page for the capture in ``place``, or that from which the results in ``place`` were made."""
    _check_server()
    from pzcap.editor.alone import FOLDER, alone
    from pzcap.editor.server import serve
    from pzcap.editor.workspace import Workspace

    if (place / MANIFEST).is_file():
        taken, results_at = read_capture(place), place / FOLDER / RECONSTRUCTION
        with alone(place / FOLDER):  # who may not edit does not wait for the cameras first
            found = _cameras(taken, results_at)
    elif not has_results(place) and capture is None:
        raise PzcapError(f"{place}: neither a {MANIFEST} in it nor a reconstruction; give a capture or RESULTS")
    else:
        found, results_at = load_results(place), place
        taken = read_capture(capture or made_of(place))
    if not any(track is not None and track.valid.any() for track in found.tracks):
        raise PzcapError(f"{place}: no camera was located in any frame; " + "; ".join(found.notes))
    if taken.calibration_object is None:
        print(
            f"{taken.name}: without a calibration object each run finds a world of its own; what tracks from these "
            f"keyframes is pzcap reconstruct {taken.folder} --cameras {results_at} --out OTHER",
            flush=True,
        )
    serve(Workspace(taken, found), port, browse=browse)
    return 0


def mark_lengths(folder: Path, port: int, browse: bool) -> int:
    """Serve the page on which the lengths of the capture in ``folder`` are marked."""
    _check_server()
    from pzcap.editor.marking import serve

    serve(read_capture(folder, without_clocks=True), port, browse=browse)
    return 0


def _check_server() -> None:
    if importlib.util.find_spec("aiohttp") is None:
        raise PzcapError("the editor's server is not installed; pip install 'pzcap[editor]'")


def _cameras(capture: Capture, kept: Path) -> Reconstruction:
    """Reconstruction of a capture before it is edited; made once, and kept."""
    if (kept / results.MANIFEST).is_file():
        found = results.load(kept)
        if found.timecodes == frame_sets(capture).timecodes:
            return found
    print(
        f"{capture.name}: cameras are calibrated and located first, once; later they are taken from {kept}", flush=True
    )
    with ProgressLine() as line:
        found = finished(stages(capture, Config()), line.update)
    results.save(found, kept)
    return found
