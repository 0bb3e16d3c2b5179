"""`pzcap export`: results in the formats of other tools."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from pzcap.command.places import load_results, made_of
from pzcap.export import formats, freed
from pzcap.export.take import Take
from pzcap.io.capture import read_capture
from pzcap.types import Capture, PzcapError


def export_results(results: Path, names: Sequence[str], out: Path, capture: Path | None, udp: str | None) -> int:
    """Write ``results`` in each of the formats, a folder each where there are several; the exit status."""
    names = [formats.known(name) for name in names]
    address = None if udp is None else _address(udp, names)
    wanted = any(formats.FORMATS[name].keypoints or formats.FORMATS[name].video for name in names)
    take = Take(load_results(results), _captured(results, capture) if wanted or capture is not None else None)
    for name in dict.fromkeys(names):
        files = formats.write(take, name, out / name if len(set(names)) > 1 else out)
        listed = [str(path) for path in files[:8]] + ([f"... {len(files)} files in all"] if len(files) > 8 else [])
        print("\n".join(listed))
        print(f"pzcap: {name}: {formats.FORMATS[name].units}", file=sys.stderr)
        if formats.FORMATS[name].keypoints and not _has_keypoints(take):
            said = "the capture has no keypoints" if take.capture else "--capture FOLDER takes the keypoints along"
            print(f"pzcap: {name}: the calibration alone; {said}", file=sys.stderr)
    if address is not None:
        print(f"{freed.send(take, *address)} frames sent to {udp}")
    return 0


def _captured(results: Path, capture: Path | None) -> Capture | None:
    """The ``capture`` that is given, or else that which the ``results`` were made of where it is still there, and
    whole."""
    if capture is not None:
        return read_capture(capture)
    try:
        capture = made_of(results)
    except PzcapError:
        return None
    try:
        return read_capture(capture)
    except PzcapError as error:
        print(f"pzcap: without the capture, which cannot be read: {error}", file=sys.stderr)
        return None


def _has_keypoints(take: Take) -> bool:
    return take.capture is not None and any(camera.keypoints for camera in take.capture.cameras)


def _address(udp: str, names: Sequence[str]) -> tuple[str, int]:
    host, _, port = udp.rpartition(":")
    if "freed" not in names:
        raise PzcapError("--udp goes with --to freed alone")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise PzcapError(f"--udp {udp}: give HOST:PORT, such as 127.0.0.1:40000")
    return host, int(port)
