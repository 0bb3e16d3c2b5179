"""The articulated body: a skeleton and a skin from tape measurements, forward kinematics and its Jacobian.

The tangent of a pose is a vector of 43 numbers (metres, radians):

* ``[0:3]`` root translation, along the world's axes;
* then, per segment in the order of ``SEGMENTS``, a rotation increment about the *segment's own* axes, applied from the
  right, ``R <- R Exp(increment)``: three numbers for a ball joint, one about the fixed axis for a hinge.

``retract`` and ``difference`` go forth and back; ``screws`` is the derivative of every rigid motion with respect to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.body import kinematics, landmarks
from pzcap.body.landmarks import Landmarks
from pzcap.body.mesh import Surface, build_surface
from pzcap.types import (
    HINGE_AXES,
    LUMBAR_FRACTION,
    MEASUREMENTS,
    PARENTS,
    SEGMENTS,
    THORAX_FRACTION,
    Array,
    Mask,
    Pose,
    PzcapError,
    Subject,
)

DOF_SEGMENT: Final[NDArray[np.int64]] = np.array(
    [0, 0, 0] + [i for i, name in enumerate(SEGMENTS) for _ in range(1 if name in HINGE_AXES else 3)]
)
"""(43,) The segment that a degree of freedom moves first."""
DOF: Final = len(DOF_SEGMENT)
DOF_AXES: Final[Array] = np.concatenate(
    [np.eye(3)] + [np.array([HINGE_AXES[name]]) if name in HINGE_AXES else np.eye(3) for name in SEGMENTS]
)
"""(43, 3) World axis of a translation, axis in the segment's frame of a rotation."""
_PARENTS: Final[NDArray[np.int64]] = np.array(PARENTS)
_IDENTITY: Final[Array] = np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1))


def _spread() -> Array:
    """(48, 43) takes a tangent vector to the rotation vectors of all segments; the transpose takes it back."""
    matrix = np.zeros((len(SEGMENTS), 3, DOF))
    for d in range(3, DOF):
        matrix[DOF_SEGMENT[d], :, d] = DOF_AXES[d]
    return matrix.reshape(-1, DOF)


_SPREAD: Final[Array] = _spread()
SKELETON_EDGES: Final = tuple((parent, child) for child, parent in enumerate(PARENTS) if parent >= 0)


def _moved_segments() -> Mask:
    """(43, 16) Whether a degree of freedom moves a segment: its own and all that hang on it."""
    below = np.eye(len(SEGMENTS), dtype=bool)
    for child, parent in reversed(list(enumerate(PARENTS))):
        if parent >= 0:
            below[parent] |= below[child]
    return below[DOF_SEGMENT]


MOVES: Final[Mask] = _moved_segments()

# Ranges of the rotation vector about x, y, z (degrees) that a trained gymnast can reach, generously; mirrored for the
# right side. They only keep a hidden limb from folding up, so they are soft and wide. A shoulder reaches half a turn,
# where rotation vectors change sign: it is left free.
_LIMITS_DEG: Final[dict[str, tuple[tuple[float, float], ...]]] = {
    "lumbar": ((-40, 40), (-50, 70), (-40, 40)),
    "thorax": ((-40, 40), (-50, 60), (-50, 50)),
    "head": ((-55, 55), (-75, 75), (-85, 85)),
    "forearm": ((-8, 160),),
    "hand": ((-60, 60), (-90, 90), (-95, 95)),
    "thigh": ((-40, 100), (-150, 80), (-70, 70)),
    "shank": ((-8, 160),),
    "foot": ((-45, 45), (-60, 90), (-50, 50)),
}


def _limits() -> tuple[Array, Array]:
    low, high = np.full(DOF, -np.inf), np.full(DOF, np.inf)
    for index, name in enumerate(SEGMENTS):
        ranges = _LIMITS_DEG.get(name.removeprefix("left_").removeprefix("right_"))
        if ranges is None:
            continue
        for row, axis, (a, b) in zip(np.flatnonzero(index == DOF_SEGMENT), range(3), ranges, strict=False):
            if name.startswith("right_") and len(ranges) == 3 and axis != 1:
                a, b = -b, -a
            low[row], high[row] = np.deg2rad(a), np.deg2rad(b)
    return low, high


LIMIT_LOW, LIMIT_HIGH = _limits()
"""(43,) Range of each rotation vector component, radians; infinite for the root."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A person, measured with a tape."""

    offsets_m: Array  # (16, 3) joint of each segment in its parent's frame; zero for the root
    surface: Surface
    sigma_m: float  # of one measurement
    landmarks: Landmarks  # where a detector's keypoints lie


def build(subject: Subject) -> Body:
    """The body of a subject. Raises PzcapError when a measurement is missing or cannot be a person's."""
    m = subject.measurements_m
    missing = [name for name in MEASUREMENTS if name not in m]
    if missing:
        raise PzcapError(f"subject: no measurement '{missing[0]}' ({len(missing)} missing); add it to subject.json")
    absurd = [name for name in MEASUREMENTS if not 0.02 <= m[name] <= 2.5]
    if absurd:
        raise PzcapError(f"subject: {absurd[0]} = {m[absurd[0]]} m cannot be; measurements are in metres")
    offsets, surface = _offsets(m), build_surface(m)
    return Body(offsets, surface, subject.sigma_m, landmarks.usual(offsets, surface))


def _offsets(m: dict[str, float]) -> Array:
    trunk = m["trunk"]
    shoulder_z = (1 - THORAX_FRACTION) * trunk - m["shoulder_drop"]
    table = {
        "pelvis": (0.0, 0.0, 0.0),
        "lumbar": (0.0, 0.0, LUMBAR_FRACTION * trunk),
        "thorax": (0.0, 0.0, (THORAX_FRACTION - LUMBAR_FRACTION) * trunk),
        "head": (0.0, 0.0, (1 - THORAX_FRACTION) * trunk),
    }
    for side, sign in (("left_", 1.0), ("right_", -1.0)):
        table |= {
            side + "upper_arm": (0.0, sign * m["shoulder_width"] / 2, shoulder_z),
            side + "forearm": (0.0, 0.0, -m["upper_arm"]),
            side + "hand": (0.0, 0.0, -m["forearm"]),
            side + "thigh": (0.0, sign * m["hip_width"] / 2, 0.0),
            side + "shank": (0.0, 0.0, -m["thigh"]),
            side + "foot": (0.0, 0.0, -m["shank"]),
        }
    return np.array([table[name] for name in SEGMENTS])


def forward(body: Body, pose: Pose) -> Array:
    """``world_T_segment``, (16, 4, 4). Joint centres are ``[:, :3, 3]``."""
    return np.asarray(kinematics.chain(pose.root_position_m, pose.rotations, body.offsets_m, _PARENTS))


def joints(body: Body, pose: Pose) -> Array:
    """Joint centres in the world, (16, 3)."""
    return forward(body, pose)[:, :3, 3]


def retract(pose: Pose, delta: Array) -> Pose:
    """The pose moved by a tangent vector (43,)."""
    increments = _SPREAD @ delta
    return Pose(pose.root_position_m + delta[:3], kinematics.turn(pose.rotations, increments.reshape(-1, 3)))


def difference(to: Pose, start: Pose) -> Array:
    """The tangent vector (43,) with ``retract(start, difference(to, start)) == to``.

    Of a hinge only the turn about its axis is kept.
    """
    delta = kinematics.between(start.rotations, to.rotations).ravel() @ _SPREAD
    delta[:3] = to.root_position_m - start.root_position_m
    return np.asarray(delta)


def screws(world_T_segment: Array, centre_m: Array) -> Array:
    """Joint screws, (43, 6): the twist ``(v, w)`` that one unit of a degree of freedom gives to what it moves.

    A point ``x`` that is moved (``MOVES``) has the velocity ``v + w x (x - centre_m)``. Expressing all twists about one
    centre near the body lets the normal equations be accumulated per segment (6 x 6) and lifted afterwards.
    """
    return np.asarray(kinematics.twists(world_T_segment, DOF_SEGMENT, DOF_AXES, np.ascontiguousarray(centre_m)))


def point_jacobian(world_T_segment: Array, segment: int, point_m: Array) -> Array:
    """Derivative (3, 43) of a world point that is fixed to a segment with respect to the pose's tangent."""
    twists = screws(world_T_segment, point_m)
    return np.where(MOVES[:, segment], twists[:, :3].T, 0.0)


def joint_jacobians(world_T_segment: Array) -> Array:
    """Derivatives (16, 3, 43) of all joint centres with respect to the pose's tangent."""
    return np.stack([point_jacobian(world_T_segment, i, world_T_segment[i, :3, 3]) for i in range(len(SEGMENTS))])


def lift(hessians: Array, gradients: Array, twists: Array) -> tuple[Array, Array]:
    """Normal equations of the pose, (43, 43) and (43,), from those of each segment as a free rigid body.

    ``hessians`` (16, 6, 6) and ``gradients`` (16, 6) are with respect to a segment's own twist about the centre that
    ``twists`` (43, 6) of ``screws`` were taken about.
    """
    return kinematics.lift(hessians, gradients, twists, DOF_SEGMENT, _PARENTS, MOVES)


def limit_residuals(pose: Pose) -> tuple[Array, Array]:
    """Excess (radians) of each component of the joints' rotation vectors over its limit: residual (43,), and the
    diagonal of its derivative (43,), 1 where violated. The derivative takes rotation vectors for tangent vectors,
    which is right about the axis of rotation and good enough for a soft wall elsewhere."""
    angles = kinematics.between(_IDENTITY, pose.rotations).ravel() @ _SPREAD
    angles[:3] = 0.0
    residual = np.maximum(angles - LIMIT_HIGH, 0.0) + np.minimum(angles - LIMIT_LOW, 0.0)
    return residual, (residual != 0.0).astype(np.float64)


def place(body: Body, world_T_segment: Array) -> tuple[Array, Array]:
    """Skin in the world: points (V, 3) and unit normals (V, 3), a coordinate after the other in memory."""
    surface = body.surface
    points, normals = (np.empty(surface.points_m.shape, order="F") for _ in range(2))
    kinematics.carry(world_T_segment, surface.segment, surface.points_m, surface.normals, points, normals)
    return points, normals
