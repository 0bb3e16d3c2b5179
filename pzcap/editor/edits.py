"""Knowledge of each frame: the work of a hand on it, and the pose that it begins with where there is none."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Final

import numpy as np

from pzcap.body import skeleton
from pzcap.body.anthropometry import UNMEASURED
from pzcap.body.kinematics import difference, retract
from pzcap.body.skeleton import Body
from pzcap.editor.footage import Footage
from pzcap.editor.history import FrameEdit, History
from pzcap.editor.inverse_kinematics import Problem, loose, standing
from pzcap.editor.tuning import EDITS
from pzcap.io.capture import FrameSets, frame_sets
from pzcap.types import Array, Capture, Motion, Pose, PzcapError, Reconstruction

ORIGINS: Final = {
    "keyframe": "a keyframe that was there", "tracker": "as tracked", "between": "between two keyframes",
    "copied": "copied from the nearest keyframe", "standing": "standing",
}  # fmt: skip
"""Origins of a pose, as a person calls them."""


class Edits:
    """The frames of a ``capture`` that is edited, by the cameras that were ``found``. Raises PzcapError where these are
    another capture's. Safe for threads."""

    history: History
    motion: Motion  # as tracked, or tracked anew

    def __init__(self, capture: Capture, found: Reconstruction) -> None:
        self.capture = capture
        self.sets: FrameSets = frame_sets(capture)
        if found.timecodes != self.sets.timecodes or found.camera_names != tuple(c.name for c in capture.cameras):
            raise PzcapError(
                f"{capture.folder}: the results are of '{found.capture_name}', with other frames or cameras; "
                "give those of this capture"
            )
        self.footage = Footage(self.sets, found)
        self.body: Body = skeleton.build(capture.subject or UNMEASURED)
        self.lock = threading.RLock()
        self.frame_of = {timecode.replace(";", ":"): n for n, timecode in enumerate(self.sets.timecodes)}
        self._timecodes = tuple(self.frame_of)

    @property
    def version(self) -> int:
        """It grows with every change."""
        return self.history.version

    def keys(self) -> list[int]:
        """The frames whose pose stands in keyframes.json."""
        with self.lock:
            return sorted(
                self.frame_of[timecode]
                for timecode, edit in self.history.frames.items()
                if edit.is_key and edit.pose is not None and timecode in self.frame_of
            )

    def touched(self) -> list[int]:
        """The frames in which something was clicked."""
        return sorted(self.frame_of[t] for t, edit in self.history.frames.items() if edit.clicks and t in self.frame_of)

    def edit(self, frame: int) -> FrameEdit:
        """A frame by hand; where no hand was, the pose that it begins with."""
        with self.lock:
            edit = self.history.frame(self._timecodes[frame])
            if edit.pose is not None:
                return edit
            pose, origin = self.prediction(frame)
            return replace(edit, pose=pose, origin=origin)

    def prediction(self, frame: int) -> tuple[Pose | None, str]:
        """The pose that a frame begins with, and where that is from: the tracker, else the keyframes around, else one
        near by, else standing in the middle of the views."""
        for origin in ("tracker", "between", "copied"):
            pose = self.start(frame, origin)
            if pose is not None:
                return pose, origin
        return standing(self.footage.cameras(frame)), "standing"

    def start(self, frame: int, origin: str) -> Pose | None:
        """The pose of a frame that comes from an ``origin``; None where that has none."""
        match origin:
            case "tracker":
                return self.motion.pose(frame) if self.motion.valid[frame] else None
            case "between":
                before, after = self._around(frame)
                if before is None or after is None:
                    return None
                share = (frame - before) / (after - before)
                start = self._posed(before)
                return retract(start, share * difference(self._posed(after), start))
            case "copied":
                near = [key for key in self._around(frame) if key is not None and abs(key - frame) <= EDITS.copy_reach]
                return self._posed(min(near, key=lambda key: abs(key - frame))) if near else None
            case _:
                return standing(self.footage.cameras(frame))

    def _around(self, frame: int) -> tuple[int | None, int | None]:
        keys = self.keys()
        return (
            max((key for key in keys if key < frame), default=None),
            min((key for key in keys if key > frame), default=None),
        )

    def _posed(self, key: int) -> Pose:
        pose = self.history.frame(self._timecodes[key]).pose
        assert pose is not None
        return pose

    def problem(self, frame: int) -> Problem:
        """The cameras of a frame, and the body."""
        return Problem(self.body, self.footage.cameras(frame))

    def sigma_m(self, frame: int, problem: Problem, edit: FrameEdit) -> Array:
        """(23,) Standard deviation of each handle's distance from where it is, by the clicks and by what was known
        before these."""
        pose = posed_in(edit)
        return problem.sigma_m(pose, self._covariance(frame, problem, edit, pose))

    def _covariance(self, frame: int, problem: Problem, edit: FrameEdit, pose: Pose) -> Array:
        before = loose(edit.origin)
        if edit.origin == "tracker" and self.motion.valid[frame]:
            before = problem.information(self.motion.pose(frame), np.maximum(self.motion.sigma_m[frame], EDITS.least_m))
        return problem.covariance(pose, edit.clicks, before)

    def known(self, frame: int) -> Array | None:
        """Covariance (43, 43) of a keyframe's pose by its clicks; None where nothing has been clicked: a hand posed it
        otherwise."""
        edit = self.edit(frame)
        if not edit.clicks or edit.pose is None:
            return None
        return self._covariance(frame, self.problem(frame), edit, edit.pose)


def posed_in(edit: FrameEdit) -> Pose:
    """The pose of a frame. PzcapError where there is no body."""
    if edit.pose is None:
        raise PzcapError("there is no body in this frame")
    return edit.pose
