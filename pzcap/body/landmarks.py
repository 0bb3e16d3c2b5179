"""Places on the body of a detector's keypoints.

A detector was taught by people who clicked on pictures: its hip is no hip joint, and nobody clicks on the same spot of
a shoulder twice. So each keypoint has a place on the body and a sigma that admits by how much it may be meant to lie
elsewhere. But whatever one detector means by it, it means in every frame: that can be found out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.body.mesh import Surface
from pzcap.io.detections import KEYPOINTS
from pzcap.types import SEGMENTS, Array, Indices

_Place = tuple[str, tuple[float, float, float], float]
"""Segment; how far from its joint towards where its skin ends, forward, to the left and up (below 0: back, to the
right and down); sigma in metres."""
_HEAD: Final[dict[str, _Place]] = {
    "nose": ("head", (1.1, 0.0, 0.45), 0.020),
    "left_eye": ("head", (0.95, 0.4, 0.55), 0.020),
    "right_eye": ("head", (0.95, -0.4, 0.55), 0.020),
    "left_ear": ("head", (0.1, 1.0, 0.48), 0.025),
    "right_ear": ("head", (0.1, -1.0, 0.48), 0.025),
    "head_top": ("head", (0.0, 0.0, 1.0), 0.030),
}
_JOINTS: Final[dict[str, tuple[str, float]]] = {
    "shoulder": ("upper_arm", 0.030), "elbow": ("forearm", 0.025), "wrist": ("hand", 0.020),
    "hip": ("thigh", 0.040), "knee": ("shank", 0.025), "ankle": ("foot", 0.020),
}  # fmt: skip


def _places() -> dict[str, _Place]:
    """Of every keypoint; that of the neck, between the shoulders, depends on the body."""
    table = {**_HEAD, "neck": ("thorax", (0.0, 0.0, 0.0), 0.030), "mid_hip": ("pelvis", (0.0, 0.0, 0.0), 0.040)}
    for side, left in (("left_", 1.0), ("right_", -1.0)):
        table |= {side + name: (side + segment, (0.0, 0.0, 0.0), sigma) for name, (segment, sigma) in _JOINTS.items()}
        table |= {
            side + "big_toe": (side + "foot", (0.95, -0.4 * left, -0.7), 0.025),
            side + "small_toe": (side + "foot", (0.75, 0.9 * left, -0.8), 0.025),
            side + "heel": (side + "foot", (-1.0, 0.0, -0.7), 0.025),
        }
    return {name: table[name] for name in KEYPOINTS}


_PLACES: Final = _places()
_NECK: Final = KEYPOINTS.index("neck")
_SHARE: Final[Array] = np.array([share for _, share, _ in _PLACES.values()])
SEGMENT: Final[Indices] = np.array([SEGMENTS.index(name) for name, _, _ in _PLACES.values()])
"""(26,) The segment that a keypoint lies on."""
SIGMA_M: Final[Array] = np.array([sigma for _, _, sigma in _PLACES.values()])
"""(26,) By how much a keypoint may be meant to lie elsewhere."""
_SHOULDERS: Final = [SEGMENTS.index("left_upper_arm"), SEGMENTS.index("right_upper_arm")]


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Places on a body of a detector's keypoints, as far as that is known."""

    points_m: Array  # (26, 3) each in the frame of its segment, `SEGMENT`
    sigma_m: Array  # (26,) of each of the three


def usual(offsets_m: Array, skin: Surface) -> Landmarks:
    """Landmarks as detectors mean them on the whole, on a body of these joints (16, 3 in their parents' frames) and
    this skin."""
    points = np.zeros((len(KEYPOINTS), 3))
    for s in np.unique(SEGMENT[_SHARE.any(axis=1)]):
        own = skin.points_m[skin.segment == s]
        share = _SHARE[here := s == SEGMENT]
        points[here] = np.maximum(share, 0.0) * own.max(axis=0) - np.minimum(share, 0.0) * own.min(axis=0)
    points[_NECK] = offsets_m[_SHOULDERS].mean(axis=0)
    return Landmarks(points, SIGMA_M)
