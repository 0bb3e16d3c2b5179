"""OpenSim: a model of the subject (.osim) and the motion of its coordinates (.mot).

The body that was tracked is the model, scaled to the subject by what it is made of, so that its angles need no inverse
kinematics over markers: they are those that the images gave. Axes are OpenSim's: x forward, y up, z to the right.
Coordinates are named as in OpenSim's own models where these have them. A joint turns about z, then x, then y, each
axis carried along; on the left side x and y point the other way, so that equal numbers are equal poses.

Masses and inertias are those of the skin filled with water: good for seeing and for kinematics, a start for dynamics.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.export.axes import Y_UP_FACING_X
from pzcap.export.take import Take, write_text
from pzcap.types import ENDS, HINGE_AXES, JOINTS, PARENTS, SEGMENTS, Array, MovedBody

DENSITY_KG_M3: Final = 1000.0
_LEAST_KG: Final = 0.05
_VERSION: Final = "40000"
_AXES: Final = {"z": (0.0, 0.0, 1.0), "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}
_BALLS: Final[dict[str, tuple[str, str, str]]] = {
    "pelvis": ("pelvis_tilt", "pelvis_list", "pelvis_rotation"),
    "lumbar": ("lumbar_extension", "lumbar_bending", "lumbar_rotation"),
    "thorax": ("thorax_extension", "thorax_bending", "thorax_rotation"),
    "head": ("neck_extension", "neck_bending", "neck_rotation"),
    "upper_arm": ("arm_flex", "arm_add", "arm_rot"),
    "hand": ("wrist_flex", "wrist_dev", "wrist_rot"),
    "thigh": ("hip_flexion", "hip_adduction", "hip_rotation"),
    "foot": ("ankle_angle", "subtalar_angle", "ankle_rotation"),
}
"""Coordinates of the ball joints: about z, x and y."""
_HINGES: Final = {"forearm": "elbow_flex", "shank": "knee_angle"}
_PLACE: Final = ("pelvis_tx", "pelvis_ty", "pelvis_tz")


class _Coordinate(NamedTuple):
    name: str
    axis: Array  # (3,)


def write(take: Take, folder: Path) -> list[Path]:
    """Write model and motion; the files."""
    motion, body = take.rig()
    frames = np.flatnonzero(motion.valid)
    columns = [take.times_s[frames]]
    names = ["time"]
    for segment in range(len(SEGMENTS)):
        coordinates = coordinates_of(segment)
        names += [each.name for each in coordinates]
        columns += list(np.rad2deg(angles(segment, motion.rotations[frames, segment])).T)
        if segment == 0:
            names += _PLACE
            columns += list((motion.root_position_m[frames] @ Y_UP_FACING_X.T).T)
    table = np.column_stack(columns)
    head = [
        "Coordinates", "version=1", f"nRows={len(table)}", f"nColumns={len(names)}", "inDegrees=yes", "endheader",
        "\t".join(names),
    ]  # fmt: skip
    rows = ["\t".join(f"{value:.10g}" for value in row) for row in table]
    model = "\n".join(_model(take.file, body)) + "\n"
    return [
        write_text(folder / f"{take.file}.osim", model),
        write_text(folder / f"{take.file}.mot", "\n".join([*head, *rows]) + "\n"),
    ]


def coordinates_of(segment: int) -> list[_Coordinate]:
    """Rotations by which a segment moves against its parent, in their order."""
    side, _, plain = SEGMENTS[segment].partition("_")
    if side not in ("left", "right"):
        side, plain = "", SEGMENTS[segment]
    suffix = f"_{side[0]}" if side else ""
    if plain in _HINGES:
        return [_Coordinate(_HINGES[plain] + suffix, Y_UP_FACING_X @ np.array(HINGE_AXES[SEGMENTS[segment]]))]
    mirrored = np.diag([-1.0, -1.0, 1.0]) if side == "left" else np.eye(3)
    return [
        _Coordinate(name + suffix, mirrored @ np.array(_AXES[axis]))
        for name, axis in zip(_BALLS[plain], "zxy", strict=True)
    ]


def angles(segment: int, quaternions: Array) -> Array:
    """(F, 1 or 3) radians of a segment's coordinates, from rotations (F, 4) that `Motion` has; without jumps, where a
    pose may be told by two sets of angles."""
    coordinates = coordinates_of(segment)
    turns = Y_UP_FACING_X @ Rotation.from_quat(quaternions, scalar_first=True).as_matrix() @ Y_UP_FACING_X.T
    if len(coordinates) == 1:
        about = Rotation.from_matrix(turns).as_rotvec() @ coordinates[0].axis
        return np.asarray(np.unwrap(about)[:, None])
    found = Rotation.from_matrix(turns).as_euler("ZXY")
    for frame in range(1, len(found)):
        first, second, third = found[frame]
        other = np.array([first + np.pi, np.pi - second, third + np.pi])
        near = [each + 2 * np.pi * np.round((found[frame - 1] - each) / (2 * np.pi)) for each in (found[frame], other)]
        found[frame] = min(near, key=lambda each: float(np.abs(each - found[frame - 1]).sum()))
    return np.asarray(found * [each.axis.sum() for each in coordinates])


# --------------------------------------------------------------------------------------------------------------
# The model


def _model(name: str, body: MovedBody) -> Iterator[str]:
    yield '<?xml version="1.0" encoding="UTF-8" ?>'
    yield f'<OpenSimDocument Version="{_VERSION}">'
    yield f"<Model name={quoteattr(name)}>"
    yield "<gravity>0 -9.80665 0</gravity><length_units>meters</length_units><force_units>N</force_units>"
    yield "<BodySet><objects>"
    for segment in range(len(SEGMENTS)):
        yield from _body(segment, body)
    yield "</objects></BodySet>"
    yield "<JointSet><objects>"
    for segment in range(len(SEGMENTS)):
        yield from _joint(segment, body)
    yield "</objects></JointSet>"
    yield "<MarkerSet><objects>"
    places = [(joint, segment, np.zeros(3)) for joint, segment in zip(JOINTS, SEGMENTS, strict=True)]
    places += [(end, segment, body.ends_m[k]) for k, (end, segment) in enumerate(ENDS.items())]
    for marker, segment_name, place in places:
        yield f'<Marker name="{marker}"><socket_parent_frame>/bodyset/{segment_name}</socket_parent_frame>'
        yield f"<location>{_numbers(Y_UP_FACING_X @ place)}</location><fixed>true</fixed></Marker>"
    yield "</objects></MarkerSet>"
    yield "</Model>"
    yield "</OpenSimDocument>"


def _body(segment: int, body: MovedBody) -> Iterator[str]:
    mass, centre, inertia = _mass(segment, body)
    yield f'<Body name="{SEGMENTS[segment]}">'
    yield f"<mass>{mass:.6g}</mass><mass_center>{_numbers(centre)}</mass_center>"
    yield f"<inertia>{_numbers(inertia)} 0 0 0</inertia></Body>"


def _mass(segment: int, body: MovedBody) -> tuple[float, Array, Array]:
    """Mass, its centre (3,) and moments of inertia (3,) about that: of a block as large as the skin, filled as far as
    the skin fills it."""
    skin = body.skin_m[body.skin_segment == segment] @ Y_UP_FACING_X.T
    if not len(skin):
        return _LEAST_KG, np.zeros(3), np.full(3, 1e-4)
    own = body.skin_faces[(body.skin_segment[body.skin_faces] == segment).all(axis=1)]
    corners = body.skin_m[own] - body.skin_m[body.skin_segment == segment].mean(axis=0)
    volume = abs(float(np.einsum("ti,ti->t", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum())) / 6.0
    mass = max(DENSITY_KG_M3 * volume, _LEAST_KG)
    low, high = skin.min(axis=0), skin.max(axis=0)
    square = (high - low) ** 2
    return mass, (low + high) / 2.0, np.maximum(mass / 12.0 * (square.sum() - square), 1e-5)


def _joint(segment: int, body: MovedBody) -> Iterator[str]:
    root, name = PARENTS[segment] < 0, JOINTS[segment]
    parent = "/ground" if root else f"/bodyset/{SEGMENTS[PARENTS[segment]]}"
    coordinates = coordinates_of(segment)
    offset = np.zeros(3) if root else Y_UP_FACING_X @ body.offsets_m[segment]
    yield f'<CustomJoint name="{name}">'
    yield f"<socket_parent_frame>{name}_parent</socket_parent_frame>"
    yield f"<socket_child_frame>{name}_child</socket_child_frame>"
    yield "<coordinates>"
    for each in (*(each.name for each in coordinates), *(_PLACE if root else ())):
        yield f'<Coordinate name="{each}"><default_value>0</default_value><clamped>false</clamped></Coordinate>'
    yield "</coordinates><frames>"
    for side, frame, place in (("parent", parent, offset), ("child", f"/bodyset/{SEGMENTS[segment]}", np.zeros(3))):
        yield f'<PhysicalOffsetFrame name="{name}_{side}"><socket_parent>{frame}</socket_parent>'
        yield f"<translation>{_numbers(place)}</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame>"
    yield "</frames><SpatialTransform>"
    turns: list[tuple[str, Array]] = list(coordinates)
    if len(turns) == 1:  # the other two axes have to be there, and never turn
        turns += [("", np.array(_AXES["x"])), ("", np.array(_AXES["y"]))]
    for k, (coordinate, axis) in enumerate(turns, start=1):
        yield _axis(f"rotation{k}", coordinate, axis)
    for k, axis in enumerate(np.eye(3), start=1):
        yield _axis(f"translation{k}", _PLACE[k - 1] if root else "", axis)
    yield "</SpatialTransform></CustomJoint>"


def _axis(name: str, coordinate: str, axis: Array) -> str:
    function = (
        '<LinearFunction name="function"><coefficients>1 0</coefficients></LinearFunction>'
        if coordinate
        else '<Constant name="function"><value>0</value></Constant>'
    )
    return (
        f'<TransformAxis name="{name}"><coordinates>{coordinate}</coordinates><axis>{_numbers(axis)}</axis>'
        f"{function}</TransformAxis>"
    )


def _numbers(values: Array) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in values)
