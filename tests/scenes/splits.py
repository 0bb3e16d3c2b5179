"""A split of the benchmark that nothing was filmed for: footage of grey pictures, truth and results made up."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.benchmark.entries import Description, entry_of, write_entry
from experiments.plain_truth import true_capture
from pzcap.export.tables import results_of
from pzcap.scoring.files import write_results
from pzcap.scoring.truth_files import write_truth
from tests.scenes import plain

AXES = {"noise": ["2", "4", "8"], "motion": ["walk", "jump"]}
CAPTURES = {
    "walk_1": {"seed": 1, "noise": "2", "motion": "walk"},
    "walk_1_noise-8": {"seed": 1, "noise": "8", "motion": "walk"},
    "walk_1_noise-4": {"seed": 1, "noise": "4", "motion": "walk"},
    "jump_2": {"seed": 2, "noise": "2", "motion": "jump"},
}


def split(folder: Path) -> dict[str, Any]:
    """Write ``captures.json`` and the truth of each capture into ``folder``; the description."""
    content = {"release": "9.9", "split": folder.name, "axes": AXES, "base": {}, "captures": CAPTURES}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "captures.json").write_text(json.dumps(content))
    _, truth = plain.perfect()
    for name in CAPTURES:
        write_truth(true_capture(truth, name, (0,)), folder / "truth" / name)
    return content


def results(folder: Path, key: str, size: float, lacks: tuple[str, ...] = ()) -> Path:
    """Results of a method whose errors are ``size`` times those of `plain.noisy`; of no capture that it ``lacks``."""
    whole, truth = plain.perfect()
    off = plain.noisy(whole)
    shape = (truth.width, truth.height)
    for number, name in enumerate(CAPTURES):
        if name in lacks:
            continue
        tracks = []
        for found, true in zip(off.tracks, whole.tracks, strict=True):
            assert found is not None
            assert true is not None
            apart = size * (number + 1)
            pan = true.pan_rad + apart * (found.pan_rad - true.pan_rad)
            focal = true.focal_px * np.exp(apart * np.log(found.focal_px / true.focal_px))
            tracks.append(replace(found, pan_rad=pan, focal_px=focal))
        made = results_of(replace(off, tracks=tuple(tracks), capture_name=name, method=key))
        write_results(replace(made, image_size=shape), folder / "results" / key / name, {"seconds": 1.0})
    return folder / "results" / key


def entry(
    folder: Path, content: dict[str, Any], description: Description, size: float, lacks: tuple[str, ...] = ()
) -> Path:
    """The entry of such a method, its file."""
    made = entry_of(description, results(folder, description.key, size, lacks), folder / "truth", content)
    path = folder / "entries" / f"{description.key}.json"
    write_entry(path, made)
    return path
