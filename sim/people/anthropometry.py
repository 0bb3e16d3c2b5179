"""The athlete's proportions: lengths, girths and masses from published tables, and the tree they make.

Sources
    Lengths as fractions of stature: R. Drillis and R. Contini, *Body Segment Parameters* (1966), as reprinted in
    D. A. Winter, *Biomechanics and Motor Control of Human Movement*, fig. 4.1. Not in that table, and set by hand: the
    neck joint stands at the height of the cervicale (0.865 of stature in C. C. Gordon et al., *Anthropometric Survey of
    U.S. Army Personnel*), and joint centres of shoulders and hips lie inside the breadths that it gives.
    Masses and centres of mass of the segments: Winter, table 4.1.
    Girths, rounded, as fractions of stature: trunk and limbs near the men's means of G. Heinz et al., *Exploring
    Relationships in Body Dimensions*, J. Statistics Education 11 (2003), whose subjects were physically active; head
    and neck near those of Gordon et al.; the elbow set by hand between upper arm and forearm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.types import LUMBAR_FRACTION, MEASUREMENTS, PARENTS, SEGMENTS, THORAX_FRACTION, Array, without_side

_LENGTHS: Final[dict[str, float]] = {
    "trunk": 0.335, "head": 0.135, "shoulder_drop": 0.047, "shoulder_width": 0.215, "hip_width": 0.100,
    "upper_arm": 0.186, "forearm": 0.146, "hand": 0.108,
    "thigh": 0.245, "shank": 0.246, "foot": 0.152, "ankle_height": 0.039,
}  # fmt: skip
"""Fractions of stature."""

_GIRTHS: Final[dict[str, float]] = {
    "girth_head": 0.323, "girth_neck": 0.212, "girth_chest": 0.555, "girth_waist": 0.455, "girth_hips": 0.535,
    "girth_upper_arm": 0.182, "girth_elbow": 0.156, "girth_forearm": 0.158, "girth_wrist": 0.098,
    "girth_thigh": 0.325, "girth_knee": 0.217, "girth_calf": 0.212, "girth_ankle": 0.126,
}  # fmt: skip
"""Fractions of stature."""

_MASSES: Final[dict[str, tuple[float, float]]] = {
    "pelvis": (0.142, 0.105), "lumbar": (0.139, 0.44), "thorax": (0.216, 0.50), "head": (0.081, 0.50),
    "upper_arm": (0.028, 0.436), "forearm": (0.016, 0.430), "hand": (0.006, 0.506),
    "thigh": (0.100, 0.433), "shank": (0.0465, 0.433), "foot": (0.0145, 0.50),
}  # fmt: skip
"""Mass as a fraction of the body's, and the centre of mass as a fraction of the segment's length from its joint."""


def draw_measurements(rng: np.random.Generator) -> dict[str, float]:
    """Measure a person who is drawn from the tables: a metre value for each name of `types.MEASUREMENTS`.

    Stature is normal about 1.70 m, sigma 0.06 m; each length varies by 2.5 % and each girth by 3 % beside a common
    build of 4 %. The lengths are scaled to add up: stature is vertex above sole in the zero pose.
    """
    stature = float(np.clip(rng.normal(1.70, 0.06), 1.56, 1.88))
    build = float(np.clip(rng.normal(1.0, 0.04), 0.92, 1.10))
    values = {"stature": stature}
    for name, fraction in _LENGTHS.items():
        values[name] = stature * fraction * float(1.0 + np.clip(rng.normal(0.0, 0.025), -0.06, 0.06))
    for name, fraction in _GIRTHS.items():
        spread = build if name != "girth_head" else 1.0
        values[name] = stature * fraction * spread * float(1.0 + np.clip(rng.normal(0.0, 0.03), -0.07, 0.07))
    column = ("trunk", "head", "thigh", "shank", "ankle_height")
    scale = stature / sum(values[name] for name in column)
    for name in column:
        values[name] *= scale
    return {name: values[name] for name in MEASUREMENTS}


_GYRATION: Final = 0.30
"""Radius of gyration over a segment's length: 0.297 to 0.323 for the limbs in Winter's table."""


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """Rigid segments joined at points. Zero pose as in `types.JOINTS`; index ``s`` is that of `types.SEGMENTS`."""

    offsets_m: Array  # (16, 3) joint centre in the parent's frame; zero for the root
    masses: Array  # (16,) fractions of the body's mass, adding up to one
    centres_m: Array  # (16, 3) centre of mass in the segment's own frame
    gyration_m: Array  # (16,) radius of gyration about the centre of mass, across the segment's long axis


def body_tree(measurements: dict[str, float]) -> Tree:
    """Return the tree of a person with these measurements (metres)."""
    m = measurements
    side = {"left": 1.0, "right": -1.0}
    offsets, masses, centres = np.zeros((16, 3)), np.zeros(16), np.zeros((16, 3))
    fixed = {
        "pelvis": (0.0, 0.0, 0.0),
        "lumbar": (0.0, 0.0, LUMBAR_FRACTION * m["trunk"]),
        "thorax": (0.0, 0.0, (THORAX_FRACTION - LUMBAR_FRACTION) * m["trunk"]),
        "head": (0.0, 0.0, (1.0 - THORAX_FRACTION) * m["trunk"]),
    }
    lengths = {
        "pelvis": m["trunk"], "lumbar": (THORAX_FRACTION - LUMBAR_FRACTION) * m["trunk"],
        "thorax": (1.0 - THORAX_FRACTION) * m["trunk"], "head": m["head"],
        "upper_arm": -m["upper_arm"], "forearm": -m["forearm"], "hand": -m["hand"],
        "thigh": -m["thigh"], "shank": -m["shank"],
    }  # fmt: skip
    spans = {kind: abs(length) for kind, length in lengths.items()} | {"pelvis": 0.3 * m["trunk"], "foot": 0.0}
    for s, segment in enumerate(SEGMENTS):
        kind, y = without_side(segment), side.get(segment.split("_")[0], 0.0)
        if kind == "upper_arm":
            above = (1.0 - THORAX_FRACTION) * m["trunk"] - m["shoulder_drop"]
            offsets[s] = (0.0, y * m["shoulder_width"] / 2, above)
        elif kind == "thigh":
            offsets[s] = (0.0, y * m["hip_width"] / 2, 0.0)
        elif segment in fixed:
            offsets[s] = fixed[segment]
        else:
            offsets[s] = (0.0, 0.0, lengths[without_side(SEGMENTS[PARENTS[s]])])
        masses[s], fraction = _MASSES[kind]
        centres[s] = (
            (0.25 * m["foot"], 0.0, -0.5 * m["ankle_height"])
            if kind == "foot"
            else (0.0, 0.0, fraction * lengths[kind])
        )
    gyration = np.array([_GYRATION * spans[without_side(segment)] for segment in SEGMENTS])
    return Tree(offsets, masses / masses.sum(), centres, gyration)


JOINT_LIMITS: Final[dict[str, tuple[float, float]]] = {
    "lumbar": (0.0, 65.0), "thorax": (0.0, 50.0), "head": (0.0, 75.0),
    "upper_arm": (0.0, 175.0), "forearm": (-5.0, 150.0), "hand": (0.0, 95.0),
    "thigh": (0.0, 150.0), "shank": (-5.0, 155.0), "foot": (0.0, 75.0),
}  # fmt: skip
"""Degrees, by kind of segment. Hinges: range of the angle. Ball joints: range of the angle of the whole rotation away
from the zero pose (MuJoCo's meaning), at the reach of a trained gymnast."""


def joint_limit_rad(segment: str) -> tuple[float, float]:
    """Return the least and greatest angle of a segment's joint; the pelvis is free and has none."""
    low, high = JOINT_LIMITS[without_side(segment)]
    return float(np.radians(low)), float(np.radians(high))
