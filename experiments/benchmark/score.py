"""Runs the methods of this tree on a split, or takes anybody's results of it, and makes entries of the board.

    python -m experiments.benchmark score split=mini                             # all methods of this tree
    python -m experiments.benchmark score split=mini methods=[ours,peer_sift]
    python -m experiments.benchmark score split=mini results=FOLDER entry=mine.json

leaves in outputs/benchmark/RELEASE/SPLIT `results/KEY/CAPTURE` (files of results), `entries/KEY.json`, and in
`entries/KEY/` pictures of its worst frames and a recording. What is there already is not run again, unless the code has
changed since or `again=true`.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from experiments.benchmark import worst
from experiments.benchmark.entries import Description, check, entry_of, read_description, write_entry
from experiments.benchmark.make import described
from experiments.benchmark.methods.given import Answered, Given
from experiments.benchmark.methods.rows import METHODS, RUNS, Method
from experiments.benchmark.tracks import TRACKS
from experiments.config import AppConfig, nearest
from experiments.metrics import machine
from experiments.progress import Bars
from experiments.run import CONF
from experiments.terminal import terminal
from pzcap.io.files import write_json
from pzcap.scoring.files import read_results, write_results
from pzcap.scoring.readers.conventions import Conventions
from pzcap.scoring.readers.read import read
from pzcap.scoring.score import score
from pzcap.scoring.totals import metrics
from pzcap.scoring.truth_files import read_truth
from pzcap.types import PzcapError

SOURCES: Final = ("pzcap", "experiments/comparisons", "experiments/benchmark/methods")
"""Of what the answers of a method depend on; the score itself is none of it."""
SCORING: Final = "pzcap/scoring"


def score_methods(folder: Path, names: Sequence[str], again: bool) -> list[Path]:
    """Run these methods (none: all) on the split in ``folder``; the entries that were made."""
    split = described(folder)
    known = {method.key: method for method in METHODS}
    for name in names:
        if name not in known:
            raise PzcapError(f"no method '{name}'; {nearest(name, known)}")
    chosen = [method for method in METHODS if not names or method.key in names]
    with Bars(terminal(stderr=True)) as bars:
        for capture in split["captures"]:
            given = Given(folder / "jobs" / capture, AppConfig(), bars.update)
            for run in dict.fromkeys(method.run for method in chosen):
                _run(folder, given, capture, run, again)
    return [path for method in chosen if (path := _enter(folder, split, method)) is not None]


def score_results(folder: Path, results: Path, description: Path) -> Path:
    """Make an entry of anybody's ``results`` of the split in ``folder``."""
    return _write(folder, described(folder), read_description(description), results)


def _run(folder: Path, given: Given, capture: str, run: str, again: bool) -> None:
    """Let the methods of one run answer, where they have not by this code."""
    keys = [method.key for method in METHODS if method.run == run]
    if not again and all(_took(folder, key, capture).get("code") == _code() for key in keys):
        return
    try:
        answers = RUNS[run](given)
    except PzcapError as error:  # on this footage: it is a capture without an answer
        answers = {key: Answered(None, 0.0, None, str(error)) for key in keys}
    for key, answered in answers.items():
        _keep(folder, key, capture, answered)


@cache
def _code() -> str:
    digest = hashlib.sha256()
    root = CONF.parent
    for source in SOURCES:
        for path in sorted((root / source).rglob("*.py")) if (root / source).is_dir() else [root / source]:
            name = path.relative_to(root).as_posix()
            if not name.startswith(SCORING):
                digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()


def _took(folder: Path, key: str, capture: str) -> dict[str, Any]:
    """Time and memory of a method on a capture, and the code it ran; empty where it has not run."""
    try:
        took: dict[str, Any] = json.loads((folder / "runs" / key / f"{capture}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return took


def _keep(folder: Path, key: str, capture: str, answered: Answered) -> None:
    place, took = folder / "results" / key / capture, folder / "runs" / key / f"{capture}.json"
    shutil.rmtree(place, ignore_errors=True)
    if answered.results is not None:
        write_results(answered.results, place)
        true = read_truth(folder / "truth" / capture)
        if metrics(score(read_results(place), true)) != metrics(score(answered.results, true)):
            raise PzcapError(f"{place}: files score otherwise than what they were written from; report this bug")
    what = {
        "code": _code(), "seconds": answered.seconds, "memory_mib": answered.memory_mib, "missing": answered.missing
    }  # fmt: skip
    write_json(took, what, indent=None)


def _enter(folder: Path, split: Mapping[str, Any], method: Method) -> Path | None:
    """The entry of a method of this tree; None where it could run on no capture."""
    took = [_took(folder, method.key, capture) for capture in split["captures"]]
    missing = sorted({str(one["missing"]) for one in took if one.get("missing")})
    results = folder / "results" / method.key
    if not any(results.glob("*")):
        terminal(stderr=True).print(f"{method.label}: {', '.join(missing)}", highlight=False)
        return None
    memory = [one["memory_mib"] for one in took if one.get("memory_mib")]
    here, where = machine(), f"release={split['release']} split={split['split']}"
    description = Description(
        key=method.key,
        label=method.label,
        tracks=method.tracks,
        claim="reproduced",
        command=f"python -m experiments.benchmark score {where} methods=[{method.key}]",
        commit=_commit(),
        machine=f"{here['cpu']}, {here['cores']} cores",
        seconds=round(sum(one.get("seconds", 0.0) for one in took), 1),
        memory_mib=round(max(memory), 0) if memory else None,
        published=method.published,
        notes="; ".join([*([method.notes] if method.notes else []), *(f"some captures: {line}" for line in missing)]),
    )
    return _write(folder, split, check(description, method.key), results)


def _write(folder: Path, split: Mapping[str, Any], description: Description, results: Path) -> Path:
    """Score, and write the entry, its pictures and its recording."""
    entry = entry_of(description, results, folder / "truth", split)
    place = folder / "entries" / description.key
    shutil.rmtree(place, ignore_errors=True)
    for track, frames in entry["worst"].items():
        for number, one in enumerate(frames):
            name = f"{description.key}/{track}-{number + 1}.jpg"
            image = worst.frame_image(folder / "footage" / one["capture"], one["camera"], one["frame"])
            if image is None:
                continue
            true = read_truth(folder / "truth" / one["capture"])
            given = read(results / one["capture"], true, Conventions())
            body = TRACKS[track].columns[0].startswith("body")
            worst.save_picture(
                folder / "entries" / name, worst.picture(image, given, true, one["camera"], one["frame"], body=body)
            )
            one["picture"] = name
    shown = [one for frames in entry["worst"].values() for one in frames]
    if shown:
        capture = shown[0]["capture"]
        true = read_truth(folder / "truth" / capture)
        given = read(results / capture, true, Conventions())
        entry["recording"] = f"{description.key}/recording.rrd"
        means = next(iter(entry["means"].values()))
        worst.record(folder / "entries" / entry["recording"], given, true, description.label, means)
    path = folder / "entries" / f"{description.key}.json"
    write_entry(path, entry)
    return path


def _commit() -> str:
    """The commit of this tree, and whether something differs from it; empty where there is none."""
    try:
        root = CONF.parent
        line = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
        return subprocess.run(line, capture_output=True, text=True, check=True, timeout=20).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
