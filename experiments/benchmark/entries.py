"""Entries of the board: a JSON file a method, with its scores on a split and all that makes them believable.

An entry is made from files of results alone (docs/benchmark.md), whoever wrote them: the same function makes those of
this tree's methods and anybody else's.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from experiments.benchmark.tracks import TRACKS
from experiments.config import nearest, structured
from pzcap.io.files import checked, write_bytes
from pzcap.scoring.command import captures, over
from pzcap.scoring.metric import Metric
from pzcap.scoring.readers.conventions import Conventions
from pzcap.scoring.readers.read import read
from pzcap.scoring.records import TrueCapture, thinned
from pzcap.scoring.score import Errors, score
from pzcap.scoring.suspicions import suspicions
from pzcap.scoring.totals import metrics
from pzcap.scoring.truth_files import read_truth
from pzcap.types import Array, PzcapError

FORMAT: Final = "pzcap-entry"
VERSION: Final = 1
WORST: Final = 3
"""Frames that the board shows of an entry."""
APART: Final = 10
"""Frames between two of the body's: what is next to the worst looks like it."""

PLAIN: Final = Conventions()

Claim = Literal["reproduced", "code public", "claimed"]


@dataclass(frozen=True, slots=True)
class Description:
    """Statement about a method by whoever enters it."""

    key: str
    """Name of the entry's file, of letters, digits, _ and -."""
    label: str
    tracks: tuple[str, ...]
    claim: Claim = "claimed"
    """reproduced: whoever runs the board ran its code; code public: its code is there for anybody to run."""
    command: str = ""
    commit: str = ""
    url: str = ""
    """Of its code, or of a description."""
    machine: str = ""
    seconds: float | None = None
    """Wall time of all captures."""
    memory_mib: float | None = None
    published: str = ""
    """The figure that its authors published on their own data, and where."""
    notes: str = ""


@dataclass(frozen=True, slots=True)
class WorstFrame:
    """A frame that the board shows."""

    capture: str
    camera: str  # that it is seen in
    frame: int
    error: float
    unit: str


def read_description(path: Path) -> Description:
    """The description at ``path``. Raises PzcapError, in one line, where it is not one."""
    try:
        content = json.loads(checked(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise PzcapError(f"{path}: no readable description ({error}); docs/benchmark.md says what it holds") from error
    return check(structured(content, Description, path.name), path.name)


def check(description: Description, where: str) -> Description:
    """``description``, whose name and tracks fit. Raises PzcapError where they do not."""
    if not description.key or not all(letter.isalnum() or letter in "_-" for letter in description.key):
        raise PzcapError(f"{where}: key '{description.key}'; give letters, digits, _ and -")
    for track in description.tracks:
        if track not in TRACKS:
            raise PzcapError(f"{where}: no track '{track}'; {nearest(track, TRACKS)}")
    if not description.tracks:
        raise PzcapError(f"{where}: enters no track; name one of {', '.join(TRACKS)}")
    return description


def entry_of(
    description: Description, predictions: Path, truth: Path, split: Mapping[str, Any], said: Conventions = PLAIN
) -> dict[str, Any]:
    """The entry of a method whose results of all captures lie in ``predictions``, folders or other programs' files.

    ``split`` is what `make.described` says, ``said`` what such files leave open. Raises PzcapError for results that are
    refused, as `pzcap-score` does.
    """
    found: dict[str, dict[str, list[Metric]]] = {track: {} for track in description.tracks}
    warnings: list[str] = []
    worst: dict[str, list[WorstFrame]] = {track: [] for track in description.tracks}
    for name, (results, folder) in captures(predictions, truth).items():
        true = read_truth(folder)
        given = None if results is None else read(results, true, said)
        if given is not None:
            warnings += [f"{name}: {line}" for line in suspicions(given, true)]
        for track in description.tracks:
            if given is None:
                found[track][name] = []
                continue
            asked = thinned(true, TRACKS[track].every)
            errors = score(given, asked)
            found[track][name] = metrics(errors)
            worst[track] += worst_frames(name, track, errors, given.camera_names, asked)
    return {
        "format": FORMAT,
        "version": VERSION,
        "release": split["release"],
        "split": split["split"],
        **asdict(description),
        "predictions_sha256": sha256_of(predictions),
        "suspicious": warnings,
        "scores": {track: {name: _values(some) for name, some in by.items()} for track, by in found.items()},
        "means": {track: _values(over(by)) for track, by in found.items()},
        "units": {m.key: [m.unit, m.direction] for by in found.values() for some in by.values() for m in some},
        "worst": {track: [asdict(one) for one in _chosen(some)] for track, some in worst.items()},
    }


def _values(found: Sequence[Metric]) -> dict[str, float | None]:
    return {metric.key: metric.value for metric in found}


def sha256_of(folder: Path) -> str:
    """Hash of all files of results, names and content: of the same results the same, wherever they lie."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        content = checked(path).read_bytes()
        if path.name == "results.json":  # what a run took is no prediction
            content = json.dumps(
                {k: v for k, v in json.loads(content).items() if k != "about"}, sort_keys=True
            ).encode()
        digest.update(f"{path.relative_to(folder).as_posix()} {len(content)} ".encode() + content)
    return digest.hexdigest()


def worst_frames(
    capture: str, track: str, errors: Errors, names: Sequence[str], truth: TrueCapture
) -> list[WorstFrame]:
    """The worst frame of each camera; or the worst of the body, each seen by the camera that shows it largest."""
    if TRACKS[track].columns[0].startswith("body"):
        body = errors.body
        if body is None or not body.scored.any():
            return []
        counted = body.scored_joints
        mean = np.sum(body.joints_m * counted, axis=1) / np.maximum(counted.sum(axis=1), 1)
        size = np.where(body.scored, mean, -1.0)
        frames: list[int] = []
        while len(frames) < WORST and size.max() >= 0.0:
            frames.append(int(np.argmax(size)))
            size[max(0, frames[-1] - APART) : frames[-1] + APART + 1] = -1.0
        at = [int(errors.truth_frames[frame]) for frame in frames]
        return [
            WorstFrame(capture, _nearest_camera(truth, true), true, float(1000.0 * mean[frame]), "mm")
            for frame, true in zip(frames, at, strict=True)
        ]
    found = []
    for name, camera in zip(names, errors.cameras, strict=True):
        for series, scale, unit in (
            (camera.reprojection_px, 1.0, "px"), (camera.pan_rad, np.degrees(1.0), "deg"), (camera.focal, 100.0, "%")
        ):  # fmt: skip
            if series is not None and series.valid.any():
                size = np.where(series.valid, np.abs(series.values), -1.0)
                frame = int(np.argmax(size))
                found.append(
                    WorstFrame(capture, name, int(errors.truth_frames[frame]), float(scale * size[frame]), unit)
                )
                break
    return found


def _nearest_camera(truth: TrueCapture, frame: int) -> str:
    """The camera that shows the body largest, of those that have it in the image."""

    def size(number: int) -> float:
        track = truth.cameras[number].track
        assert track.poses is not None
        middle: Array = truth.joints_m[frame].mean(axis=0) - track.poses.position_m[frame]
        return float(track.focal_px[frame] / np.linalg.norm(middle))

    return truth.camera_names[max(range(len(truth.camera_names)), key=size)]


def _chosen(found: Sequence[WorstFrame]) -> list[WorstFrame]:
    return sorted(found, key=lambda one: one.error, reverse=True)[:WORST]


def write_entry(path: Path, entry: Mapping[str, Any]) -> None:
    """Write an entry, whole or not at all."""
    write_bytes(path, (json.dumps(entry, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode())


def read_entries(folder: Path) -> list[dict[str, Any]]:
    """All entries in ``folder``. Raises PzcapError for a file that is none."""
    found = []
    for path in sorted(folder.glob("*.json")):
        try:
            entry = json.loads(checked(path).read_text(encoding="utf-8"))
            if entry["format"] != FORMAT or entry["version"] != VERSION:
                raise ValueError(f'its "format" is not "{FORMAT}" of version {VERSION}')
            missing = {"key", "label", "tracks", "claim", "scores", "means", "units", "predictions_sha256"} - set(entry)
            if missing:
                raise ValueError(f"no {min(missing)}")
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise PzcapError(f"{path}: no entry of the board ({error}); make it with the score command") from error
        found.append(entry)
    if not found:
        raise PzcapError(f"{folder}: holds no entry; score a method first, python -m experiments.benchmark score")
    return found
