"""BVH: the skeleton with its bones and the motion, centimetres, y up, facing +z in the zero pose, its rest pose.

A frame without a body holds the pose before: the format knows no gaps. A foot ends in its toe; heels have no place.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.export.axes import Y_UP_FACING_Z
from pzcap.export.take import Take, held, write_text
from pzcap.types import ENDS, PARENTS, SEGMENTS, Array, MovedBody

CM: Final = 100.0
_ROTATIONS: Final = "Zrotation Xrotation Yrotation"
_CHANNELS: Final = {True: f"6 Xposition Yposition Zposition {_ROTATIONS}", False: f"3 {_ROTATIONS}"}


def write(take: Take, folder: Path) -> list[Path]:
    """Write the motion; the file."""
    motion, body = take.rig()
    shown = held(motion.valid)
    order = list(_depth_first(0))
    numbers = np.column_stack(
        [
            CM * motion.root_position_m[shown] @ Y_UP_FACING_Z.T,
            *(_angles(motion.rotations[shown, segment]) for segment in order),
        ]
    )
    rows = [" ".join(f"{number:.6f}" for number in row) for row in numbers]
    lines = ["HIERARCHY", *_joint(body, 0, ""), "MOTION", f"Frames: {len(rows)}", f"Frame Time: {1 / take.rate:.10f}"]
    return [write_text(folder / f"{take.file}.bvh", "\n".join([*lines, *rows]) + "\n")]


def _angles(quaternions: Array) -> Array:
    """Degrees (F, 3) about z, x and y, in this order, of rotations (F, 4), without jumps of a whole turn."""
    turned = Y_UP_FACING_Z @ Rotation.from_quat(quaternions, scalar_first=True).as_matrix() @ Y_UP_FACING_Z.T
    return np.unwrap(Rotation.from_matrix(turned).as_euler("ZXY", degrees=True), period=360.0, axis=0)


def _depth_first(segment: int) -> Iterator[int]:
    """``segment`` and all that hangs on it, in the order in which the file lists them."""
    yield segment
    for child, parent in enumerate(PARENTS):
        if parent == segment:
            yield from _depth_first(child)


def _joint(body: MovedBody, segment: int, indent: str) -> Iterator[str]:
    root, inner = PARENTS[segment] < 0, indent + "\t"
    yield f"{indent}{'ROOT' if root else 'JOINT'} {SEGMENTS[segment]}"
    yield indent + "{"
    yield inner + _offset(body.offsets_m[segment])
    yield f"{inner}CHANNELS {_CHANNELS[root]}"
    children = [child for child, parent in enumerate(PARENTS) if parent == segment]
    for child in children:
        yield from _joint(body, child, inner)
    if not children:
        end = next(k for k, carrier in enumerate(ENDS.values()) if carrier == SEGMENTS[segment])
        yield from (f"{inner}End Site", inner + "{", f"{inner}\t{_offset(body.ends_m[end])}", inner + "}")
    yield indent + "}"


def _offset(place: Array) -> str:
    return "OFFSET " + " ".join(f"{number:.6f}" for number in CM * Y_UP_FACING_Z @ place)
