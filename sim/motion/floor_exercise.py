"""Floor exercise: run-up, hurdle, round-off, back handspring, tucked back somersault, landing; along the diagonal.

The poses are authored facing +x and travelling towards +x, at the rates of tumbling filmed from the side; `fit` makes
flight ballistic and feet and hands stand still; then the whole is turned onto a diagonal of the carpet.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from pzcap.types import Array
from sim.motion._authoring import Keys, interpolate, joint_rotations
from sim.motion._clip import MotionClip
from sim.motion._fit import Contact, fit, knots

FRAMES: Final = 171

# Running: foot, touch-down, take-off.
_STRIDES: Final[tuple[tuple[str, float, float], ...]] = (
    ("left", 0.44, 0.68), ("right", 0.72, 0.92), ("left", 0.98, 1.16), ("right", 1.24, 1.40), ("left", 1.48, 1.64),
    ("right", 1.72, 1.90),
)  # fmt: skip

_CONTACTS: Final[tuple[Contact, ...]] = (
    Contact("left_heel", 0.0, 0.20), Contact("left_toe", 0.0, 0.30),
    Contact("right_heel", 0.0, 0.36), Contact("right_toe", 0.0, 0.50),
    # hurdle: the right foot hops, the left steps into the lunge
    Contact("right_toe", 2.18, 2.42), Contact("left_heel", 2.37, 2.55), Contact("left_toe", 2.40, 2.67),
    # round-off
    Contact("left_hand", 2.58, 2.87), Contact("right_hand", 2.67, 2.97),
    Contact("left_toe", 3.11, 3.23), Contact("right_toe", 3.11, 3.23),
    # back handspring
    Contact("left_hand", 3.40, 3.60), Contact("right_hand", 3.40, 3.60),
    Contact("left_toe", 3.71, 3.83), Contact("right_toe", 3.71, 3.83),
    # landing
    Contact("left_toe", 4.65, 6.0), Contact("right_toe", 4.65, 6.0),
    Contact("left_heel", 4.71, 6.0), Contact("right_heel", 4.71, 6.0),
)  # fmt: skip

# Somersaulting (about the axis to the left of the direction of travel) and twist (about the body's long axis), degrees.
_TUMBLE: Final = [
    (0.0, 0), (0.3, 12), (0.6, 14), (1.2, 10), (1.8, 5), (1.9, 0), (2.05, -6), (2.18, 2), (2.40, 25), (2.60, 92),
    (2.72, 140), (2.85, 188), (2.97, 236), (3.11, 305), (3.23, 383), (3.40, 500), (3.50, 548), (3.60, 592),
    (3.71, 655), (3.83, 715), (3.98, 768), (4.08, 830), (4.23, 930), (4.38, 1005), (4.53, 1042), (4.65, 1052),
    (4.81, 1042), (5.18, 1078), (5.33, 1080),
]  # fmt: skip
_TWIST: Final = [(0.0, 0), (2.38, 0), (2.60, -48), (2.72, -85), (2.85, -105), (2.97, -145), (3.11, -180), (6.0, -180)]

# Root along the path (m) and height (hip heights when standing).
_TRAVEL: Final = [
    (0.0, 0.0), (0.25, 0.05), (0.5, 0.40), (0.9, 1.45), (1.4, 3.25), (1.9, 5.15), (2.18, 6.15), (2.62, 7.6),
    (2.98, 8.7), (3.11, 8.95), (3.23, 9.25), (3.40, 9.75), (3.60, 10.3), (3.71, 10.6), (3.83, 10.85), (4.65, 12.2),
    (4.93, 12.35), (5.23, 12.4),
]  # fmt: skip
_HEIGHT: Final = [
    (0.0, 1.0), (0.3, 0.97), (1.8, 0.97), (1.92, 1.02), (2.05, 1.10), (2.18, 1.0), (2.45, 0.88), (2.6, 0.95),
    (2.8, 1.18), (2.98, 1.15), (3.11, 0.92), (3.17, 0.86), (3.23, 0.95), (3.31, 1.08), (3.40, 1.15), (3.50, 1.2),
    (3.60, 1.15), (3.71, 0.93), (3.77, 0.87), (3.83, 1.0), (4.23, 1.8), (4.65, 0.85), (4.81, 0.62), (5.18, 0.98),
]  # fmt: skip

_KEYS: Final[tuple[tuple[float, Keys], ...]] = (
    (0.0, {"shoulder": (20, 10, 0), "elbow": 15, "hip": (0, 5, 0), "knee": 4, "ankle": 0, "trunk": (0, 0, 0)}),
    # hurdle: take-off from the right foot, left knee and arms up
    (1.90, {"right_hip": (-18, 3, 0), "right_knee": 12, "right_ankle": 28, "left_hip": (65, 3, 0), "left_knee": 85,
            "left_ankle": 10, "shoulder": (60, 10, 0), "elbow": 50, "trunk": (5, 0, 0)}),
    (2.05, {"right_hip": (5, 3, 0), "right_knee": 35, "right_ankle": 20, "left_hip": (85, 3, 0), "left_knee": 80,
            "left_ankle": 20, "shoulder": (155, 10, 0), "elbow": 15}),
    (2.18, {"right_hip": (18, 3, 0), "right_knee": 22, "right_ankle": 5, "left_hip": (75, 3, 0), "left_knee": 40,
            "left_ankle": 10, "shoulder": (165, 5, 0), "elbow": 8, "trunk": (0, 0, 0)}),
    (2.28, {"right_knee": 35, "right_ankle": -12}),
    (2.40, {"right_hip": (0, 3, 0), "right_knee": 20, "right_ankle": 20, "left_hip": (62, 3, 0), "left_knee": 18,
            "left_ankle": -2, "shoulder": (165, 0, 0), "elbow": 5, "trunk": (10, 0, 0)}),
    # round-off: the right leg kicks over, the left pushes and follows, hands left then right
    (2.50, {"left_knee": 42, "left_ankle": -12, "left_hip": (90, 3, 0)}),
    (2.60, {"right_hip": (-20, 12, 0), "right_knee": 5, "right_ankle": 40, "left_hip": (88, 10, 0), "left_knee": 25,
            "left_ankle": 5, "wrist": 40, "trunk": (12, 0, 0)}),
    (2.67, {"left_hip": (72, 20, 0), "left_knee": 8, "left_ankle": 35, "wrist": 70}),
    (2.74, {"right_hip": (5, 42, 0), "left_hip": (30, 45, 0), "left_knee": 3, "trunk": (0, 0, 0)}),
    (2.86, {"right_hip": (5, 18, 0), "left_hip": (5, 25, 0), "ankle": 45, "shoulder": (165, 0, 0), "wrist": 70}),
    (2.97, {"hip": (35, 5, 0), "knee": 8, "wrist": 40, "trunk": (15, 0, 0), "shoulder": (165, 0, 0)}),
    (3.11, {"hip": (42, 4, 0), "knee": 22, "ankle": 15, "wrist": 10, "shoulder": (135, 0, 0), "elbow": 10,
            "trunk": (15, 0, 0), "neck": (0, 0, 0)}),
    # back handspring
    (3.17, {"hip": (35, 4, 0), "knee": 48, "ankle": -5, "shoulder": (125, 5, 0)}),
    (3.23, {"hip": (0, 4, 0), "knee": 18, "ankle": 35, "shoulder": (150, 5, 0), "trunk": (-8, 0, 0)}),
    (3.31, {"hip": (-18, 4, 0), "knee": 18, "ankle": 45, "shoulder": (165, 3, 0), "trunk": (-45, 0, 0),
            "neck": (-35, 0, 0), "wrist": 30}),
    (3.40, {"hip": (-18, 4, 0), "knee": 28, "trunk": (-45, 0, 0), "wrist": 75, "elbow": 8}),
    (3.50, {"hip": (-4, 3, 0), "knee": 12, "trunk": (-18, 0, 0), "wrist": 75, "elbow": 12, "neck": (-25, 0, 0)}),
    (3.60, {"hip": (18, 3, 0), "knee": 5, "ankle": 45, "trunk": (12, 0, 0), "wrist": 45, "elbow": 3,
            "shoulder": (165, 0, 0), "neck": (0, 0, 0)}),
    (3.71, {"hip": (42, 4, 0), "knee": 18, "ankle": 15, "trunk": (18, 0, 0), "wrist": 5, "shoulder": (145, 0, 0)}),
    (3.77, {"hip": (30, 4, 0), "knee": 36, "ankle": -2, "shoulder": (140, 5, 0)}),
    # back somersault, tucked
    (3.83, {"hip": (4, 4, 0), "knee": 8, "ankle": 38, "trunk": (-4, 0, 0), "shoulder": (160, 8, 0), "elbow": 8}),
    (3.98, {"hip": (45, 5, 0), "knee": 60, "ankle": 45, "trunk": (10, 0, 0), "shoulder": (110, 8, 0), "elbow": 25}),
    (4.12, {"hip": (122, 8, 0), "knee": 125, "trunk": (38, 0, 0), "neck": (15, 0, 0), "shoulder": (52, 8, 0),
            "elbow": 45}),
    (4.31, {"hip": (122, 8, 0), "knee": 125, "trunk": (36, 0, 0), "shoulder": (52, 8, 0), "elbow": 45, "ankle": 45}),
    (4.49, {"hip": (68, 6, 0), "knee": 55, "ankle": 20, "trunk": (18, 0, 0), "neck": (5, 0, 0),
            "shoulder": (50, 15, 0), "elbow": 20}),
    (4.65, {"hip": (42, 6, 0), "knee": 30, "ankle": 5, "trunk": (14, 0, 0), "shoulder": (60, 15, 0), "elbow": 15}),
    # landing
    (4.81, {"hip": (82, 8, 0), "knee": 82, "ankle": -28, "trunk": (22, 0, 0), "shoulder": (80, 12, 0),
            "neck": (-10, 0, 0)}),
    (5.18, {"hip": (4, 4, 0), "knee": 5, "ankle": 0, "trunk": (0, 0, 0), "shoulder": (150, 14, 0), "elbow": 8,
            "neck": (0, 0, 0)}),
    (5.33, {"hip": (1, 3, 0), "knee": 2, "shoulder": (165, 16, 0), "elbow": 3}),
)  # fmt: skip


def _running_keys() -> list[tuple[float, Keys]]:
    keys: list[tuple[float, Keys]] = []
    starts = {"left": 0.30, "right": 0.50}  # when the foot last left the floor
    for side, down, up in _STRIDES:
        other = "right" if side == "left" else "left"
        swing = down - starts[side]
        middle = (down + up) / 2
        keys += [
            (starts[side], {f"{side}_hip": (-12, 3, 0), f"{side}_knee": 15, f"{side}_ankle": 25}),
            (down - 0.60 * swing, {f"{side}_hip": (15, 3, 0), f"{side}_knee": 88, f"{side}_ankle": 10}),
            (down - 0.28 * swing, {f"{side}_hip": (52, 3, 0), f"{side}_knee": 70, f"{side}_ankle": 0}),
            (down, {f"{side}_hip": (30, 3, 0), f"{side}_knee": 20, f"{side}_ankle": 4}),
            (middle, {f"{side}_hip": (10, 3, 0), f"{side}_knee": 36, f"{side}_ankle": -12,
                      f"{other}_shoulder": (0, 12, 0), f"{side}_shoulder": (0, 12, 0)}),
            (up, {f"{other}_shoulder": (-45, 12, 0), f"{side}_shoulder": (40, 8, 0), "elbow": 85}),
        ]  # fmt: skip
        starts[side] = up
    return [(time, values) for time, values in keys if time < 1.88 or "elbow" not in values]


def _running_contacts() -> list[Contact]:
    return [Contact(f"{side}_toe", down, up) for side, down, up in _STRIDES]


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Tumble from one corner of the carpet towards the opposite one; corner, line and start vary with ``rng``."""
    times = knots(FRAMES)

    def curve(keys: Sequence[tuple[float, float]]) -> Array:
        at, values = np.array(keys, dtype=float).T
        return PchipInterpolator(at, values)(np.clip(times, at[0], at[-1]))

    heading = 45.0 + 90.0 * float(rng.integers(4)) + float(rng.normal(0.0, 1.5))
    direction = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    middle = rng.normal(0.0, 0.15, 2)
    angles = np.stack([np.full_like(times, heading), curve(_TUMBLE), curve(_TWIST)], axis=1)
    pelvis = Rotation.from_euler("ZYZ", angles, degrees=True).as_matrix()
    rotations = joint_rotations(interpolate([*_running_keys(), *_KEYS], times), pelvis)
    hip_height = measurements["thigh"] + measurements["shank"] + measurements["ankle_height"]
    travel = curve(_TRAVEL) * hip_height / 0.9
    path = middle + (travel - travel[-1] / 2)[:, None] * direction
    roots = np.concatenate([path, (curve(_HEIGHT) * hip_height)[:, None]], axis=1)
    return fit(measurements, FRAMES, roots, rotations, [*_running_contacts(), *_CONTACTS], (0.15, 0.15, 0.15))
