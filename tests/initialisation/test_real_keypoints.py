"""Keypoints of a real detector: BlazePose on rendered pictures of a tumbler (`experiments.compare detectors`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pzcap.initialisation.people import Detections, athlete
from pzcap.initialisation.triangulation import rays_of, triangulate
from pzcap.initialisation.tuning import PEOPLE
from pzcap.io.detections import KEYPOINTS
from pzcap.types import JOINTS, Array, Camera

_FILE = Path(__file__).parents[1] / "scenes" / "blazepose.json"
_LIMBS = [(f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in (("hip", "knee"), ("knee", "ankle"))]


@pytest.fixture(scope="module")
def instants() -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(_FILE.read_text())["instants"]
    return found


def _camera(view: dict[str, Any]) -> Camera:
    pose, principal = np.array(view["world_T_cam"]), np.array(view["principal_px"])
    return Camera(*view["size"], pose, view["focal_px"], principal, view["k1"])


def _detections(instant: dict[str, Any]) -> Detections:
    views = []
    for view in instant["views"]:
        people = np.array(view["people"]).reshape(-1, 26, 3) if view else None
        views.append(None if people is None else (_camera(view), people))
    return Detections(tuple(views))


def _lengths(points: Array, names: tuple[str, ...]) -> Array:
    at = {name: row for row, name in enumerate(names)}
    return np.array([np.linalg.norm(points[at[a]] - points[at[b]]) for a, b in _LIMBS])


def test_views_of_a_real_detector_meet_in_limbs_of_the_right_length(instants: list[dict[str, Any]]) -> None:
    off = []
    for sighting, instant in zip(athlete([_detections(one) for one in instants]), instants, strict=True):
        views = [view for view in sighting if view is not None]
        if len(views) < 2:
            continue
        met = triangulate(rays_of(views, PEOPLE.least_confidence), PEOPLE.agree_m)
        if all(met.found[KEYPOINTS.index(name)] for pair in _LIMBS for name in pair):
            off.append(np.abs(_lengths(met.points_m, KEYPOINTS) - _lengths(np.array(instant["joints_m"]), JOINTS)))
    assert len(off) >= len(instants) // 2
    assert np.median(off) < 0.05
