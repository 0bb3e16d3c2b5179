"""Pose2Sim: a project of virtual fixed cameras: calibration, keypoints carried over to them, and Config.toml.

Its reader ignores distortion, which virtual cameras do not have. Metres; world to camera; pixel (0, 0) the centre of
the top-left pixel, as ours; the world keeps z up, and Pose2Sim turns its results to y up itself.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pzcap.export.take import Take, write_text
from pzcap.export.toml import toml
from pzcap.export.virtual_cameras import carried_keypoints, virtual_cameras
from pzcap.io.detections import BODY_25, KEYPOINTS
from pzcap.types import Array

_MODELS: Final[dict[str, tuple[str, ...]]] = {
    "Body_with_feet": KEYPOINTS, "BODY_25": BODY_25, "COCO_17": KEYPOINTS[:17],
}  # fmt: skip
"""Pose2Sim's models of what a detector knows, and their keypoints in its order."""
_UNUSED: Final = ("left_eye", "right_eye", "left_ear", "right_ear")
"""Keypoints that none of these models takes from a detector."""


def write(take: Take, folder: Path) -> list[Path]:
    """Write the project, with keypoints where the capture has any; the files."""
    virtual = virtual_cameras(take)
    names = [f"cam{k:02d}" for k in range(1, len(virtual) + 1)]  # sorted by the last number in them
    cameras = {name: each.opencv(name) for name, each in zip(names, virtual, strict=True)}
    calibration = toml({**cameras, "metadata": {"adjusted": False, "error": 0.0}})
    files = [write_text(folder / "calibration" / "Calib_pzcap.toml", calibration)]
    found = carried_keypoints(take, virtual)
    model = _model([person for rows in found for people in rows for person in people])
    files.append(write_text(folder / "Config.toml", toml(_settings(take, model))))
    order = [KEYPOINTS.index(name) for name in _MODELS[model]]
    for name, rows in zip(names, found, strict=False):
        for frame, people in enumerate(rows):
            persons = [{"person_id": [-1], "pose_keypoints_2d": person[order].ravel().tolist()} for person in people]
            text = json.dumps({"version": 1.3, "people": persons})
            files.append(write_text(folder / "pose" / f"{name}_json" / f"{name}_{frame:06d}.json", text))
    return files


def _model(people: Sequence[Array]) -> str:
    """The largest model of which every keypoint was found in somebody (26, 3): Pose2Sim puts those that never are into
    the origin, and its inverse kinematics pulls the body there."""
    if not people:
        return next(iter(_MODELS))
    known = {KEYPOINTS[k] for k in np.flatnonzero(np.max(people, axis=0)[:, 2] > 0.0)}
    whole = (model for model, names in _MODELS.items() if known.issuperset(set(names) - set(_UNUSED)))
    return next(whole, "COCO_17")


def _settings(take: Take, model: str) -> dict[str, dict[str, object]]:
    """Settings that Pose2Sim would take from videos, or ask on a screen. Its own defaults hold for all else."""
    return {
        "project": {"multi_person": False, "frame_rate": float(take.reconstruction.frame_rate), "frame_range": "all"},
        "pose": {"pose_model": model, "vid_img_extension": "mp4"},
        "triangulation": {
            "reproj_error_threshold_triangulation": 15,
            "likelihood_threshold_triangulation": 0.3,
            "min_cameras_for_triangulation": 2,
            "interpolation": "linear",
            "interp_if_gap_smaller_than": 20,
            "make_c3d": False,
        },
        "filtering": {"display_figures": False, "save_filt_plots": False, "make_c3d": False},
    }
