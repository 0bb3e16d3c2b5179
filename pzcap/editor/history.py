"""Every change that a hand has made to the frames of a capture: kept in order, undone and done again without end.

The history is a file of lines, one a change, and nothing is ever taken out of it: undoing is a line, too. A change is
on the disk before anyone hears that it was made, so a server that is killed has lost nothing; a line that was not
finished is not a change. Read from its beginning, the file gives the frames as they are now.
"""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from pzcap.editor.inverse_kinematics import HANDLES, LOOSENESS, Click
from pzcap.io.files import checked
from pzcap.types import SEGMENTS, Pose, PzcapError

FORMAT: Final = {"format": "pzcap-edits", "version": 1}
"""First line of the file."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameEdit:
    """What a hand has made of a frame."""

    pose: Pose | None = None  # None: there is none, and the body stands where its prediction has it
    origin: str = "standing"  # of the pose before any click: one of `inverse_kinematics.LOOSENESS`
    clicks: tuple[Click, ...] = ()
    hidden: frozenset[tuple[int, int]] = frozenset()  # handle and camera: said not to be seen there
    is_key: bool = False  # the pose stands in keyframes.json

    def click(self, handle: int, camera: int) -> Click | None:
        """The click of a handle in a view."""
        return next((one for one in self.clicks if (one.handle, one.camera) == (handle, camera)), None)

    def clicked(self, new: Click) -> FrameEdit:
        """With one more click, in place of an older one of the same handle in the same view."""
        others = (one for one in self.clicks if (one.handle, one.camera) != (new.handle, new.camera))
        return replace(self, clicks=(*others, new), hidden=self.hidden - {(new.handle, new.camera)})


UNTOUCHED: Final = FrameEdit()


@dataclass(frozen=True, slots=True)
class Change:
    """A frame before and after."""

    timecode: str
    what: str
    before: FrameEdit
    after: FrameEdit


@dataclass(slots=True)
class History:
    """The changes of a capture, and what they make of its frames. Not safe for threads: its owner has a lock."""

    path: Path
    frames: dict[str, FrameEdit] = field(default_factory=dict)  # by timecode
    version: int = 0  # number of lines so far; it grows with every change
    saved_digest: str = ""  # of keyframes.json, as it was last written or read
    _done: list[Change] = field(default_factory=list)
    _undone: list[Change] = field(default_factory=list)

    @staticmethod
    def open(path: Path) -> History:
        """The history in a file, which is made with its first change. PzcapError where it cannot be read."""
        history = History(path)
        if not checked(path).is_file():
            return history
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):  # a line that was being written when the server was killed
            with path.open("r+b") as file:
                file.truncate(len(whole))
        lines = whole.decode("utf-8", "replace").splitlines()
        for number, line in enumerate(lines, start=1):
            try:
                entry = json.loads(line)
                if number == 1 and entry != FORMAT:
                    raise ValueError("is not of this format and version")
                if number > 1:
                    history._apply(entry)
            except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
                raise PzcapError(
                    f"{path}: line {number} is damaged ({error}); move the file away to begin from keyframes.json"
                ) from error
        return history

    @property
    def can_undo(self) -> bool:
        return bool(self._done)

    @property
    def depth(self) -> int:
        """Number of changes that can be undone."""
        return len(self._done)

    @property
    def can_redo(self) -> bool:
        return bool(self._undone)

    def frame(self, timecode: str) -> FrameEdit:
        """What a hand has made of a frame by now."""
        return self.frames.get(timecode, UNTOUCHED)

    def change(self, timecode: str, after: FrameEdit, what: str) -> None:
        """Make a change; it is on the disk when this returns."""
        self._keep({"what": what, "frame": timecode, "after": _to_json(after)})

    def undo(self) -> Change:
        """Take the latest change back."""
        change = self._done[-1]
        self._keep({"undo": change.what})
        return change

    def redo(self) -> Change:
        """Make the change again that was taken back last."""
        change = self._undone[-1]
        self._keep({"redo": change.what})
        return change

    def found(self, timecode: str, after: FrameEdit) -> None:
        """Take in what somebody else has made of a frame. Nobody here can undo it."""
        self._keep({"found": timecode, "after": _to_json(after)})

    def saved(self, digest: str) -> None:
        """Note that keyframes.json holds what it should, by its digest."""
        self._keep({"saved": digest})

    def _keep(self, entry: dict[str, Any]) -> None:
        """Write a line, then act on it."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        before = self.path.stat().st_size if self.path.exists() else 0
        lines = [entry] if before else [FORMAT, entry]
        text = "".join(json.dumps(line, separators=(",", ":"), ensure_ascii=False) + "\n" for line in lines)
        try:
            with self.path.open("ab") as file:
                file.write(text.encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError:  # such as a full disk: what was written of it is no change
            with contextlib.suppress(OSError), self.path.open("r+b") as file:
                file.truncate(before)
            raise
        self._apply(entry)

    def _apply(self, entry: dict[str, Any]) -> None:
        if "saved" in entry:
            self.saved_digest = str(entry["saved"])
        elif "found" in entry:
            self.frames[str(entry["found"])] = _from_json(entry["after"])
        elif "undo" in entry:
            change = self._done.pop()
            self.frames[change.timecode] = change.before
            self._undone.append(change)
        elif "redo" in entry:
            change = self._undone.pop()
            self.frames[change.timecode] = change.after
            self._done.append(change)
        else:
            timecode, after = str(entry["frame"]), _from_json(entry["after"])
            self._done.append(Change(timecode, str(entry["what"]), self.frame(timecode), after))
            self._undone.clear()
            self.frames[timecode] = after
        self.version += 1


def _to_json(edit: FrameEdit) -> dict[str, Any]:
    pose = edit.pose
    return {
        "root_position_m": None if pose is None else pose.root_position_m.tolist(),
        "rotations_wxyz": None if pose is None else pose.rotations.tolist(),
        "origin": edit.origin,
        "clicks": [[HANDLES[one.handle], one.camera, one.x, one.y, one.sigma_px] for one in edit.clicks],
        "hidden": [[HANDLES[handle], camera] for handle, camera in sorted(edit.hidden)],
        "is_key": edit.is_key,
    }


def _from_json(value: dict[str, Any]) -> FrameEdit:
    pose = None
    if value["rotations_wxyz"] is not None:
        root, rotations = np.array(value["root_position_m"], float), np.array(value["rotations_wxyz"], float)
        if root.shape != (3,) or rotations.shape != (len(SEGMENTS), 4) or not np.isfinite(rotations).all():
            raise ValueError("no pose")
        pose = Pose(root, rotations)
    if value["origin"] not in LOOSENESS:
        raise ValueError("no origin")
    return FrameEdit(
        pose,
        value["origin"],
        tuple(Click(HANDLES.index(name), int(camera), *map(float, rest)) for name, camera, *rest in value["clicks"]),
        frozenset((HANDLES.index(name), int(camera)) for name, camera in value["hidden"]),
        bool(value["is_key"]),
    )
