"""Names of the body: sixteen segments, their joints and ends, what a tape measures, what clothes cover.

A segment is named like the joint at its near end is: its frame sits in that joint.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

SEGMENTS: Final[tuple[str, ...]] = (
    "pelvis", "lumbar", "thorax", "head",
    "left_upper_arm", "left_forearm", "left_hand",
    "right_upper_arm", "right_forearm", "right_hand",
    "left_thigh", "left_shank", "left_foot",
    "right_thigh", "right_shank", "right_foot",
)  # fmt: skip
PARENTS: Final[tuple[int, ...]] = (-1, 0, 1, 2, 2, 4, 5, 2, 7, 8, 0, 10, 11, 0, 13, 14)
"""Index of each segment's parent; -1 for the root. A parent stands before its children."""

HINGE_AXES: Final[dict[str, tuple[float, float, float]]] = {
    "left_forearm": (0.0, -1.0, 0.0), "right_forearm": (0.0, -1.0, 0.0),  # elbows: positive brings the hand forward
    "left_shank": (0.0, 1.0, 0.0), "right_shank": (0.0, 1.0, 0.0),  # knees: positive brings the heel back
}  # fmt: skip
"""Segments that turn about one fixed axis (of their own and their parent's frame). All others are ball joints:
3 root position + 12 ball joints (with the root's rotation) x 3 + 4 hinges = 43 degrees of freedom."""
DOF: Final = 3 + sum(1 if name in HINGE_AXES else 3 for name in SEGMENTS)
"""Degrees of freedom of a pose: numbers that it changes by."""

JOINTS: Final[tuple[str, ...]] = (
    "pelvis", "lumbar", "thorax", "neck",
    "left_shoulder", "left_elbow", "left_wrist",
    "right_shoulder", "right_elbow", "right_wrist",
    "left_hip", "left_knee", "left_ankle",
    "right_hip", "right_knee", "right_ankle",
)  # fmt: skip
"""Joint centres, in the order of SEGMENTS: joint ``i`` is the origin of segment ``i``. These are what is scored.
Zero pose: standing upright, arms hanging, palms facing back, every segment frame x forward, y left, z up."""

ENDS: Final[dict[str, str]] = {
    "head_top": "head",
    "left_fingertip": "left_hand", "right_fingertip": "right_hand",
    "left_toe": "left_foot", "right_toe": "right_foot",
    "left_heel": "left_foot", "right_heel": "right_foot",
}  # fmt: skip
"""Ends of the body beyond its last joints, and the segment that each is fixed to."""

MEASUREMENTS: Final[tuple[str, ...]] = (
    # lengths: stature; mid-hip to neck joint (C7); neck joint to vertex; neck joint down to shoulder joints
    "stature", "trunk", "head", "shoulder_drop",
    # between the two shoulder joints, between the two hip joints
    "shoulder_width", "hip_width",
    # joint to joint; hand: wrist to finger tip; foot: heel to toe; ankle joint above the sole
    "upper_arm", "forearm", "hand", "thigh", "shank", "foot", "ankle_height",
    # girths
    "girth_head", "girth_neck", "girth_chest", "girth_waist", "girth_hips",
    "girth_upper_arm", "girth_elbow", "girth_forearm", "girth_wrist",
    "girth_thigh", "girth_knee", "girth_calf", "girth_ankle",
)  # fmt: skip
"""Measurements of the subject with a tape, metres. See docs/capture.md for how."""

Sex: TypeAlias = Literal["female", "male"]

Garment: TypeAlias = Literal["shirt", "trousers", "skirt"]
GARMENTS: Final[dict[Garment, tuple[str, ...]]] = {
    "shirt": ("thorax", "lumbar", "left_upper_arm", "right_upper_arm"),
    "trousers": ("pelvis", "left_thigh", "left_shank", "right_thigh", "right_shank"),
    "skirt": ("pelvis",),
}
"""Segments that loose clothes hang on. A skirt hangs down over the thighs from there."""

LUMBAR_FRACTION: Final = 0.25
THORAX_FRACTION: Final = 0.55  # places of the lumbar and thorax joints between mid-hip (0) and the neck joint (1)


def without_side(name: str) -> str:
    """Name of a part of the body without its side: of ``left_hand`` and ``right_hand``, ``hand``."""
    return name.removeprefix("left_").removeprefix("right_")
