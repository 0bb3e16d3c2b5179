"""BVH: a tree of joints, and how it turns. Only where its joints are is scored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pzcap.io.files import checked
from pzcap.scoring.readers.conventions import Y_UP, Conventions, about, body, metres
from pzcap.scoring.readers.times import Asked, Points
from pzcap.scoring.records import BodyTrack
from pzcap.types import Array, PzcapError


@dataclass(slots=True)
class Joint:
    """One joint of the tree."""

    name: str
    parent: int  # -1: the root
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: tuple[str, ...] = ()


def read_bvh(path: Path, asked: Asked, said: Conventions) -> BodyTrack:
    """The joints of a BVH file. It names no unit: centimetres, where none is said."""
    try:
        words = checked(path).read_text(encoding="utf-8-sig").replace("{", " { ").replace("}", " } ").split()
        joints, at = _hierarchy(words)
        places = _places(joints, _motion(words, at, sum(len(joint.channels) for joint in joints)))
        frame_s = float(words[at + 5])
    except (OSError, UnicodeDecodeError) as error:
        raise PzcapError(f"{path}: cannot be read ({error}); write it again") from error
    except (ValueError, IndexError) as error:
        raise PzcapError(f"{path}: is no BVH file ({error}); write it again") from error
    names = [joint.name for joint in joints]
    points = Points(names, metres(said.unit or "cm", path) * places, 1.0 / frame_s if frame_s > 0.0 else None)
    return body(path, points, asked, said, Y_UP)


def _hierarchy(words: list[str]) -> tuple[list[Joint], int]:
    """The joints, parents first, and where the motion begins."""
    if not words or words[0].upper() != "HIERARCHY":
        raise ValueError("its first word is not HIERARCHY")
    joints: list[Joint] = []
    open_joints: list[int] = []  # -1: an end, which is no joint
    at, opening = 1, -1
    while words[at].upper() != "MOTION":
        word = words[at].upper()
        if word in ("ROOT", "JOINT"):
            joints.append(Joint(words[at + 1], open_joints[-1] if open_joints else -1))
            opening, at = len(joints) - 1, at + 2
        elif word == "END":
            opening, at = -1, at + 2
        elif word == "{":
            open_joints.append(opening)
            at += 1
        elif word == "}":
            open_joints.pop()
            at += 1
        elif word == "OFFSET":
            if open_joints[-1] >= 0:
                x, y, z = map(float, words[at + 1 : at + 4])
                joints[open_joints[-1]].offset = (x, y, z)
            at += 4
        elif word == "CHANNELS":
            count = int(words[at + 1])
            joints[open_joints[-1]].channels = tuple(w.lower() for w in words[at + 2 : at + 2 + count])
            at += 2 + count
        else:
            raise ValueError(f"'{words[at]}' in its hierarchy")
    return joints, at


def _motion(words: list[str], at: int, channels: int) -> Array:
    """(T, N) values of all channels."""
    if words[at + 1].lower() != "frames:" or [w.lower() for w in words[at + 3 : at + 5]] != ["frame", "time:"]:
        raise ValueError("no Frames: and Frame Time: behind MOTION")
    count = int(words[at + 2])
    values = np.array([float(word) for word in words[at + 6 :]])
    if values.size != count * channels:
        raise ValueError(f"{values.size} numbers where {count} frames of {channels} channels belong")
    return values.reshape(count, channels)


def _places(joints: list[Joint], values: Array) -> Array:
    """(T, J, 3) the joints in the file's own axes and unit: rotations apply in the order in which they are listed."""
    count = len(values)
    places = np.zeros((count, len(joints), 3))
    turns = np.tile(np.eye(3), (count, len(joints), 1, 1))
    column = 0
    for number, joint in enumerate(joints):
        local, turn = np.tile(np.array(joint.offset), (count, 1)), np.tile(np.eye(3), (count, 1, 1))
        for channel in joint.channels:
            axis, value = "xyz".index(channel[0]), values[:, column]
            if channel.endswith("position"):
                local[:, axis] = value
            else:
                turn = turn @ about(axis, np.deg2rad(value))
            column += 1
        if joint.parent < 0:
            places[:, number], turns[:, number] = local, turn
        else:
            above = turns[:, joint.parent]
            places[:, number] = places[:, joint.parent] + np.einsum("tij,tj->ti", above, local)
            turns[:, number] = above @ turn
    return places
