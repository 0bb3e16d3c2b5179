"""A world that the athlete measures out, where there is no calibration object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pzcap.body import skeleton
from pzcap.camera_set import what_is_lacking
from pzcap.initialisation.body_height import standing_height
from pzcap.io.capture import read_capture
from pzcap.types import KnownLength, Mark, PanZoomCamera, Subject
from pzcap.without_object import Placed, in_metres, of_open_size
from tests.scenes.fabricated import reconstruction

_STATURE = Subject({"stature": 1.70}, 0.005)


def test_a_body_is_as_tall_as_its_stature() -> None:
    body = skeleton.build(_STATURE)
    assert standing_height(skeleton.moved(body)) == pytest.approx(1.70, abs=0.02)
    open_size = of_open_size(body, 0.03)
    assert open_size.measured.value("stature") == body.measured.value("stature")
    assert open_size.measured.sigma("stature") == pytest.approx(np.hypot(0.005, 0.03 * 1.70), rel=0.05)


def test_everything_is_scaled_until_the_athlete_is_as_tall_as_measured() -> None:
    body = skeleton.build(_STATURE)
    small = replace(
        skeleton.moved(body),
        offsets_m=0.9 * skeleton.moved(body).offsets_m, skin_m=0.9 * skeleton.moved(body).skin_m,
    )  # fmt: skip
    found = reconstruction()
    assert found.motion is not None
    found = replace(found, motion=replace(found.motion, body=small))
    placed = Placed(body, (None,) * len(found.cameras), (), np.full(len(found.cameras), 0.02), 0.03, False)
    scaled = in_metres(found, placed)
    assert scaled.motion is not None
    np.testing.assert_allclose(scaled.motion.joints_m, found.motion.joints_m / 0.9)  # type: ignore[union-attr]
    for before, after in zip(found.cameras, scaled.cameras, strict=True):
        assert isinstance(before, PanZoomCamera)
        assert isinstance(after, PanZoomCamera)
        np.testing.assert_allclose(after.world_T_head[:3, 3], before.world_T_head[:3, 3] / 0.9)
        np.testing.assert_array_equal(after.world_T_head[:3, :3], before.world_T_head[:3, :3])
        np.testing.assert_allclose(after.offset_m, before.offset_m / 0.9)
    assert "2.2 cm" in scaled.notes[-1]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"full_turn": False}, "all the way round"),
        ({}, "keypoints of two cameras"),
    ],
)
def test_what_cannot_be_done_without_is_named(small_capture: Path, changed: dict[str, bool], told: str) -> None:
    capture = replace(read_capture(small_capture / "capture"), calibration_object=None, full_turn=True)
    assert told in (what_is_lacking(replace(capture, full_turn=changed.get("full_turn", True))) or "")


def test_cameras_in_metres_stay_as_they_are() -> None:
    found = reconstruction()
    placed = Placed(
        skeleton.build(Subject({}, 0.005)), (None,) * len(found.cameras), (), np.full(len(found.cameras), 0.004),
        0.001, True, by_lengths=True,
    )  # fmt: skip
    kept = in_metres(found, placed)
    assert kept.motion is found.motion
    assert kept.cameras is found.cameras
    assert "lengths.json tells how long a metre is, to 0.1 %" in kept.notes[-1]


def test_a_stature_or_a_length_has_to_tell_how_long_a_metre_is(small_capture: Path) -> None:
    capture = read_capture(small_capture / "capture")
    detected = tuple(replace(files, keypoints=small_capture) for files in capture.cameras)
    bare = replace(capture, calibration_object=None, full_turn=True, subject=None, cameras=detected)
    assert "lengths.json" in (what_is_lacking(bare) or "")
    mark = Mark("1", "sweep", 0, np.zeros(2))
    assert what_is_lacking(replace(bare, lengths=(KnownLength("side", 12.0, 0.01, ((mark,), (mark,))),))) is None
