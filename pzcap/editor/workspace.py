"""What the page works on: a capture, what was reconstructed of it, and what a hand has changed so far.

All commands come here, from any number of pages, one after the other. Each is made of the state as it is then, so none
is lost; one that takes something back says which version it has seen, and is refused where another page has changed the
state since. After each the history is on the disk, and keyframes.json is what the history says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from pzcap.editor import resolve
from pzcap.editor.alone import BACKUPS, FOLDER, alone
from pzcap.editor.edits import ORIGINS, Edits, posed_in
from pzcap.editor.history import FrameEdit, History
from pzcap.editor.inverse_kinematics import HANDLES, MIRRORED, Click, Held, Problem, handle_name, is_ready
from pzcap.editor.keyframe_file import KeyframeFile, same_pose
from pzcap.editor.motion_file import MotionFile, digest_of
from pzcap.editor.tuning import EDITS, RESOLVE, WORKSPACE
from pzcap.io.capture import read_capture
from pzcap.pipeline import Config
from pzcap.starting_poses import with_clock_sigma
from pzcap.types import Capture, Keyframe, Pose, PzcapError, Reconstruction

_HISTORY: Final = "history.jsonl"
_MOTION: Final = "motion.npz"
_LIMBS: Final = {"arms": ("elbow", "wrist", "fingertip"), "legs": ("knee", "ankle", "toe", "heel")}


@dataclass(frozen=True, slots=True, eq=False)
class Dragged:
    """The body while one of its handles is dragged."""

    frame: int
    click: Click
    pose: Pose
    clicks: tuple[Click, ...]  # all that it is fitted to


class Workspace(Edits):
    """A capture that is being edited. Raises PzcapError where it cannot be. Safe for threads."""

    def __init__(self, capture: Capture, found: Reconstruction) -> None:
        super().__init__(capture, found)
        self.folder = capture.folder / FOLDER
        self._motion_file = MotionFile(self.folder / _MOTION, digest_of(found.motion))
        kept = self._motion_file.load(len(self.sets))
        self.by_keypoints = (
            found.motion is not None and bool(found.motion.valid.any()) and not len(found.motion.keyframes)
        )
        """True if the body was tracked without any keyframe of a hand."""
        self.motion = kept or found.motion or resolve.untracked(len(self.sets))
        self._solved: list[tuple[int, resolve.Difference]] = []  # what was tracked anew, and after how many changes
        self._touched: dict[int, int] = {}  # version in which a frame was changed last
        self._only = alone(self.folder)
        self.history = History.open(self.folder / _HISTORY)
        self._file = KeyframeFile(capture.folder, self.folder / BACKUPS)
        with self.lock:
            self._adopt()
            self._write()

    @property
    def difference(self) -> resolve.Difference | None:
        """The interval that was tracked anew last, against before."""
        return self._solved[-1][1] if self._solved else None

    def close(self) -> None:
        """Let others edit the capture."""
        self._only.close()

    # ----------------------------------------------------------------------------------------------------------
    # Commands

    def drag(self, frame: int, click: Click, before: Dragged | None) -> Dragged:
        """The body as it follows a handle; nothing is changed yet. ``before`` is what the same drag gave last."""
        edit, problem, start = self._taken(frame, click, before)
        clicks, held = edit.clicked(click).clicks, Held.of(posed_in(edit), edit.origin)
        return Dragged(frame, click, problem.solve(start, clicks, held, WORKSPACE.drag_steps).pose, clicks)

    def drop(self, frame: int, click: Click, dragged: Dragged | None) -> None:
        """Take a handle's place in a view as observed, and fit the pose to all that was."""
        with self.lock:
            edit, problem, start = self._taken(frame, click, dragged)
            what = f"{handle_name(click.handle)} in {self._view_name(click.camera)}"
            self._change(frame, self._settled(frame, problem, edit.clicked(click), start, click.handle), what)

    def _taken(self, frame: int, click: Click, before: Dragged | None) -> tuple[FrameEdit, Problem, Pose]:
        """What is dragged: the frame so far, its views, and the pose to go on from."""
        edit, problem = self.edit(frame), self.problem(frame)
        if edit.pose is None or problem.cameras[click.camera] is None:
            raise PzcapError("this view's camera was not found in this frame; drag in another view")
        goes_on = before is not None and (before.frame, before.click[:2]) == (frame, click[:2])
        return edit, problem, before.pose if goes_on and before is not None else edit.pose

    def _settled(self, frame: int, problem: Problem, edit: FrameEdit, start: Pose, *handles: int) -> FrameEdit:
        """The edit with its pose fitted to its clicks from a ``start``, and a keyframe once the pose is sure."""
        fit = problem.settle(start, edit.clicks, Held.of(posed_in(edit), edit.origin), handles)
        sigma = self.sigma_m(frame, problem, replace(edit, pose=fit.pose))
        key = edit.is_key or edit.origin in ("tracker", "keyframe") or is_ready(sigma)
        return replace(edit, pose=fit.pose, is_key=key)

    def unclick(self, frame: int, handle: int, camera: int | None) -> None:
        """Forget the clicks of a handle, in one view or in all."""
        with self.lock:
            edit = self.edit(frame)
            pose, gone = edit.pose, [c for c in edit.clicks if c.handle == handle and camera in (None, c.camera)]
            if not gone or pose is None:
                raise PzcapError(f"{handle_name(handle)} has not been clicked there")
            edit = replace(edit, clicks=tuple(c for c in edit.clicks if c not in gone))
            after = self._settled(frame, self.problem(frame), edit, pose)
            self._change(frame, after, f"{handle_name(handle)}: clicks forgotten")

    def hide(self, frame: int, handle: int, camera: int) -> None:
        """Say that a handle is not to be seen in a view, or take that back; its click there is forgotten."""
        with self.lock:
            edit, place = self.edit(frame), (handle, camera)
            where = f"{handle_name(handle)} in {self._view_name(camera)}"
            if place in edit.hidden:
                self._change(frame, replace(edit, hidden=edit.hidden - {place}), f"{where}: visible")
                return
            clicks = tuple(c for c in edit.clicks if (c.handle, c.camera) != place)
            hidden = replace(edit, clicks=clicks, hidden=edit.hidden | {place})
            if clicks != edit.clicks and edit.pose is not None:
                hidden = self._settled(frame, self.problem(frame), hidden, edit.pose)
            self._change(frame, hidden, f"{where}: not visible")

    def exchange(self, frame: int, limbs: str, seen: int) -> None:
        """Exchange left and right: of the ``limbs`` "arms" or "legs", or of the body as a "whole"; clicks as well."""
        with self.lock:
            self._check_seen(frame, seen)
            edit, problem = self.edit(frame), self.problem(frame)
            ends = _LIMBS.get(limbs, ())
            chosen = [n for n, name in enumerate(HANDLES) if name.partition("_")[2] in ends]
            pose = problem.exchanged(posed_in(edit), chosen)
            swapped = [*chosen] or [*range(len(HANDLES))]
            clicks = tuple(
                one._replace(handle=int(MIRRORED[one.handle])) if one.handle in swapped else one for one in edit.clicks
            )
            hidden = frozenset((int(MIRRORED[h]) if h in swapped else h, c) for h, c in edit.hidden)
            edit = replace(edit, clicks=clicks, hidden=hidden)
            edit = replace(edit, pose=pose)
            edit = self._settled(frame, problem, edit, pose) if clicks else edit
            self._change(frame, edit, f"left and right exchanged: {limbs}")

    def fit_to_images(self, frame: int, seen: int) -> None:
        """Fit the pose to the silhouettes of its frame; the clicks count beside them."""
        with self.lock:
            self._check_seen(frame, seen)
            version, edit, problem = self.version, self.edit(frame), self.problem(frame)
        pose = posed_in(edit)
        known = np.asarray(np.linalg.inv(self._covariance(frame, problem, edit, pose)), np.float64)
        pose = resolve.fitted_to_images(self.footage, self.body, frame, pose, known)
        with self.lock:
            self._check_seen(frame, version)
            self._change(frame, replace(edit, pose=pose), "fitted to the silhouettes")

    def set_key(self, frame: int, is_key: bool) -> None:
        """Make a frame a keyframe as it is, or none."""
        with self.lock:
            edit = self.edit(frame)
            posed_in(edit)
            self._change(frame, replace(edit, is_key=is_key), "made a keyframe" if is_key else "no keyframe any more")

    def begin_from(self, frame: int, origin: str, seen: int) -> None:
        """Begin a frame anew from a pose of that ``origin``; its clicks are forgotten."""
        with self.lock:
            self._check_seen(frame, seen)
            pose = self.start(frame, origin)
            if pose is None:
                raise PzcapError(
                    {
                        "tracker": "the body has not been tracked in this frame",
                        "between": "there is no keyframe on each side to interpolate between",
                        "copied": "there is no keyframe near by to copy",
                    }.get(origin, "two cameras at least must be found in this frame")
                )
            edit = self.history.frame(self._timecodes[frame])
            self._change(frame, FrameEdit(pose, origin, (), edit.hidden, edit.is_key), f"begun anew: {ORIGINS[origin]}")

    def undo(self, seen: int) -> int:
        """Take the latest change back; the frame that it was made in."""
        return self._stepped(seen, self.history.undo, self.history.can_undo, "nothing to undo")

    def redo(self, seen: int) -> int:
        """Make the change again that was undone last; the frame that it is made in."""
        return self._stepped(seen, self.history.redo, self.history.can_redo, "nothing to do again")

    def _stepped(self, seen: int, step: Callable[[], Any], possible: bool, otherwise: str) -> int:
        with self.lock:
            if not possible:
                raise PzcapError(otherwise)
            if seen != self.version:
                raise PzcapError("another page has changed something meanwhile; look, and say it again")
            self._adopt()
            change = step()
            while self._solved and self._solved[-1][0] > self.history.depth:  # with what is undone now
                self.motion = self._solved.pop()[1].before
                self._motion_file.save(self.motion)
            frame = self.frame_of.get(change.timecode, 0)
            self._touched[frame] = self.version
            self._write()
            return frame

    def _check_seen(self, frame: int, seen: int) -> None:
        if seen < self._touched.get(frame, 0):
            raise PzcapError("another page has changed this frame meanwhile; look, and say it again")

    def _change(self, frame: int, after: FrameEdit, what: str) -> None:
        self._adopt()
        self.history.change(self._timecodes[frame], after, what)
        self._touched[frame] = self.version
        self._write()

    # ----------------------------------------------------------------------------------------------------------
    # keyframes.json

    def _adopt(self) -> None:
        """Take in what somebody else has written into keyframes.json since it was last read."""
        digest = self._file.paper.digest()
        if digest == self.history.saved_digest:
            return
        poses = read_capture(self.capture.folder).keyframe_poses
        for timecode, pose in poses.items():
            mine = self.history.frame(timecode)
            if not (mine.is_key and mine.pose is not None and same_pose(mine.pose, pose)):
                self.history.found(timecode, FrameEdit(pose, "keyframe", (), frozenset(), True))
        for timecode, mine in list(self.history.frames.items()):
            if mine.is_key and timecode not in poses:
                self.history.found(timecode, replace(mine, is_key=False))
        self.history.saved(digest)

    def _write(self) -> None:
        """Write keyframes.json as the history has it, where it differs."""
        poses = {self._timecodes[key]: self._posed(key) for key in self.keys()}
        known = {timecode: own for timecode in poses if (own := self.known(self.frame_of[timecode])) is not None}
        digest = self._file.write(poses, known)
        if digest is not None:
            self.history.saved(digest)

    # ----------------------------------------------------------------------------------------------------------
    # Tracking anew

    def solve_again(
        self, frame: int, report: Callable[[int, int], None], cancelled: Callable[[], bool]
    ) -> resolve.Difference:
        """Track the interval around a frame anew from its keyframes; what has changed by it."""
        with self.lock:
            keys, depth = self.keys(), self.history.depth
            ends = resolve.ends(self.motion, keys, frame) if self.by_keypoints and keys else []
            frames = resolve.interval(sorted({*keys, *ends}), frame, len(self.sets), RESOLVE.reach)
            posed = [Keyframe(key, self._posed(key), self.known(key)) for key in keys if key in frames]
            if not posed:
                raise PzcapError("no keyframe of a hand within a second or two; pose the body here first")
            posed += [self._as_tracked(end) for end in ends if end in frames]
        settings = with_clock_sigma(Config().tracking, self.capture)
        posed.sort(key=lambda key: key.frame)
        new = resolve.tracked_anew(self.footage, self.body, posed, frames, settings, report, cancelled)
        with self.lock:
            self.motion, difference = resolve.merged(self.motion, new, frames, keys)
            self._solved = [*self._solved[1 - RESOLVE.kept :], (depth, difference)]
            self._motion_file.save(self.motion)
            return difference

    def _as_tracked(self, frame: int) -> Keyframe:
        pose, problem = self.motion.pose(frame), self.problem(frame)
        known = problem.information(pose, np.maximum(self.motion.sigma_m[frame], EDITS.least_m))
        return Keyframe(frame, pose, np.asarray(np.linalg.inv(known)), found=True)

    def _view_name(self, camera: int) -> str:
        return f"camera {self.footage.found.camera_names[camera]}"
