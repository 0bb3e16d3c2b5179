"""A pose of the skeleton in closed form from triangulated keypoints: where a fit of the articulated body begins.

The pelvis is turned so that its hips and the trunk point where they are seen, the thorax by the shoulders; what lies
between them is shared out. A limb's first segment points to its hinge, and bends where the hinge bends; of a straight
limb, whose twist no point shows, it is turned by the least angle.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.io.detections import KEYPOINTS
from pzcap.types import HINGE_AXES, PARENTS, SEGMENTS, Array, Mask, Pose

_LIMBS: Final = (
    ("left_upper_arm", "left_shoulder", "left_elbow", "left_wrist"),
    ("right_upper_arm", "right_shoulder", "right_elbow", "right_wrist"),
    ("left_thigh", "left_hip", "left_knee", "left_ankle"),
    ("right_thigh", "right_hip", "right_knee", "right_ankle"),
)
_STRAIGHT: Final = 0.15  # sine of a hinge's angle from which on the plane of a limb is seen


def pose_of_points(points_m: Array, found: Mask) -> Pose | None:
    """The pose in which the body passes by the keypoints (26, 3) as well as a closed form can have it; ``found`` (26,)
    are those that are known. None where hips or shoulders are missing."""
    at = {name: points_m[row] for row, name in enumerate(KEYPOINTS) if found[row]}
    if any(f"{side}_{name}" not in at for side in ("left", "right") for name in ("hip", "shoulder")):
        return None
    hips, shoulders = ((at[f"left_{name}"] + at[f"right_{name}"]) / 2 for name in ("hip", "shoulder"))
    world_R: list[Array] = [np.eye(3)] * len(SEGMENTS)  # world from segment
    up = shoulders - hips
    pelvis, thorax = (_axes(up, at[f"left_{name}"] - at[f"right_{name}"]) for name in ("hip", "shoulder"))
    between = Rotation.from_matrix(pelvis.T @ thorax).as_rotvec()
    lumbar = pelvis @ Rotation.from_rotvec(0.5 * between).as_matrix()
    for name, own in (("pelvis", pelvis), ("lumbar", lumbar), ("thorax", thorax)):
        world_R[SEGMENTS.index(name)] = own
    world_R[SEGMENTS.index("head")] = _head(at, thorax)
    for first, start, hinge, end in _LIMBS:
        s = SEGMENTS.index(first)
        upper, bend = _limb((at.get(start), at.get(hinge), at.get(end)), world_R[PARENTS[s]], SEGMENTS[s + 1])
        world_R[s] = upper
        world_R[s + 1] = world_R[s + 2] = upper @ bend
    local = np.array([own if p < 0 else world_R[p].T @ own for own, p in zip(world_R, PARENTS, strict=True)])
    return Pose(hips, np.asarray(Rotation.from_matrix(local).as_quat(scalar_first=True)))


def _axes(up: Array, left: Array) -> Array:
    """Axes (3, 3), columns forward, left and up: to the left exactly, up as nearly as that allows."""
    y = left / np.linalg.norm(left)
    x = np.cross(y, up)
    x /= max(float(np.linalg.norm(x)), 1e-9)
    return np.column_stack([x, y, np.cross(x, y)])


def _head(at: dict[str, Array], thorax: Array) -> Array:
    """World from head: to where nose and ears are, else as the thorax."""
    if any(name not in at for name in ("nose", "left_ear", "right_ear")):
        return thorax
    ears = at["left_ear"] - at["right_ear"]
    forward = at["nose"] - (at["left_ear"] + at["right_ear"]) / 2
    return _axes(np.cross(forward, ears), ears)


def _limb(places: tuple[Array | None, ...], parent: Array, second: str) -> tuple[Array, Array]:
    """World from the limb's first segment, and the turn of its hinge, from the ``places`` (3,) of its three joints; as
    the ``parent`` where they are missing."""
    start, hinge, end = places
    if start is None or hinge is None:
        return parent, np.eye(3)
    along = _unit(hinge - start)
    least = _least_turn(-parent[:, 2], along) @ parent
    if end is None:
        return least, np.eye(3)
    beyond = _unit(end - hinge)
    aside = beyond - along * (along @ beyond)
    sine = float(np.linalg.norm(aside))
    axis = np.array(HINGE_AXES[second])
    forward = -axis[1] * aside + _STRAIGHT * least[:, 0]  # elbows bend forward, knees back
    forward = _unit(forward - along * (along @ forward))
    upper = np.column_stack([forward, np.cross(-along, forward), -along])
    angle = float(np.arctan2(sine, along @ beyond))
    return upper, np.asarray(Rotation.from_rotvec(axis * angle).as_matrix())


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def _least_turn(start: Array, to: Array) -> Array:
    """The rotation by the least angle of one unit vector to another."""
    axis, cosine = np.cross(start, to), float(start @ to)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-6:
        if cosine > 0.0:
            return np.eye(3)
        axis = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])  # half a turn, about any axis across
        return np.asarray(Rotation.from_rotvec(np.pi * _unit(axis)).as_matrix())
    return np.asarray(Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)).as_matrix())
