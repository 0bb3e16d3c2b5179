"""Marks of the keyframes on the page, and a world that nobody knows the place of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.own_world import brought_in
from experiments.report import page, plots
from experiments.score import Score, score
from pzcap.geometry.camera import wrapped
from pzcap.scoring.body_errors import BodyErrors
from pzcap.scoring.metric import Metric
from pzcap.types import Reconstruction
from sim.truth import Truth
from tests.scenes import fabricated
from tests.scenes.fabricated_truth import truth_of


def errors(frames: int = 40) -> BodyErrors:
    keyframe = np.zeros(frames, bool)
    keyframe[[0, 20, 39]] = True
    nothing = np.zeros(frames, bool)
    return BodyErrors(
        np.full((frames, 16), 0.01), np.full((frames, 16), 0.01), np.zeros(15), ~nothing, keyframe, nothing, nothing
    )


def test_the_error_over_time_marks_what_is_said_of_the_keyframes() -> None:
    plain = plots.body_error(errors(), [], None)
    advised = plots.body_error(errors(), [20], 30)
    for label in ("contradicted", "next keyframe"):
        assert label not in plain
        assert label in advised


def test_a_report_is_headed_by_the_experiment_and_not_by_its_motion_alone() -> None:
    assert page._experiment("python -m experiments.run experiment=crew seed=0 'hydra.run.dir=a b'") == "crew"
    assert page._experiment("python -m experiments.run seed=0") is None


def test_notes_stand_under_their_camera_and_what_concerns_all_before_them() -> None:
    notes = ["camera 10: turns", "a keyframe would help", "camera 1: zooms", "camera 10: rolls", "camera 3: odd"]
    found = page._by_camera(notes, ["1", "2", "10"])
    assert list(found.items()) == [
        ("", ["a keyframe would help", "camera 3: odd"]), ("Camera 1", ["zooms"]), ("Camera 10", ["turns", "rolls"])
    ]  # fmt: skip
    assert page._by_camera([], ["1"]) == {"": []}


def test_a_run_that_compiled_its_kernels_says_so_beside_its_speed() -> None:
    def remark(compiling_s: float, key: str = "speed.fps") -> str:
        return page._remark({"speed.compiling": Metric("speed.compiling", compiling_s, "s")}, key)

    assert "compiled its kernels for 27 s" in remark(27.4)
    assert remark(0.0) == remark(27.4, "panzoom.pan.rms") == page._remark({}, "speed.fps") == ""


def test_what_the_axis_leaves_out_is_said() -> None:
    whole = errors()
    assert "worst joint up to" not in plots.body_error(whole, [], None)
    whole.joints_m[30, 7] = 0.9
    assert "worst joint up to 900 mm, in frame 30" in plots.body_error(whole, [], None)


def own() -> tuple[Truth, Score, Reconstruction]:
    """A truth, and errors against it of an estimate in a world that is turned, shifted and a tenth smaller."""
    found = fabricated.reconstruction(cameras=2, frames=6)
    truth = truth_of(found)
    assert found.motion is not None
    turn = fabricated.rotation_z(2.0)
    joints = 0.9 * found.motion.joints_m @ turn.T + [3.0, -1.0, 0.5]
    tracks = tuple(
        None if track is None else replace(track, pan_rad=wrapped(track.pan_rad + 2.0)) for track in found.tracks
    )
    moved = replace(found, motion=replace(found.motion, joints_m=joints), tracks=tracks)
    return truth, replace(score(moved, truth, None), own_world=True), moved


def test_a_world_of_its_own_is_shown_beside_a_truth_brought_into_it() -> None:
    truth, result, found = own()
    shown_truth, shown = brought_in(truth, result, found.camera_names)
    assert shown_truth is not None
    assert shown is not None
    assert shown.body is not None
    assert result.body is not None
    assert found.motion is not None
    assert result.body.joints_m.mean() > 1.0
    assert shown.body.joints_m.mean() < 0.1
    off = np.linalg.norm(shown_truth.joints_m[result.truth_frames] - found.motion.joints_m, axis=2)
    np.testing.assert_allclose(off, 0.9 * shown.body.joints_m, rtol=0.05, atol=2e-3)
    for before, after in zip(result.cameras, shown.cameras, strict=True):
        assert before.pan_rad is not None
        assert after.pan_rad is not None
        assert np.abs(before.pan_rad.values[before.pan_rad.valid]).min() > 1.0
        assert np.abs(after.pan_rad.values[after.pan_rad.valid]).max() < 0.05
        assert after.nees is None
        assert after.reprojection_px is None
    assert "NEES" not in plots.honesty(found, shown)


def test_where_an_object_tells_the_world_nothing_is_moved() -> None:
    truth, result, found = own()
    plain = replace(result, own_world=False)
    assert brought_in(truth, plain, found.camera_names) == (truth, plain)


def test_all_cameras_stand_in_the_view_from_above() -> None:
    found = fabricated.reconstruction()
    far = found.cameras[0]
    assert far is not None
    place = far.world_T_head.copy()
    place[:2, 3] = 31.0, -24.0
    low, high = plots._extent(replace(found, cameras=(replace(far, world_T_head=place), *found.cameras[1:])))
    assert high[0] > 31.0
    assert low[1] < -24.0
