"""What is tracked or fitted anew, against what it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pzcap.body.kinematics import joints, retract
from pzcap.body.skeleton import build
from pzcap.editor import resolve
from pzcap.editor.inverse_kinematics import loose
from pzcap.types import DOF, FrameSet, Pose, PzcapError, Subject
from tests.scenes import edited, tracked

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once


def test_a_pose_is_fitted_to_the_silhouettes_and_to_what_is_known() -> None:
    filmed, views = tracked.clip(), list(tracked.inputs()[0].views)
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


def test_a_body_tracked_from_keypoints_is_held_at_sure_frames() -> None:
    """Sure tracked frames, if a hand has set none near by; from one keyframe alone seconds would be tracked anew."""
    count, sure = 100, [20, 66]
    sigma_m = np.full((count, 16), 0.01)
    sigma_m[:, 5] = 0.03
    sigma_m[[*sure, 70], 5] = 0.02
    motion = replace(resolve.untracked(count), valid=np.arange(count) != 70, sigma_m=sigma_m)
    assert resolve.ends(motion, [50], 50) == sure
    assert resolve.ends(motion, [50, 80], 50) == [20]
    assert resolve.ends(motion, [5, 50], 50) == [66]
    assert resolve.ends(motion, [95], 95) == [66]
    assert resolve.ends(resolve.untracked(count), [50], 50) == []


def test_second_fields_are_seen_halfway_to_the_next_frame(tmp_path: Path) -> None:
    footage = edited.workspace(edited.capture(tmp_path / "capture")).footage
    wrapping = footage.found.tracks[2]
    assert wrapping is not None
    half = 0.5 * (wrapping.pan_rad[4] - wrapping.pan_rad[3])
    wrapping.pan_rad[3:5] = np.pi - half, half - np.pi  # the seam lies between
    image = np.zeros((4, 4, 3), np.uint8)
    woven = FrameSet(3, "01:00:00:03", (image,) * 4, second_fields=(image + 9, image + 9, image + 9, None))
    located = footage.located(woven)
    later = located.second_fields
    assert later is not None
    assert not located.frames.second_fields
    for view, track in enumerate(footage.found.tracks[:3]):
        assert track is not None
        place, picture = later.localisations[view], later.frames.images[view]
        assert place is not None
        assert picture is not None
        assert picture.max() == 9
        assert place.pan_rad == pytest.approx(np.pi if view == 2 else track.pan_rad[3:5].mean())
        assert place.focal_px == pytest.approx(np.sqrt(track.focal_px[3] * track.focal_px[4]))
    assert later.localisations[3] is None
    assert footage.located(replace(woven, second_fields=())).second_fields is None
    assert footage.located(replace(woven, index=edited.FRAMES - 1)).second_fields is None
