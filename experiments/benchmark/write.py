"""Entries written: scores, the pictures of the worst frames, and a recording; and what ran, where."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments.benchmark import worst
from experiments.benchmark.entries import PLAIN, Description, entry_of, write_entry
from experiments.benchmark.tracks import TRACKS
from experiments.metrics import machine
from experiments.run import CONF
from pzcap.scoring.command import captures
from pzcap.scoring.readers.conventions import Conventions
from pzcap.scoring.readers.read import read
from pzcap.scoring.records import Results, TrueCapture
from pzcap.scoring.truth_files import read_truth


def write(
    folder: Path, split: Mapping[str, Any], description: Description, results: Path, said: Conventions = PLAIN
) -> Path:
    """Score the ``results`` of a split, and write the entry, its pictures and its recording into its ``folder``."""
    entry = entry_of(description, results, folder / "truth", split, said)
    where = captures(results, folder / "truth")

    def of(capture: str) -> tuple[Results, TrueCapture]:
        given, truth = where[capture]
        assert given is not None
        true = read_truth(truth)
        return read(given, true, said), true

    place = folder / "entries" / description.key
    shutil.rmtree(place, ignore_errors=True)
    for track, frames in entry["worst"].items():
        for number, one in enumerate(frames):
            name = f"{description.key}/{track}-{number + 1}.jpg"
            image = worst.frame_image(folder / "footage" / one["capture"], one["camera"], one["frame"])
            if image is None:
                continue
            body = TRACKS[track].columns[0].startswith("body")
            shown = worst.picture(image, *of(one["capture"]), one["camera"], one["frame"], body=body)
            worst.save_picture(folder / "entries" / name, shown)
            one["picture"] = name
    chosen = [one for frames in entry["worst"].values() for one in frames]
    if chosen:
        entry["recording"] = f"{description.key}/recording.rrd"
        means = next(iter(entry["means"].values()))
        worst.record(folder / "entries" / entry["recording"], *of(chosen[0]["capture"]), description.label, means)
    path = folder / "entries" / f"{description.key}.json"
    write_entry(path, entry)
    return path


def this_machine() -> str:
    """The processor of this machine."""
    here = machine()
    return f"{here['cpu']}, {here['cores']} cores"


def commit() -> str:
    """The commit of this tree, and whether something differs from it; empty where there is none."""
    try:
        root = CONF.parent
        line = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
        return subprocess.run(line, capture_output=True, text=True, check=True, timeout=20).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
