"""`pzcap reconstruct`: a capture folder in, a folder of results out: `reconstruction/`, and `recording.rrd` where the
viewer is installed."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from pzcap.calibration.settings import PanZoomConfig
from pzcap.command.places import NO_RERUN, RECONSTRUCTION, RECORDING, link_capture, load_results
from pzcap.command.progress import ProgressLine
from pzcap.events import Event
from pzcap.extras.reconstruct import Config, stages
from pzcap.io import results
from pzcap.io.capture import read_capture
from pzcap.pipeline import finished
from pzcap.types import Capture, Reconstruction


def reconstruct_folder(folder: Path, out: Path, cameras: Path | None, threads: int, free_tilt: bool) -> int:
    """Reconstruct the capture in ``folder`` into ``out``, and print what was found; the exit status. What ``out`` holds
    of before stays until the new results are whole."""
    config = Config(threads=threads, panzoom=PanZoomConfig(free_tilt=free_tilt))
    known = None if cameras is None else load_results(cameras)
    capture = read_capture(folder)
    out.mkdir(parents=True, exist_ok=True)
    found = _finished(capture, stages(capture, config, known), out)
    results.save(found, out / RECONSTRUCTION)
    link_capture(out, folder)
    print("\n".join(summary(found)))
    print("\n".join(further(out)))
    return 0


def _finished(capture: Capture, events: Iterator[Event], out: Path) -> Reconstruction:
    """Result that ``events`` end with; they are recorded where the viewer is installed."""
    with ExitStack() as stack:
        recorder = None
        if importlib.util.find_spec("rerun") is None:
            print(f"pzcap: no {RECORDING}: {NO_RERUN}", file=sys.stderr)
        else:
            from pzcap.viewer.recording import Recorder

            recorder = stack.enter_context(Recorder(out / RECORDING, capture, name=capture.name))
        with ProgressLine() as line:
            found = finished(events if recorder is None else recorder.recorded(events), line.update)
        if recorder is not None:
            _complete(recorder, found, capture)
        else:
            (out / RECORDING).unlink(missing_ok=True)  # of other results
        return found


def _complete(recorder: object, reconstruction: Reconstruction, capture: Capture) -> None:
    """Send what is known at the end, and the layout."""
    from pzcap.viewer import columns, layouts
    from pzcap.viewer.recording import Recorder

    assert isinstance(recorder, Recorder)
    recorder.drain()
    with recorder.timed() as rec:
        columns.send_reconstruction(rec, reconstruction, capture.subject)
        rec.send_blueprint(layouts.whole(layouts.overview(reconstruction, scored=False), reconstruction))


def further(out: Path) -> Iterator[str]:
    """Lines that say what can be done with the results in ``out``."""
    if (out / RECORDING).is_file():
        yield f"to look at it: rerun {out / RECORDING}"
    yield f"to correct it: pzcap edit {out}"
    yield f"to take it elsewhere: pzcap export {out} --to bvh --out FOLDER"


def summary(found: Reconstruction) -> Iterator[str]:
    """Lines that say what was found and how certain it is."""
    frames = len(found.timecodes)
    yield f"{found.capture_name}: {frames} frame sets from {found.timecodes[0]} to {found.timecodes[-1]}"
    for name, track in zip(found.camera_names, found.tracks, strict=True):
        if track is None:
            yield f"  camera {name}: not calibrated"
            continue
        seen = track.valid
        sigma = np.sqrt(np.einsum("fii->fi", track.covariance[seen]))
        certain = ""
        if seen.any():
            pan, focal = np.rad2deg(np.median(sigma[:, 0])), 100.0 * np.median(sigma[:, 1])
            certain = f"; pan to {pan:.4f} degrees, focal length to {focal:.3f} %"
        yield f"  camera {name}: located in {seen.sum()} of {frames} frames{certain}"
    if found.motion is None:
        yield "  body: not tracked"
    else:
        valid = found.motion.valid
        certain = f"; joints to {1000.0 * np.median(found.motion.sigma_m[valid]):.0f} mm" if valid.any() else ""
        yield f"  body: tracked in {valid.sum()} of {frames} frames{certain}"
    yield from (f"  note: {note}" for note in found.notes)
