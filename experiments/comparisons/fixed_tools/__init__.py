"""Tools that know fixed cameras alone, unmodified, on footage of cameras that pan and zoom: what they make of it.

    python -m experiments.compare fixed_tools seed=0           # conf/experiment/keypoints.yaml shoots with a detector
    python -m experiments.compare fixed_tools capture=CAPTURE  # with keypoints, and the truth beside it

The cameras are found by us. Their keypoints are carried over to virtual fixed cameras (docs/formats/virtual_cameras.md)
and written as `pzcap export` does; Pose2Sim and aniposelib, each in its own environment (`make test-clients`), read the
files and triangulate as they come. Beside them stand the same keypoints triangulated through the moving cameras, and
our own body, from pixels and keypoints and from pixels alone. Errors are those of shoulders, elbows, wrists, hips,
knees and ankles, nothing aligned, in the frames in which every tool has the joint; keyframes do not count.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from rich.console import Console

from experiments.comparisons.fixed_tools.clients import HERE, installed, run
from experiments.comparisons.harness import Column, Comparison, Row, on_keypoints
from experiments.comparisons.triangulation import triangulate
from experiments.config import AppConfig
from experiments.progress import Bars
from pzcap.export import aniposelib, pose2sim
from pzcap.export.take import Take
from pzcap.io.detections import KEYPOINTS
from pzcap.scoring.records import by_timecode
from pzcap.types import JOINTS, Array, Mask, PzcapError

LIMBS: Final = tuple(
    f"{side}_{name}" for side in ("left", "right") for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
)
"""Joints that are keypoints as well."""
_MISSING: Final = "not installed: make test-clients"


def compare(config: AppConfig, folder: Path, console: Console) -> Sequence[Row[Any]]:
    """Each tool on the same keypoints. Raises PzcapError where no camera has any."""
    del folder
    with Bars(console) as bars:
        capture, truth, pixels, joined = on_keypoints(config, bars.update)
        if joined.motion is None or pixels.motion is None:
            raise PzcapError(f"{capture.folder}: no body was tracked; it needs subject.json and keyframes.json")
        own = [JOINTS.index(name) for name in LIMBS]
        places: dict[str, Array] = {}
        absent: dict[str, str] = {}
        for tool, triangulated in TOOLS.items():
            bars.update(tool, 0, 1)
            if installed(tool):
                with TemporaryDirectory() as work:
                    places[tool] = triangulated(Take(joined, capture), Path(work))
            else:
                absent[tool] = _MISSING
            bars.update(tool, 1, 1)
    places["alone"] = triangulate(capture, pixels).joints_m[:, own]
    places["joined"], places["pixels"] = joined.motion.joints_m[:, own], pixels.motion.joints_m[:, own]
    index, known = by_timecode(joined.timecodes, truth.timecodes)
    known = known.copy()
    known[joined.motion.keyframes] = False
    errors = {
        key: 1000.0 * np.linalg.norm(each - truth.joints_m[index][:, own], axis=2) for key, each in places.items()
    }
    counted: Mask = known[:, None] & np.all([np.isfinite(each) for each in errors.values()], axis=0)
    labels = {
        "pose2sim": "Pose2Sim, triangulation and filter",
        "aniposelib": "aniposelib, triangulate",
        "alone": "pzcap, keypoints through the moving cameras",
        "joined": "pzcap, pixels and keypoints",
        "pixels": "pzcap, pixels alone",
    }
    return [
        Row(key, label, {}, missing=absent[key])
        if key in absent
        else Row(key, label, _figures(errors[key], counted, known))
        for key, label in labels.items()
    ]


def _figures(error: Array, counted: Mask, known: Mask) -> dict[str, float | None]:
    of = error[counted]
    missing = 100.0 * float(np.mean(~np.isfinite(error[known])))
    return {
        "mean": float(of.mean()) if of.size else None,
        "p95": float(np.percentile(of, 95)) if of.size else None,
        "missing": missing,
    }


def by_pose2sim(take: Take, work: Path) -> Array:
    """(F, 12, 3) `LIMBS` by Pose2Sim's triangulation and filter; NaN where it has none."""
    project = work / "Take"
    pose2sim.write(take, project)
    run("pose2sim", HERE / "run_pose2sim.py", project, folder=work)
    filtered = sorted((project / "pose-3d").glob("*filt*.trc"))
    if len(filtered) != 1:
        raise PzcapError(f"pose2sim: it wrote {len(filtered)} filtered files, where one person was filmed")
    return read_pose2sim(filtered[0], len(take.reconstruction.timecodes), float(take.reconstruction.frame_rate))


def read_pose2sim(path: Path, frames: int, rate: float) -> Array:
    """(F, 12, 3) `LIMBS` in the world of a TRC file by Pose2Sim, which has turned it to y up."""
    lines = path.read_text().splitlines()
    names = [cell for cell in lines[3].split("\t") if cell.strip()][2:]
    places = np.full((frames, len(LIMBS), 3), np.nan)
    for line in lines[5:]:
        cells = line.split("\t")
        if len(cells) < 2 or not cells[1].strip():
            continue
        frame = round(float(cells[1]) * rate)
        for k, limb in enumerate(LIMBS):
            side, name = limb.split("_")
            column = 2 + 3 * names.index(f"{side[0].upper()}{name.capitalize()}")
            numbers = [float(cell) if cell.strip() else np.nan for cell in cells[column : column + 3]]
            if 0 <= frame < frames and len(numbers) == 3:
                left, up, forward = numbers
                places[frame, k] = forward, left, up
    return places


def by_aniposelib(take: Take, work: Path) -> Array:
    """(F, 12, 3) `LIMBS` by aniposelib's triangulation; NaN where it has none."""
    aniposelib.write(take, work)
    said = run("aniposelib", HERE / "run_aniposelib.py", work, folder=work)
    places = np.array(json.loads(said.splitlines()[-1])["places"], np.float64)
    return places[:, [KEYPOINTS.index(name) for name in LIMBS]]


TOOLS: Final[dict[str, Callable[[Take, Path], Array]]] = {"pose2sim": by_pose2sim, "aniposelib": by_aniposelib}


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="fixed_tools",
    columns=(
        Column("mean", "mean mm", "mm", "{:.1f}"),
        Column("p95", "p95 mm", "mm", "{:.1f}"),
        Column("missing", "missing %", "%", "{:.1f}"),
    ),
    compare=compare,
    takes_cameras=True,
    experiment="keypoints",
    variants="limb joints by",
)
