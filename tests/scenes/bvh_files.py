"""BVH files of our own motions, written as other people's programs would."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import PARENTS, SEGMENTS, Array
from sim.motion import MotionClip
from sim.people.anthropometry import body_tree

_SIDED = {"upper_arm": "Arm", "forearm": "ForeArm", "hand": "Hand", "thigh": "UpLeg", "shank": "Leg", "foot": "Foot"}
MIXAMO = {
    "pelvis": "mixamorig:Hips", "lumbar": "mixamorig:Spine", "thorax": "mixamorig:Spine1", "head": "mixamorig:Head",
    **{f"{s}_{kind}": f"mixamorig:{s.title()}{word}" for s in ("left", "right") for kind, word in _SIDED.items()},
}  # fmt: skip
_XSENS = {
    "upper_arm": "Shoulder", "forearm": "Elbow", "hand": "Wrist", "thigh": "Hip", "shank": "Knee", "foot": "Ankle",
}  # fmt: skip
XSENS = {
    "pelvis": "Hips", "lumbar": "Chest", "thorax": "Chest4", "head": "Head",
    **{f"{s}_{kind}": f"{s.title()}{word}" for s in ("left", "right") for kind, word in _XSENS.items()},
}  # fmt: skip
_SMPL = {
    "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist", "thigh": "hip", "shank": "knee", "foot": "ankle",
}  # fmt: skip
SMPL = {
    "pelvis": "pelvis", "lumbar": "spine1", "thorax": "spine3", "head": "neck",
    **{f"{s}_{kind}": f"{s}_{word}" for s in ("left", "right") for kind, word in _SMPL.items()},
}  # fmt: skip

Y_UP = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""(3, 3) our axes of the axes x left, y up, z forward."""


def t_pose() -> dict[str, Array]:
    """World from segment (3, 3), of those that are not as in our zero pose."""
    return {
        f"{side}_{part}": Rotation.from_euler("x", 90.0 * sign, degrees=True).as_matrix()
        for side, sign in (("left", 1.0), ("right", -1.0))
        for part in ("upper_arm", "forearm", "hand")
    }


def astride() -> dict[str, Array]:
    """A T-pose with legs apart, feet square to them."""
    return t_pose() | {
        f"{side}_{part}": Rotation.from_euler("x", 20.0 * sign, degrees=True).as_matrix()
        for side, sign in (("left", 1.0), ("right", -1.0))
        for part in ("thigh", "shank", "foot")
    }


@dataclass(frozen=True)
class Style:
    """Conventions by which a program writes a figure."""

    names: Mapping[str, str] = field(default_factory=lambda: MIXAMO)
    rest: Mapping[str, Array] = field(default_factory=dict)  # world from segment, where it is not the identity
    axes: Array = field(default_factory=lambda: np.eye(3))  # (3, 3) ours of the file's
    unit: float = 1.0  # of length, a metre
    order: Literal["ZXY", "YXZ", "XYZ"] = "ZXY"  # of the rotations
    rate: float = 60.0  # frames a second


def write_bvh(path: Path, clip: MotionClip, measurements: dict[str, float], style: Style) -> Path:
    tree, axes = body_tree(measurements), style.axes
    rest = [style.rest.get(name, np.eye(3)) for name in SEGMENTS]
    m = measurements
    tips = {
        "head": (0.0, 0.0, m["head"]), "hand": (0.0, 0.0, -m["hand"]), "foot": (0.7 * m["foot"], 0, -m["ankle_height"]),
    }  # fmt: skip
    lines = ["HIERARCHY"]

    def offset(vector: Array) -> str:
        return "OFFSET " + " ".join(f"{x:.7f}" for x in axes.T @ vector * style.unit)

    def describe(s: int) -> None:
        root = PARENTS[s] < 0
        lines.append(f"{'ROOT' if root else 'JOINT'} {style.names[SEGMENTS[s]]}")
        lines.extend(["{", offset(np.zeros(3) if root else rest[PARENTS[s]] @ tree.offsets_m[s])])
        turning = " ".join(f"{axis}rotation" for axis in style.order)
        lines.append(f"CHANNELS 6 Xposition Yposition Zposition {turning}" if root else f"CHANNELS 3 {turning}")
        children = [child for child, parent in enumerate(PARENTS) if parent == s]
        for child in children:
            describe(child)
        if not children:
            tip = next(tip for kind, tip in tips.items() if SEGMENTS[s].endswith(kind))
            lines.extend(["End Site", "{", offset(rest[s] @ np.array(tip)), "}"])
        lines.append("}")

    describe(0)
    order: list[int] = []

    def collect(s: int) -> None:
        order.append(s)
        for child, parent in enumerate(PARENTS):
            if parent == s:
                collect(child)

    collect(0)
    count = round(clip.duration_s * style.rate) + 1
    lines += ["MOTION", f"Frames: {count}", f"Frame Time: {1 / style.rate:.9f}"]
    for k in range(count):
        pose = clip.at(k / style.rate)
        local = Rotation.from_quat(pose.rotations, scalar_first=True).as_matrix()
        world: list[Array] = []
        for s in range(16):
            world.append(local[s] if PARENTS[s] < 0 else world[PARENTS[s]] @ local[s])
        turned = [axes.T @ world[s] @ rest[s].T @ axes for s in range(16)]
        values = list(axes.T @ pose.root_position_m * style.unit)
        for s in order:
            own = turned[s] if PARENTS[s] < 0 else turned[PARENTS[s]].T @ turned[s]
            values += list(Rotation.from_matrix(own).as_euler(style.order, degrees=True))
        lines.append(" ".join(f"{value:.6f}" for value in values))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
