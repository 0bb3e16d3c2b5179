"""What is tracked or fitted anew, against what it was."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pzcap.body.kinematics import joints, retract
from pzcap.body.skeleton import DOF, build
from pzcap.editor import resolve
from pzcap.editor.inverse_kinematics import loose
from pzcap.types import Pose, PzcapError, Subject
from tests.scenes import edited, tracked
from tests.scenes.body_scene import shoot


def test_a_pose_is_fitted_to_the_silhouettes_and_to_what_is_known() -> None:
    filmed = shoot(1)
    (views,) = (list(one.views) for one in tracked.inputs_of(filmed))
    footage: Any = SimpleNamespace(views=lambda *_: views)
    body = build(Subject(filmed.measurements_m, 0.001))
    rng = np.random.default_rng(0)
    error = np.concatenate([[0.02, -0.03, 0.02], rng.normal(0, np.deg2rad(3.0), DOF - 3)])
    rough = retract(filmed.poses[0], error)

    def off_m(pose: Pose) -> float:
        return float(np.linalg.norm(joints(body, pose) - filmed.joints_m[0], axis=1).mean())

    fitted = resolve.fitted_to_images(footage, body, 0, rough, loose("between"))
    assert off_m(fitted) < 0.4 * off_m(rough)
    held = resolve.fitted_to_images(footage, body, 0, rough, 1e6 * loose("keyframe"))
    assert np.abs(joints(body, held) - joints(body, rough)).max() < 1e-3
    footage.views = lambda *_: [None] * 4
    with pytest.raises(PzcapError, match="no view of this frame shows the athlete"):
        resolve.fitted_to_images(footage, body, 0, rough, loose("between"))


def test_what_was_tracked_anew_stands_against_what_was_before() -> None:
    old = edited.found(tracked=True).motion
    assert old is not None
    frames = range(3, 7)
    new = replace(
        old, root_position_m=old.root_position_m[frames], rotations=old.rotations[frames],
        joints_m=old.joints_m[frames] + [0.03, 0.0, 0.04], sigma_m=np.full((4, 16), 0.007), keyframes=np.array([3, 6]),
        valid=np.array([True, True, False, True]),
    )  # fmt: skip
    motion, change = resolve.merged(old, new, frames, [3, 6, 11])
    assert np.allclose(change.moved_m, [[0.05] * 16] * 2 + [[0.0] * 16] + [[0.05] * 16])
    assert change.known_before
    assert np.array_equal(motion.joints_m[7:], old.joints_m[7:])
    assert np.array_equal(motion.joints_m[frames], new.joints_m)
    assert motion.valid.tolist() == [n != 5 for n in range(edited.FRAMES)]
    assert motion.keyframes.tolist() == [3, 6, 11]  # the first one of old is none any more


def test_intervals_end_at_keyframes() -> None:
    assert resolve.interval([10, 30, 50], 20, 100, 40) == range(10, 31)
    assert resolve.interval([10, 30, 50], 30, 100, 40) == range(10, 51)
    assert resolve.interval([10], 10, 100, 40) == range(0, 51)
    assert resolve.interval([50], 20, 100, 40) == range(0, 51)
    assert resolve.interval([50], 70, 100, 40) == range(50, 100)
    with pytest.raises(PzcapError, match="no keyframe"):
        resolve.interval([], 3, 100, 40)
