"""Plain results and their truth, made up: a good method on four cameras that pan after somebody who crosses the
carpet."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.plain_truth import true_capture
from pzcap.export.tables import results_of
from pzcap.scoring.files import write_results
from pzcap.scoring.records import Results, TrueCapture
from pzcap.scoring.truth_files import write_truth
from pzcap.types import Reconstruction
from sim.truth import Truth
from tests.scenes import fabricated
from tests.scenes.fabricated_truth import truth_of

NAME = "fabricated"


def perfect(frames: int = 20) -> tuple[Reconstruction, Truth]:
    """A reconstruction, and the truth that makes it perfect."""
    whole = fabricated.reconstruction(frames=frames)
    return whole, truth_of(whole)


def noisy(whole: Reconstruction, seed: int = 3) -> Reconstruction:
    """``whole`` with the errors of a good method: thousandths of a degree, a tenth of a percent, a centimetre."""
    rng = np.random.default_rng(seed)
    tracks = []
    for track in whole.tracks:
        assert track is not None
        count = len(track.valid)
        pan, focal = rng.normal(0.0, 1e-4, count), rng.normal(0.0, 1e-3, count)
        tracks.append(replace(track, pan_rad=track.pan_rad + pan, focal_px=track.focal_px * np.exp(focal)))
    assert whole.motion is not None
    joints = whole.motion.joints_m + rng.normal(0.0, 0.006, whole.motion.joints_m.shape)
    return replace(whole, tracks=tuple(tracks), motion=replace(whole.motion, joints_m=joints))


def good() -> tuple[Results, TrueCapture]:
    """Results of a good method, and the truth."""
    whole, truth = perfect()
    true = true_capture(truth, NAME, keyframes=(0,))
    return replace(results_of(noisy(whole)), image_size=true.image_size), true


def written(folder: Path) -> tuple[Path, Path]:
    """Folders of results of a good method, and of the truth."""
    results, truth = good()
    write_results(results, folder / "results")
    write_truth(truth, folder / "truth")
    return folder / "results", folder / "truth"


Edit = Callable[[list[dict[str, str]]], list[dict[str, str]]]


def edited(path: Path, edit: Edit) -> None:
    """The table at ``path`` after ``edit`` of its rows."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = edit(list(csv.DictReader(file)))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def header(results: Path, **values: Any) -> None:
    """Keys of results.json set to other values; None removes one."""
    path = results / "results.json"
    content = json.loads(path.read_text(encoding="utf-8")) | values
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}), encoding="utf-8")
