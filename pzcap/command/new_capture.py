"""`pzcap new`: a capture.json that names a crew's own files where they lie. Nothing is copied, moved or renamed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from pzcap.command.footage_files import File, cameras_in, keypoints_beside, motion_rates, multiples, troubles
from pzcap.command.progress import ProgressLine
from pzcap.command.syncing import SYNC, report, synchronised
from pzcap.io.capture import FOOTAGE, FORMAT, MANIFEST, PAPERS, VERSION, read_capture
from pzcap.io.files import write_json
from pzcap.types import PzcapError

_CURES: Final = {
    "object": "missing; pzcap marker-cube writes it with the cube to print; without any, keypoints place the cameras",
    "subject": "missing; the athlete's stature is the least, tape measurements are better (docs/capture.md)",
    "keyframes": "missing; pzcap edit poses them by hand, pzcap keypoints finds what does instead",
}
"""Remedy for each paper that every take wants."""
TABLE = ("camera", "is its", "file", "known by", "size", "frames", "frames/s", "timecode", "scan")


def write_capture(
    folder: Path, *, name: str | None, full_turn: bool, patterns: Mapping[str, str], replace: bool
) -> int:
    """Write capture.json into ``folder`` and print what was found; the exit status, 1 where something is in the way."""
    if not folder.is_dir():
        raise PzcapError(f"{folder}: no such folder; give the one that the cameras' folders lie in")
    manifest = folder / MANIFEST
    if manifest.exists() and not replace:
        raise PzcapError(f"{manifest}: is there already; give --replace to write it anew")
    cameras = cameras_in(folder, patterns)
    print("\n".join(table(cameras)))
    texts = {key: f"{key}.json" if (folder / f"{key}.json").is_file() else None for key in PAPERS}
    for key, file in texts.items():
        if file or key in _CURES:
            print(f"{key}.json: {'found' if file else _CURES[key]}")
    if texts["sync"] and any(_newer(file.path, folder / SYNC) for file in _motions(cameras)):
        print(f"{SYNC}: is older than some motion videos; if these are of another take, run pzcap sync {folder}")
    content = {
        "format": FORMAT,
        "version": VERSION,
        "name": name or folder.resolve().name or "take",
        "frame_rate": _rate(cameras),
        "full_turn": full_turn,
        "cameras": [_entry(camera, files, folder) for camera, files in cameras.items()],
        **texts,
    }
    write_json(manifest, content)
    print(f"{manifest}: written; the sweeps {'go' if full_turn else 'do not go'} all the way round")
    unreadable = any(file.trouble for files in cameras.values() for file in files)
    unsynchronised: list[str] = []
    if not unreadable and texts["sync"] is None and any(each.timecode is None for each in _motions(cameras)):
        try:
            _synchronise(folder)
            texts["sync"] = SYNC
        except PzcapError as error:
            unsynchronised.append(str(error))
    found = [*troubles(cameras, texts["sync"] is not None), *unsynchronised]
    if not found:
        try:
            read_capture(folder)
        except PzcapError as error:
            found.append(str(error))
    for trouble in found:
        print(f"  to mend: {trouble}")
    return int(bool(found))


def _motions(cameras: Mapping[str, Sequence[File]]) -> list[File]:
    return [file for files in cameras.values() for file in files if file.role == "motion" and not file.trouble]


def _newer(path: Path, other: Path) -> bool:
    return path.stat().st_mtime > other.stat().st_mtime


def _synchronise(folder: Path) -> None:
    """Find how cameras without timecode lie to each other. Raises PzcapError where that is not known."""
    print(f"not all motion videos have timecode: {SYNC} is looked for")
    capture = read_capture(folder, without_clocks=True)
    with ProgressLine() as line:
        found = synchronised(capture, told=line.update)
    lines = report(found, capture)
    if found.clocks is None:
        raise PzcapError("; ".join(lines))
    print("\n".join(lines))


def table(cameras: Mapping[str, Sequence[File]]) -> Iterator[str]:
    """Report on the files that were found, a line each."""
    rows = [TABLE] + [_row(camera, file) for camera, files in cameras.items() for file in files]
    widths = [max(len(row[k]) for row in rows) for k in range(len(TABLE))]
    for row in rows:
        yield "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()


def _row(camera: str, file: File) -> tuple[str, ...]:
    if file.trouble:
        return (camera, file.role, file.path.name, file.known_by, "unreadable", "", "", "", "")
    scan = ("interlaced" if file.interlaced else "progressive") if file.rate else "still"
    turned = f", turned by {file.rotation_deg}" if file.rotation_deg % 360 else ""
    rate = "" if file.rate is None else f"{float(file.rate):.6g}{', varies' if file.varies else ''}"
    frames = "" if file.rate is None else str(file.frames)
    size = f"{file.width}x{file.height}"
    stamp = (file.timecode or "none") if file.role == "motion" else ""
    return (camera, file.role, file.path.name, file.known_by, size, frames, rate, stamp, scan + turned)


def _rate(cameras: Mapping[str, Sequence[File]]) -> str:
    """The rate of the frame sets, as a fraction: the least that motion videos have, where the others have multiples of
    it; else the one that most have."""
    rates = motion_rates(cameras)
    if not rates:
        raise PzcapError("no camera has a motion video that can be read; name one by --motion NAME")
    rate = min(rates) if multiples(rates) else max(rates, key=rates.count)
    return f"{rate.numerator}/{rate.denominator}"


def _entry(camera: str, files: Sequence[File], folder: Path) -> dict[str, str | int | None]:
    paths = {file.role: file.path.relative_to(folder).as_posix() for file in files}
    entry: dict[str, str | int | None] = {"name": camera, **{role: paths.get(role) for role in FOOTAGE}}
    for file in files:
        if file.role == "motion" and (found := keypoints_beside(file.path)).is_file():
            entry |= {"keypoints": found.relative_to(folder).as_posix(), "keypoints_from": 0}
            print(f"camera {camera}: {found.name} has its keypoints")
    return entry
