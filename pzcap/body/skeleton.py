"""The articulated body: degrees of freedom of the skeleton, and a person's from tape measurements.

`pzcap.body.kinematics` says what a pose's 43 numbers are and moves the body by them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.body import anthropometry, landmarks
from pzcap.body.anthropometry import Measured
from pzcap.body.landmarks import Landmarks
from pzcap.body.mesh import Surface, build_surface
from pzcap.types import (
    ENDS,
    GARMENTS,
    HINGE_AXES,
    LUMBAR_FRACTION,
    PARENTS,
    SEGMENTS,
    THORAX_FRACTION,
    Array,
    Garment,
    Indices,
    Mask,
    MovedBody,
    PzcapError,
    Subject,
    without_side,
)

DOF_SEGMENT: Final[Indices] = np.array(
    [0, 0, 0] + [i for i, name in enumerate(SEGMENTS) for _ in range(1 if name in HINGE_AXES else 3)]
)
"""(43,) The segment that a degree of freedom moves first."""
DOF_AXES: Final[Array] = np.concatenate(
    [np.eye(3)] + [np.array([HINGE_AXES[name]]) if name in HINGE_AXES else np.eye(3) for name in SEGMENTS]
)
"""(43, 3) World axis of a translation, axis in the segment's frame of a rotation."""
LIMBS: Final = ((4, 5, 6), (7, 8, 9), (10, 11, 12), (13, 14, 15))
"""Segments of the arms and the legs: a ball joint, a hinge and a ball joint each."""


def _moved_segments() -> Mask:
    """(43, 16) Segments that a degree of freedom moves: its own and all that hang on it."""
    below = np.eye(len(SEGMENTS), dtype=bool)
    for child, parent in reversed(list(enumerate(PARENTS))):
        if parent >= 0:
            below[parent] |= below[child]
    return below[DOF_SEGMENT]


MOVES: Final[Mask] = _moved_segments()


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A person as measured with a tape, or guessed from what was."""

    offsets_m: Array  # (16, 3) joint of each segment in its parent's frame; zero for the root
    surface: Surface
    measured: Measured  # what it was made from
    worn: Mapping[Garment, float]  # loose clothes, and how far they stand off the skin, metres
    loose_m: Array  # (16,) that room, by which the surface is wider; 0 where clothes are tight
    landmarks: Landmarks  # where a detector's keypoints lie


def build(subject: Subject) -> Body:
    """The body of a subject; measurements that are missing are guessed. Raises PzcapError when one cannot be a
    person's."""
    _check(subject.measurements_m, "measurements are in metres")
    return of(anthropometry.measured(subject), subject.loose_m)


def of(measured: Measured, worn: Mapping[Garment, float]) -> Body:
    """The body of a person with these measurements, in loose clothes that are ``worn`` so far off the skin, metres."""
    m = measured.named()
    _check(m, "as the rest of subject.json has it: correct that")
    loose_m = np.zeros(len(SEGMENTS))
    for garment, room_m in worn.items():
        for name in GARMENTS[garment]:
            loose_m[SEGMENTS.index(name)] = max(loose_m[SEGMENTS.index(name)], room_m)
    offsets, surface = _offsets(m), build_surface(m, worn.get("skirt", 0.0))
    if loose_m.any():
        surface = surface.moved(surface.points_m + loose_m[surface.segment][:, None] * surface.normals)
    return Body(offsets, surface, measured, worn, loose_m, landmarks.usual(offsets, surface))


def _check(measurements_m: dict[str, float], remedy: str) -> None:
    for name, value in measurements_m.items():
        if not 0.02 <= value <= 2.5:
            raise PzcapError(f"subject: {name} = {value:.3g} m cannot be; {remedy}")


def moved(body: Body) -> MovedBody:
    """Part of ``body`` that goes into a result."""
    surface = body.surface
    return MovedBody(
        body.offsets_m, _ends(surface), np.ascontiguousarray(surface.points_m), surface.segment, surface.faces
    )


def _ends(surface: Surface) -> Array:
    """(7, 3) The outermost vertex of the skin at each of ENDS, in the frame of its segment."""
    ways = {"head_top": (2, 1.0), "fingertip": (2, -1.0), "toe": (0, 1.0), "heel": (0, -1.0)}
    found = []
    for name, segment in ENDS.items():
        axis, sign = ways[without_side(name)]
        own = surface.points_m[surface.segment == SEGMENTS.index(segment)]
        found.append(own[np.argmax(sign * own[:, axis])])
    return np.array(found)


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
