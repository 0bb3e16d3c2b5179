"""Commands on a capture: saved at once, what was there kept, several hands at a time, and what a frame begins with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pzcap.body.kinematics import difference, joints
from pzcap.editor import resolve, showing
from pzcap.editor.inverse_kinematics import HANDLES
from pzcap.editor.workspace import Workspace
from pzcap.io.capture import frame_sets, read_capture
from pzcap.types import Keyframe, Motion, PzcapError
from sim.capture_writer import write_keyframes
from tests.scenes import edited

WRIST = HANDLES.index("left_wrist")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return edited.capture(tmp_path / "capture")


def pose_all(space: Workspace, frame: int, views: tuple[int, ...] = (0, 1)) -> None:
    for click in edited.clicks(frame, views):
        space.drop(frame, click, None)


def with_keyframes(folder: Path, *frames: int) -> None:
    write_keyframes(folder / "keyframes.json", {f"01:00:00:{f:02}": edited.true_pose(f) for f in frames})
    content = json.loads((folder / "capture.json").read_text())
    (folder / "capture.json").write_text(json.dumps(content | {"keyframes": "keyframes.json"}))


def test_a_pose_is_a_keyframe_once_it_is_sure_and_is_read_as_one(folder: Path) -> None:
    space = edited.workspace(folder)
    space.drop(3, edited.clicks(3, (0,))[0], None)
    assert space.keys() == []
    assert not (folder / "keyframes.json").exists()
    pose_all(space, 3)
    assert space.keys() == [3]
    (read,) = frame_sets(read_capture(folder)).keyframes
    assert read.frame == 3
    off = joints(edited.BODY, read.pose) - joints(edited.BODY, edited.true_pose(3))
    assert np.linalg.norm(off, axis=1).max() < 0.03


def test_what_clicks_leave_open_is_handed_on_with_the_pose(folder: Path) -> None:
    space = edited.workspace(folder)
    pose_all(space, 3)
    (read,) = frame_sets(read_capture(folder)).keyframes
    assert read.covariance is not None
    assert not read.found
    np.testing.assert_allclose(read.covariance, space.known(3), rtol=1e-4, atol=1e-12)  # type: ignore[arg-type]
    seen = space.problem(3).sigma_m(read.pose, read.covariance)
    np.testing.assert_allclose(seen, space.sigma_m(3, space.problem(3), space.edit(3)), rtol=1e-3)
    space.set_key(5, is_key=True)  # nothing is clicked there: a hand's usual error
    assert [key.covariance is None for key in frame_sets(read_capture(folder)).keyframes] == [False, True]


def test_a_covariance_that_is_none_is_refused(folder: Path) -> None:
    pose_all(edited.workspace(folder), 3)
    path = folder / "keyframes.json"
    content = json.loads(path.read_text())
    content[0]["covariance"][0] = -1.0
    path.write_text(json.dumps(content))
    with pytest.raises(PzcapError, match="not positive definite"):
        read_capture(folder)


def test_somebody_whom_nobody_measured_can_be_posed(folder: Path) -> None:
    content = json.loads((folder / "capture.json").read_text())
    (folder / "capture.json").write_text(json.dumps(content | {"subject": None}))
    space = edited.workspace(folder)
    pose_all(space, 3)
    off = joints(space.body, space.edit(3).pose) - joints(edited.BODY, edited.true_pose(3))  # type: ignore[arg-type]
    assert np.linalg.norm(off, axis=1).max() < 0.15


def test_killed_at_any_time_it_goes_on_where_it_was(folder: Path) -> None:
    space = edited.workspace(folder, tracked=True)
    clicks = edited.clicks(2, (0, 1))[:4]
    for click in clicks:
        space.drop(2, click, None)
        again = edited.workspace(folder, tracked=True)  # nobody said goodbye
        assert again.edit(2).clicks == space.edit(2).clicks
        assert again.keys() == [2]
        assert again.version == space.version
    (folder / "keyframes.json").unlink()  # killed between the history and the file
    content = json.loads((folder / "capture.json").read_text())
    (folder / "capture.json").write_text(json.dumps(content | {"keyframes": None}))
    history = folder / "editing" / "history.jsonl"
    lines = history.read_text().splitlines(keepends=True)
    first = next(n for n, line in enumerate(lines) if "saved" in line)
    history.write_text("".join(lines[:first]))
    assert edited.workspace(folder, tracked=True).keys() == [2]
    assert [key.frame for key in frame_sets(read_capture(folder)).keyframes] == [2]


def test_what_was_there_is_kept_and_what_is_not_touched_stays_to_the_letter(folder: Path) -> None:
    with_keyframes(folder, 0, 8)
    path = folder / "keyframes.json"
    content = json.loads(path.read_text())
    content[0]["by"] = "hand"
    path.write_text(json.dumps(content))
    before = path.read_bytes()
    space = edited.workspace(folder)
    assert space.keys() == [0, 8]
    assert path.read_bytes() == before
    click = edited.clicks(8, (1,))[WRIST]
    space.drop(8, click._replace(x=click.x + 20.0), None)
    after = json.loads(path.read_text())
    assert after[0] == content[0]
    assert after[1] != content[1]
    (backup,) = (folder / "editing" / "backups").iterdir()
    assert backup.read_bytes() == before
    space.undo(space.version)
    assert np.abs(difference(space.edit(8).pose, edited.true_pose(8))).max() < 1e-9  # type: ignore[arg-type]
    assert json.loads(path.read_text())[0] == content[0]
    with pytest.raises(PzcapError, match="nothing to undo"):  # what others have made is not undone
        space.undo(space.version)


def test_what_somebody_else_writes_meanwhile_is_taken_in(folder: Path) -> None:
    with_keyframes(folder, 0)
    space = edited.workspace(folder)
    with_keyframes(folder, 0, 5)
    space.set_key(9, is_key=True)
    assert space.keys() == [0, 5, 9]
    assert np.abs(difference(space.edit(5).pose, edited.true_pose(5))).max() < 1e-9  # type: ignore[arg-type]


def test_without_keyframes_capture_json_names_none(folder: Path) -> None:
    space = edited.workspace(folder)
    space.set_key(4, is_key=True)
    assert [key.frame for key in frame_sets(read_capture(folder)).keyframes] == [4]
    space.undo(space.version)
    assert json.loads((folder / "capture.json").read_text())["keyframes"] is None
    assert not (folder / "keyframes.json").exists()
    read_capture(folder)
    space.redo(space.version)
    assert space.keys() == [4]


def test_two_pages_lose_nothing_and_do_not_undo_each_other_unseen(folder: Path) -> None:
    space = edited.workspace(folder, tracked=True)
    seen = space.version
    first, second = edited.clicks(1, (0, 1))[:2]
    space.drop(1, first, None)
    space.drop(1, second, None)
    assert set(space.edit(1).clicks) == {first, second}
    with pytest.raises(PzcapError, match="another page"):
        space.undo(seen)
    with pytest.raises(PzcapError, match="another page"):
        space.begin_from(1, "standing", seen)
    space.exchange(2, "whole", seen)  # another frame than the one that was changed
    assert space.undo(space.version) == 2


def test_a_frame_begins_with_the_best_that_is_known(folder: Path) -> None:
    assert edited.workspace(folder, tracked=True).prediction(5)[1] == "tracker"
    space = edited.workspace(folder)
    pose, origin = space.prediction(5)
    assert origin == "standing"
    assert pose is not None
    assert np.linalg.norm(pose.root_position_m[:2] - edited.true_pose(5).root_position_m[:2]) < 0.5
    pose_all(space, 2)
    assert space.prediction(5)[1] == "copied"
    pose_all(space, 8)
    pose, origin = space.prediction(5)
    assert origin == "between"
    assert pose is not None
    ends = [joints(edited.BODY, edited.true_pose(f)) for f in (2, 8)]
    assert np.linalg.norm(joints(edited.BODY, pose) - np.mean(ends, axis=0), axis=1).max() < 0.1
    with pytest.raises(PzcapError, match="has not been tracked"):
        space.begin_from(5, "tracker", space.version)


def test_hidden_forgotten_and_exchanged(folder: Path) -> None:
    space = edited.workspace(folder, tracked=True)
    pose_all(space, 0)
    count = len(space.edit(0).clicks)
    space.hide(0, WRIST, 1)
    assert len(space.edit(0).clicks) == count - 1
    assert (WRIST, 1) in space.edit(0).hidden
    space.hide(0, WRIST, 1)
    assert not space.edit(0).hidden
    space.unclick(0, WRIST, None)
    assert len(space.edit(0).clicks) == count - 2
    with pytest.raises(PzcapError, match="left wrist has not been clicked"):
        space.unclick(0, WRIST, 0)
    before = {one[:2] for one in space.edit(0).clicks}
    space.exchange(0, "legs", space.version)
    knees = [HANDLES.index("left_knee"), HANDLES.index("right_knee")]
    moved = {one.handle: (one.x, one.y) for one in space.edit(0).clicks if one.camera == 0}
    assert moved[knees[0]] == tuple(edited.true_pixels(0, 0)[knees[1]])
    assert {one[:2] for one in space.edit(0).clicks} == before


def test_a_drag_changes_nothing_before_it_is_dropped(folder: Path) -> None:
    space = edited.workspace(folder, tracked=True)
    click = edited.clicks(6, (2,))[WRIST]
    dragged = space.drag(6, click, None)
    assert (space.version, space.edit(6).clicks) == (0, ())
    told = showing.drag(space, dragged)
    assert told["handles"][2][WRIST] == pytest.approx([click.x, click.y], abs=1.5)
    assert [bool(line) for line in told["lines"]] == [True, True, False, True]
    space.drop(6, click, dragged)
    assert space.edit(6).clicks == (click,)
    space.footage._cameras[7] = (None,) * 4
    with pytest.raises(PzcapError, match="camera was not found"):
        space.drop(7, click, None)


def test_a_body_tracked_from_keypoints_is_solved_again_near_keyframes_alone(folder: Path) -> None:
    motion = edited.found(tracked=True).motion
    assert motion is not None
    many = replace(edited.found(tracked=True), motion=replace(motion, keyframes=np.zeros(0, np.int64)))
    space = Workspace(read_capture(folder), many)
    assert showing.overview(space)["by_keypoints"]
    with pytest.raises(PzcapError, match="no keyframe to track from"):
        space.solve_again(3, lambda *_: None, lambda: False)
    space.set_key(0, is_key=True)
    solved: list[list[Keyframe]] = []

    def anew(*given: Any) -> Motion:
        solved.append(given[2])
        raise PzcapError("stopped")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resolve, "tracked_anew", anew)
        patch.setattr(resolve, "ends", lambda *_: [9])
        with pytest.raises(PzcapError, match="stopped"):
            space.solve_again(0, lambda *_: None, lambda: False)
        assert [(key.frame, key.found) for key in solved[0]] == [(0, False), (9, True)]
        held = solved[0][1]
        assert held.covariance is not None
        assert space.problem(9).sigma_m(held.pose, held.covariance)[:16].max() < 0.01  # as the motion has it
        patch.setattr(resolve, "ends", lambda *_: [5, 9])
        with pytest.raises(PzcapError, match="no keyframe of a hand"):
            space.solve_again(7, lambda *_: None, lambda: False)
    space.close()


def test_frames_are_proposed_and_told(folder: Path) -> None:
    space = edited.workspace(folder)
    assert [one["frame"] for one in showing.overview(space)["suggested"]][:3] == [0, 11, 5]
    told = json.dumps([showing.about(space), showing.frame(space, 3), showing.silhouettes(space, 3)])
    assert "NaN" not in told
    tracked = edited.workspace(folder, tracked=True)
    tracked.motion.sigma_m[6, 4:7] = 0.3
    best = showing.overview(tracked)["suggested"]
    assert best[0]["why"] == "left arm least certain"
    tracked.set_key(best[0]["frame"], is_key=True)
    assert showing.overview(tracked)["suggested"][0]["frame"] != best[0]["frame"]
    tracked.set_key(best[0]["frame"], is_key=False)
    tracked.motion = replace(tracked.motion, keyframes=np.zeros(0, np.int64))  # as from keypoints
    (least, *_) = showing.overview(tracked)["suggested"]
    assert abs(least["frame"] - 6) <= 4
    assert least["why"] == "left arm least certain"


def test_pictures_of_any_frame_in_any_order(folder: Path) -> None:
    space = edited.workspace(folder)
    for frame in (7, 2, 3, 11, 0, 7):
        picture = space.footage.images(frame)[1]
        assert picture is not None
        assert abs(float(picture.mean()) - 90 - 4 * frame) < 2.5
        jpeg = space.footage.jpeg(frame, 1)
        assert jpeg is not None
        assert jpeg[:2] == b"\xff\xd8"


def test_results_of_another_take_are_refused(folder: Path) -> None:
    other = replace(edited.found(), timecodes=tuple(f"02:00:00:{n:02}" for n in range(edited.FRAMES)))
    with pytest.raises(PzcapError, match="other frames or cameras"):
        Workspace(read_capture(folder), other)


def test_what_was_solved_again_is_kept_until_other_results_come(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    space = edited.workspace(folder, tracked=True)
    space.set_key(0, is_key=True)
    old = space.motion
    frames = np.arange(edited.FRAMES)

    def tracked_anew(_: object, __: object, keys: list[Keyframe], which: range, *___: object) -> Motion:
        assert [key.frame for key in keys] == [0]
        arrays = {name: getattr(old, name)[frames[which]] for name in ("rotations", "joints_m", "sigma_m", "valid")}
        return Motion(old.root_position_m[frames[which]] + 0.1, keyframes=np.array([0]), **arrays)

    monkeypatch.setattr("pzcap.editor.resolve.tracked_anew", tracked_anew)
    change = space.solve_again(4, lambda *_: None, lambda: False)
    assert change.frames == range(edited.FRAMES)
    again = edited.workspace(folder, tracked=True)
    assert np.allclose(again.motion.root_position_m, old.root_position_m + 0.1)
    assert edited.workspace(folder).prediction(5)[1] != "tracker"


def test_undoing_a_pose_undoes_what_was_solved_with_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    space = edited.workspace(folder, tracked=True)
    old = space.motion

    def tracked_anew(_: object, __: object, ___: object, which: range, *____: object) -> Motion:
        arrays = {name: getattr(space.motion, name)[which] for name in ("rotations", "joints_m", "sigma_m", "valid")}
        return Motion(space.motion.root_position_m[which] + 0.1, keyframes=np.array([0]), **arrays)

    monkeypatch.setattr("pzcap.editor.resolve.tracked_anew", tracked_anew)
    for key in (0, 5):
        space.set_key(key, is_key=True)
        space.solve_again(key, lambda *_: None, lambda: False)
    space.set_key(7, is_key=True)
    solved = space.motion
    space.undo(space.version)  # nothing was solved with that
    assert space.motion is solved
    space.undo(space.version)
    assert np.allclose(space.motion.root_position_m, old.root_position_m + 0.1)
    space.undo(space.version)
    assert np.array_equal(space.motion.root_position_m, old.root_position_m)
    assert space.difference is None
    assert np.array_equal(edited.workspace(folder, tracked=True).motion.root_position_m, old.root_position_m)


def test_one_editor_at_a_time(folder: Path) -> None:
    space = edited.workspace(folder)
    with pytest.raises(PzcapError, match="another editor is at work on it"):
        Workspace(read_capture(folder), edited.found())
    space.close()
    Workspace(read_capture(folder), edited.found()).close()
