"""`pzcap sync`: how cameras without timecode lie to each other, into sync.json, which capture.json then names."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.command.check.reference_check import check_reference
from pzcap.command.progress import ProgressLine
from pzcap.io.capture import MANIFEST, read_capture, read_image
from pzcap.io.clocks import SYNC_FORMAT, SYNC_VERSION
from pzcap.io.files import write_bytes, write_json
from pzcap.io.video import VideoReader
from pzcap.progress import Report, no_report
from pzcap.synchronisation.synchronise import WAYS, Recording, Synchronisation, synchronise
from pzcap.types import CameraClock, CameraFiles, Capture, PzcapError

SYNC: Final = "sync.json"


def sync_folder(folder: Path, way: str | None) -> int:
    """Synchronise the capture in ``folder``, write what was found, print it; the exit status, 1 where it is not
    known."""
    capture = read_capture(folder, without_clocks=True)
    with ProgressLine() as line:
        found = synchronised(capture, (way,) if way else WAYS, line.update)
    print("\n".join(report(found, capture)))
    return int(found.clocks is None)


def synchronised(capture: Capture, ways: Sequence[str] = WAYS, told: Report = no_report) -> Synchronisation:
    """Synchronise a capture; where it can be, write sync.json and name it in capture.json."""
    recordings = [
        Recording(camera.name, VideoReader(camera.motion), _distance(capture, camera))
        for camera in capture.cameras
        if camera.motion is not None
    ]
    if not recordings:
        raise PzcapError(f'{capture.folder / MANIFEST}: no camera has a "motion" video; name at least one')
    found = synchronise(recordings, ways, told)
    if found.clocks is not None:
        write_sync(capture.folder, found.clocks)
    return found


def report(found: Synchronisation, capture: Capture) -> list[str]:
    """What was found, in lines."""
    lines = [f"sync by {tried}" for tried in found.tried]
    if found.clocks is None:
        before = capture.folder / SYNC
        kept = [f"{before}: of before, stays in force; remove it if it is wrong"] if before.is_file() else []
        return [
            *lines,
            "sync: NOT KNOWN how the cameras lie to each other; clap or light a lamp where all of them record it and "
            f"shoot again, or write {SYNC} by hand (docs/capture.md)",
            *kept,
        ]
    way = next(iter(found.clocks.values())).by
    lines.append(f"sync by {way}: known; pairs of cameras agree to {1000.0 * found.left_s:.1f} ms")
    rate = float(capture.frame_rate)
    for name, clock in found.clocks.items():
        drift = "" if clock.rate == 1.0 else f", its clock off by {1e6 * (clock.rate - 1.0):+.0f} millionths"
        lines.append(
            f"  camera {name}: starts at {clock.offset_s:+.4f} s ({clock.offset_s * rate:+.2f} frames), "
            f"standard deviation {1000.0 * clock.sigma_s:.0f} ms{drift}"
        )
    return lines


def write_sync(folder: Path, clocks: dict[str, CameraClock]) -> None:
    """Write sync.json, and its name into capture.json; one that was there, which a hand may have written, is kept as
    sync.json.before."""
    entries = [
        {
            "name": name,
            "offset_s": round(clock.offset_s, 6),
            "rate": round(clock.rate, 9),
            "sigma_s": round(clock.sigma_s, 6),
            "by": clock.by,
        }
        for name, clock in clocks.items()
    ]
    if (folder / SYNC).is_file():
        write_bytes(folder / f"{SYNC}.before", (folder / SYNC).read_bytes())
    write_json(folder / SYNC, {"format": SYNC_FORMAT, "version": SYNC_VERSION, "cameras": entries})
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8-sig"))
    if manifest.get("sync") != SYNC:
        write_json(folder / MANIFEST, {**manifest, "sync": SYNC})


def _distance(capture: Capture, camera: CameraFiles) -> float | None:
    """Metres from a camera to the middle of the calibration object, near which the crew claps; None: not known."""
    if capture.calibration_object is None or camera.reference is None:
        return None
    reference, _ = check_reference(camera.name, read_image(camera.reference), capture.calibration_object)
    if reference is None or reference.camera is None:
        return None
    middle = np.mean([marker.corners_m.mean(axis=0) for marker in capture.calibration_object.markers], axis=0)
    return float(np.linalg.norm(reference.camera.camera.world_T_cam[:3, 3] - middle))
