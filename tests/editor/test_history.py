"""What a hand has changed is never lost: undone and done again without end, read back to the same state."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.editor.history import UNTOUCHED, FrameEdit, History
from pzcap.editor.inverse_kinematics import Click
from pzcap.types import Pose, PzcapError
from tests.scenes.bodies import random_pose


def edit(seed: int) -> FrameEdit:
    pose: Pose | None = random_pose(seed) if seed % 4 else None
    clicks = (Click(seed % 23, seed % 3, 0.1 + seed, 1.0 / 3.0, 2.5), Click(2, 1, 7.0, 8.0, 1.0))
    return FrameEdit(pose, "tracker", clicks, frozenset({(5, seed % 4)}), is_key=bool(seed % 2))


def same(one: FrameEdit, other: FrameEdit) -> bool:
    poses = (one.pose is None) == (other.pose is None)
    if one.pose is not None and other.pose is not None:
        poses = np.array_equal(one.pose.rotations, other.pose.rotations)
        poses &= np.array_equal(one.pose.root_position_m, other.pose.root_position_m)
    rest = ("origin", "clicks", "hidden", "is_key")
    return poses and all(getattr(one, name) == getattr(other, name) for name in rest)


def test_undone_to_the_beginning_and_done_again(tmp_path: Path) -> None:
    history = History.open(tmp_path / "h.jsonl")
    for seed in range(1, 40):
        history.change("01:00:00:00", edit(seed), f"{seed}")
    for seed in range(38, 0, -1):
        history.undo()
        assert same(history.frame("01:00:00:00"), edit(seed))
    history.undo()
    assert history.frame("01:00:00:00") is UNTOUCHED
    assert not history.can_undo
    for _ in range(39):
        history.redo()
    assert same(history.frame("01:00:00:00"), edit(39))
    assert not history.can_redo


@settings(max_examples=30, deadline=None)
@given(st.lists(st.sampled_from(["change", "undo", "redo", "found", "again"]), max_size=30))
def test_read_back_it_is_the_same(tmp_path_factory: pytest.TempPathFactory, steps: list[str]) -> None:
    path = tmp_path_factory.mktemp("history") / "h.jsonl"
    history = History.open(path)
    for number, step in enumerate(steps):
        if step == "change":
            history.change(f"01:00:00:0{number % 3}", edit(number), "x")
        elif step == "found":
            history.found("01:00:00:01", edit(number))
        elif step == "undo" and history.can_undo:
            history.undo()
        elif step == "redo" and history.can_redo:
            history.redo()
        elif step == "again":
            history = History.open(path)
    other = History.open(path)
    assert (other.version, other.can_undo, other.can_redo) == (history.version, history.can_undo, history.can_redo)
    assert other.frames.keys() == history.frames.keys()
    assert all(same(other.frames[one], history.frames[one]) for one in history.frames)


def test_half_a_line_is_no_change(tmp_path: Path) -> None:
    path = tmp_path / "h.jsonl"
    history = History.open(path)
    history.change("01:00:00:00", edit(1), "one")
    whole = path.read_bytes()
    history.change("01:00:00:00", edit(2), "two")
    for cut in (len(whole) + 1, len(whole) + 100, path.stat().st_size - 1):
        path.write_bytes(path.read_bytes()[:cut])
        again = History.open(path)
        assert same(again.frame("01:00:00:00"), edit(1))
        again.change("01:00:00:00", edit(2), "two")


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "h.jsonl"
    for line in ('{"what":"x","frame":"01:00:00:00","after":{}}', "[]", '{"undo":"x"}', "nonsense"):
        path.write_text('{"format":"pzcap-edits","version":1}\n' + line + "\n")
        with pytest.raises(PzcapError, match=r"h.jsonl: line 2 is damaged"):
            History.open(path)
    path.write_text('{"format":"other","version":1}\n')
    with pytest.raises(PzcapError, match="line 1"):
        History.open(path)


def test_a_full_disk_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "h.jsonl"
    history = History.open(path)
    history.change("01:00:00:00", edit(1), "one")
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("pzcap.editor.history.os.fsync", full)
        with pytest.raises(OSError, match="No space"):
            history.change("01:00:00:00", edit(2), "two")
    assert path.read_bytes() == before
    assert same(history.frame("01:00:00:00"), edit(1))
    history.change("01:00:00:00", edit(3), "three")
    assert same(History.open(path).frame("01:00:00:00"), edit(3))
