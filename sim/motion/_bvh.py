"""BVH files: a tree of joints, and how it moves.

A joint's frame has the axes of the file while the figure is at rest; its channels turn and move it against its parent.
Rotation channels apply in the order in which they are listed, each about the axis as the ones before it left it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.io.files import checked
from pzcap.types import Array, PzcapError

_POSITIONS: Final = ("xposition", "yposition", "zposition")
_ROTATIONS: Final = ("xrotation", "yrotation", "zrotation")


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """A figure of J joints, in the file's own axes and its own unit of length. A parent stands before its children."""

    path: Path
    names: tuple[str, ...]
    parents: tuple[int, ...]  # -1: the root
    rest: Array  # (J, 3) joints while the figure is at rest
    tips: dict[int, Array]  # joint -> (3,) end of a joint that has no children, at rest, if the file says it
    frame_s: float  # between frames
    places: Array  # (T, J, 3) joints
    turns: Array  # (T, J, 3, 3) their frames


@dataclass(slots=True)
class _Joint:
    name: str
    parent: int
    offset: Array = field(default_factory=lambda: np.zeros(3))  # (3,) from the parent
    channels: tuple[str, ...] = ()
    tip: Array | None = None  # (3,) from this joint


def read_bvh(path: Path) -> Bvh:
    """Read a BVH file. Raises PzcapError, with the line, where it does not say what it should."""
    try:
        lines = _Lines(path, checked(path).read_text(encoding="utf-8-sig").splitlines())
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text"
        raise PzcapError(f"{path}: cannot read the motion: {reason}") from error
    lines.expect("HIERARCHY")
    joints: list[_Joint] = []
    _read_joint(lines, joints, lines.expect("ROOT"), -1)
    frame_s, values = _read_motion(lines, sum(len(joint.channels) for joint in joints))
    return _placed(path, joints, frame_s, values)


class _Lines:
    """The lines that say something, one after another. A brace always stands on a line of its own."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        self._path = path
        self._lines = [
            (number, part.split())
            for number, line in enumerate(lines, start=1)
            for part in line.replace("{", "\n{\n").replace("}", "\n}\n").split("\n")
            if part.strip()
        ]
        self._at = 0

    def left(self) -> int:
        return len(self._lines) - self._at

    def peek(self) -> str:
        """The next line's first word in capitals; nothing at the end of the file."""
        return self._lines[self._at][1][0].upper() if self.left() else ""

    def take(self) -> list[str]:
        if not self.left():
            raise PzcapError(f"{self._path}: the file ends too early; export it again")
        self._at += 1
        return self._lines[self._at - 1][1]

    def expect(self, *start: str) -> list[str]:
        """The words of the next line behind those that it must begin with."""
        words = self.take()
        if tuple(word.upper() for word in words[: len(start)]) != tuple(word.upper() for word in start):
            raise self.wrong(f"'{' '.join(start)}' must stand here, not '{' '.join(words[:4])}'")
        return words[len(start) :]

    def wrong(self, what: str) -> PzcapError:
        """The error about the line that was taken last."""
        number = self._lines[self._at - 1][0]
        return PzcapError(f"{self._path}: line {number}: {what}")

    def numbers(self, words: list[str], count: int, what: str) -> list[float]:
        """So many finite numbers, words of the line that was taken last."""
        if len(words) != count:
            raise self.wrong(f"{what}: {len(words)} values where {count} belong")
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise self.wrong(
                f"{what}: {str(error).removeprefix('could not convert string to float: ')} is no number"
            ) from error
        if not all(map(math.isfinite, values)):
            raise self.wrong(f"{what}: not every value is finite")
        return values


def _read_joint(lines: _Lines, joints: list[_Joint], name: list[str], parent: int) -> None:
    """Read a joint and all that hangs from it, from its opening brace to its closing one."""
    joint = _Joint(" ".join(name), parent)
    if not joint.name or any(joint.name == other.name for other in joints):
        raise lines.wrong("a joint must have a name of its own")
    index = len(joints)
    joints.append(joint)
    lines.expect("{")
    joint.offset = np.array(lines.numbers(lines.expect("OFFSET"), 3, "OFFSET"))
    if lines.peek() == "CHANNELS":
        joint.channels = _read_channels(lines)
    while lines.peek() != "}":
        if lines.peek() == "END":
            lines.expect("End", "Site")
            lines.expect("{")
            joint.tip = np.array(lines.numbers(lines.expect("OFFSET"), 3, "OFFSET"))
            lines.expect("}")
        else:
            _read_joint(lines, joints, lines.expect("JOINT"), index)
    lines.expect("}")


def _read_channels(lines: _Lines) -> tuple[str, ...]:
    count, *channels = lines.expect("CHANNELS") or [""]
    channels = [channel.lower() for channel in channels]
    if count != str(len(channels)):
        raise lines.wrong(f"CHANNELS says '{count}' and names {len(channels)}")
    for channel in channels:
        if channel not in _POSITIONS + _ROTATIONS or channels.count(channel) > 1:
            raise lines.wrong(f"'{channel}' is no channel, or stands here twice; there are Xposition ... Zrotation")
    return tuple(channels)


def _read_motion(lines: _Lines, channels: int) -> tuple[float, Array]:
    """Seconds a frame, and the values (T, channels)."""
    lines.expect("MOTION")
    (count,) = lines.numbers(lines.expect("Frames:"), 1, "Frames")
    (frame_s,) = lines.numbers(lines.expect("Frame", "Time:"), 1, "Frame Time")
    if frame_s <= 0.0:
        raise lines.wrong(f"Frame Time is {frame_s:g}; it must be more than 0")
    follow = lines.left()
    if count not in (follow, follow - 1) or follow < 2:  # Rokoko counts the steps between them
        raise lines.wrong(f"{count:g} frames are announced and {follow} follow; there must be as many, 2 or more")
    return frame_s, np.array([lines.numbers(lines.take(), channels, "this frame") for _ in range(follow)])


def _placed(path: Path, joints: list[_Joint], frame_s: float, values: Array) -> Bvh:
    """Run the forward kinematics."""
    count = len(values)
    rest = np.zeros((len(joints), 3))
    places, turns = np.empty((count, len(joints), 3)), np.empty((count, len(joints), 3, 3))
    at = 0
    for j, joint in enumerate(joints):
        own = dict(zip(joint.channels, values[:, at : at + len(joint.channels)].T, strict=True))
        at += len(joint.channels)
        # A position channel takes the place of the offset.
        moved = np.stack([own.get(c, np.full(count, x)) for c, x in zip(_POSITIONS, joint.offset, strict=True)], axis=1)
        turning = [channel for channel in joint.channels if channel in _ROTATIONS]
        turned = np.tile(np.eye(3), (count, 1, 1))
        if turning:
            angles = np.stack([own[channel] for channel in turning], axis=1)
            order = "".join(channel[0].upper() for channel in turning)
            turned = Rotation.from_euler(order, angles, degrees=True).as_matrix().reshape(count, 3, 3)
        if joint.parent < 0:
            places[:, j], turns[:, j] = moved, turned
        else:
            placed_by_channels = not joint.offset.any() and set(_POSITIONS) <= set(own)
            rest[j] = rest[joint.parent] + (moved[0] if placed_by_channels else joint.offset)
            places[:, j] = places[:, joint.parent] + np.einsum("tij,tj->ti", turns[:, joint.parent], moved)
            turns[:, j] = turns[:, joint.parent] @ turned
    names, parents = tuple(joint.name for joint in joints), tuple(joint.parent for joint in joints)
    tips = {j: rest[j] + joint.tip for j, joint in enumerate(joints) if joint.tip is not None}
    return Bvh(path, names, parents, rest, tips, frame_s, places, turns)
