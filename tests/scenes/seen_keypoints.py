"""The take of `tests.scenes.exported` with keypoints: its joints as each camera sees them, in every frame."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pzcap.export import virtual_cameras
from pzcap.export.take import Take
from pzcap.geometry.camera import project
from pzcap.io.detections import KEYPOINTS
from pzcap.types import JOINTS, Array
from tests.scenes import exported

SHARED = [name for name in KEYPOINTS if name in JOINTS]
ROWS, OWN = ([names.index(name) for name in SHARED] for names in (KEYPOINTS, JOINTS))
"""Of the keypoints that are joints: their places among the keypoints and among the joints."""


def person(number: int, frame: int) -> Array:
    """(26, 3) the athlete as a camera sees it."""
    seen = np.zeros((len(KEYPOINTS), 3))
    seen[ROWS, :2] = project(exported.true_camera(number, frame), exported.joints(frame)[OWN])[0]
    seen[ROWS, 2] = 0.9
    return seen


def take(monkeypatch: pytest.MonkeyPatch, *others: Array) -> Take:
    """The take; ``others`` (3,) are by how much further people stand beside the athlete in every picture."""

    def people(frame: int) -> tuple[Array, ...]:
        rows = []
        for number in range(len(exported.NAMES)):
            mine = person(number, frame)
            rows.append(np.stack([*(mine + other for other in others), mine]))
        return tuple(rows)

    monkeypatch.setattr(virtual_cameras, "frame_sets", lambda _: SimpleNamespace(people=people))
    return Take(exported.reconstruction(), capture=SimpleNamespace())  # type: ignore[arg-type]
