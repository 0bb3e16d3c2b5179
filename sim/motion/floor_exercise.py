"""Floor exercise: run-up, hurdle, round-off, back handspring, tucked back somersault, landing; along the diagonal.

The poses are authored facing +x and travelling towards +x, at the rates of tumbling filmed from the side; `fit` makes
flight ballistic and feet and hands stand still; then the whole is turned onto a diagonal of the carpet.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from sim.motion._authoring import Keys, curve, interpolate, joint_rotations
from sim.motion._clip import MotionClip
from sim.motion._fit import Contact, fit, knots

FRAMES: Final = 171

# Running: foot, touch-down, take-off.
_STRIDES: Final[tuple[tuple[str, float, float], ...]] = (
    ("left", 0.34, 0.58), ("right", 0.62, 0.82), ("left", 0.88, 1.06), ("right", 1.14, 1.34),
)  # fmt: skip

_CONTACTS: Final[tuple[Contact, ...]] = (
    Contact("left_heel", 0.00, 0.15), Contact("left_toe", 0.00, 0.20),
    Contact("right_heel", 0.00, 0.26), Contact("right_toe", 0.00, 0.40),
    # hurdle: the right foot hops, the left steps into the lunge
    Contact("right_toe", 1.64, 1.90), Contact("left_heel", 1.85, 2.05), Contact("left_toe", 1.88, 2.18),
    # round-off
    Contact("left_hand", 2.08, 2.38), Contact("right_hand", 2.18, 2.50),
    Contact("left_toe", 2.71, 2.86), Contact("right_toe", 2.71, 2.86),
    # back handspring
    Contact("left_hand", 3.12, 3.34), Contact("right_hand", 3.12, 3.34),
    Contact("left_toe", 3.55, 3.71), Contact("right_toe", 3.55, 3.71),
    # landing
    Contact("left_toe", 4.57, 6.0), Contact("right_toe", 4.57, 6.0),
    Contact("left_heel", 4.63, 6.0), Contact("right_heel", 4.63, 6.0),
)  # fmt: skip

# Somersaulting (about the axis to the left of the direction of travel) and twist (about the body's long axis), degrees.
_TUMBLE: Final = [
    (0.00, 0), (0.20, 12), (0.47, 14), (0.87, 10), (1.27, 5), (1.34, 0), (1.50, -6), (1.64, 2), (1.77, 11),
    (1.88, 30), (1.99, 62), (2.10, 98),
    (2.24, 143), (2.40, 190), (2.51, 236), (2.71, 336), (2.79, 370), (2.86, 404), (3.12, 492), (3.23, 540), (3.34, 578),
    (3.55, 655), (3.71, 712), (3.87, 768), (3.97, 830), (4.13, 930), (4.29, 1005), (4.44, 1042), (4.57, 1052),
    (4.73, 1042), (5.10, 1078), (5.25, 1080),
]  # fmt: skip
_TWIST: Final = [(0.00, 0), (1.79, 0), (2.10, -50), (2.24, -85), (2.40, -105), (2.51, -140), (2.71, -180), (6.0, -180)]

# Root along the path (m) and height (hip heights when standing).
_TRAVEL: Final = [
    (0.00, 0.00), (0.18, 0.05), (0.40, 0.40), (0.80, 1.40), (1.34, 3.20), (1.64, 4.20), (2.12, 5.65), (2.54, 6.75),
    (2.71, 7.05), (2.86, 7.50), (3.12, 8.05), (3.34, 8.55), (3.55, 8.92), (3.71, 9.15), (4.57, 10.40),
    (4.85, 10.55), (5.15, 10.60),
]  # fmt: skip
_HEIGHT: Final = [
    (0.00, 1.0), (0.20, 0.97), (1.27, 0.97), (1.36, 1.02), (1.50, 1.10), (1.64, 1.0), (1.94, 0.88), (2.10, 0.95),
    (2.34, 1.18), (2.54, 1.15), (2.69, 0.92), (2.76, 0.86), (2.83, 0.95), (2.94, 1.08), (3.12, 1.15), (3.23, 1.2),
    (3.34, 1.17), (3.55, 0.93), (3.64, 0.87), (3.71, 1.0), (4.13, 1.8), (4.57, 0.85), (4.73, 0.62), (5.10, 0.98),
]  # fmt: skip

_KEYS: Final[tuple[tuple[float, Keys], ...]] = (
    (0.00, {"shoulder": (20, 10, 0), "elbow": 15, "hip": (0, 5, 0), "knee": 4, "ankle": 0, "trunk": (0, 0, 0)}),
    # hurdle: take-off from the right foot, left knee and arms up
    (1.34, {"right_hip": (-18, 3, 0), "right_knee": 12, "right_ankle": 28, "left_hip": (65, 3, 0), "left_knee": 85,
            "left_ankle": 10, "shoulder": (60, 10, 0), "elbow": 50, "trunk": (5, 0, 0)}),
    (1.50, {"right_hip": (5, 3, 0), "right_knee": 35, "right_ankle": 20, "left_hip": (85, 3, 0), "left_knee": 80,
            "left_ankle": 20, "shoulder": (155, 10, 0), "elbow": 15}),
    (1.64, {"right_hip": (18, 3, 0), "right_knee": 22, "right_ankle": 5, "left_hip": (75, 3, 0), "left_knee": 40,
            "left_ankle": 10, "shoulder": (165, 5, 0), "elbow": 8, "trunk": (0, 0, 0)}),
    (1.75, {"right_knee": 35, "right_ankle": -12}),
    (1.88, {"right_hip": (0, 3, 0), "right_knee": 20, "right_ankle": 20, "left_hip": (62, 3, 0), "left_knee": 18,
            "left_ankle": -2, "shoulder": (165, 0, 0), "elbow": 5, "trunk": (10, 0, 0)}),
    # round-off: the right leg kicks over, the left pushes and follows, hands left then right
    (1.99, {"left_knee": 42, "left_ankle": -12, "left_hip": (90, 3, 0)}),
    (2.10, {"right_hip": (-20, 12, 0), "right_knee": 5, "right_ankle": 40, "left_hip": (88, 10, 0), "left_knee": 25,
            "left_ankle": 5, "wrist": 40, "trunk": (12, 0, 0)}),
    (2.18, {"left_hip": (72, 20, 0), "left_knee": 8, "left_ankle": 35, "wrist": 70}),
    (2.29, {"right_hip": (5, 42, 0), "left_hip": (34, 45, 0), "left_knee": 3, "trunk": (0, 0, 0)}),
    (2.43, {"right_hip": (5, 22, 0), "left_hip": (8, 30, 0), "ankle": 45, "shoulder": (165, 0, 0), "wrist": 70}),
    (2.51, {"hip": (32, 5, 0), "knee": 8, "wrist": 40, "trunk": (15, 0, 0), "shoulder": (165, 0, 0)}),
    (2.71, {"hip": (26, 4, 0), "knee": 26, "ankle": 15, "wrist": 10, "shoulder": (156, 0, 0), "elbow": 10,
            "trunk": (12, 0, 0), "neck": (0, 0, 0)}),
    # back handspring
    (2.78, {"hip": (35, 4, 0), "knee": 48, "ankle": -5, "shoulder": (160, 5, 0), "trunk": (-6, 0, 0)}),
    (2.85, {"hip": (0, 4, 0), "knee": 18, "ankle": 35, "shoulder": (163, 5, 0), "trunk": (-20, 0, 0)}),
    (2.98, {"hip": (-18, 4, 0), "knee": 18, "ankle": 45, "shoulder": (164, 3, 0), "trunk": (-30, 0, 0),
            "neck": (-35, 0, 0), "wrist": 30}),
    (3.12, {"hip": (-18, 4, 0), "knee": 28, "trunk": (-36, 0, 0), "wrist": 75, "elbow": 8}),
    (3.23, {"hip": (-4, 3, 0), "knee": 12, "trunk": (-18, 0, 0), "wrist": 75, "elbow": 12, "neck": (-25, 0, 0)}),
    (3.34, {"hip": (18, 3, 0), "knee": 5, "ankle": 45, "trunk": (8, 0, 0), "wrist": 45, "elbow": 3,
            "shoulder": (165, 0, 0), "neck": (0, 0, 0)}),
    (3.55, {"hip": (42, 4, 0), "knee": 18, "ankle": 15, "trunk": (15, 0, 0), "wrist": 5, "shoulder": (150, 0, 0)}),
    (3.64, {"hip": (30, 4, 0), "knee": 36, "ankle": -2, "shoulder": (150, 5, 0), "trunk": (8, 0, 0)}),
    # back somersault, tucked
    (3.71, {"hip": (4, 4, 0), "knee": 8, "ankle": 38, "trunk": (-2, 0, 0), "shoulder": (158, 8, 0), "elbow": 8}),
    (3.87, {"hip": (45, 5, 0), "knee": 60, "ankle": 45, "trunk": (10, 0, 0), "shoulder": (110, 8, 0), "elbow": 25}),
    (4.01, {"hip": (122, 8, 0), "knee": 125, "trunk": (38, 0, 0), "neck": (15, 0, 0), "shoulder": (52, 8, 0),
            "elbow": 45}),
    (4.21, {"hip": (122, 8, 0), "knee": 125, "trunk": (36, 0, 0), "shoulder": (52, 8, 0), "elbow": 45, "ankle": 45}),
    (4.40, {"hip": (68, 6, 0), "knee": 55, "ankle": 20, "trunk": (18, 0, 0), "neck": (5, 0, 0),
            "shoulder": (50, 15, 0), "elbow": 20}),
    (4.57, {"hip": (42, 6, 0), "knee": 30, "ankle": 5, "trunk": (14, 0, 0), "shoulder": (60, 15, 0), "elbow": 15}),
    # landing
    (4.73, {"hip": (82, 8, 0), "knee": 82, "ankle": -28, "trunk": (22, 0, 0), "shoulder": (80, 12, 0),
            "neck": (-10, 0, 0)}),
    (5.10, {"hip": (4, 4, 0), "knee": 5, "ankle": 0, "trunk": (0, 0, 0), "shoulder": (150, 14, 0), "elbow": 8,
            "neck": (0, 0, 0)}),
    (5.25, {"hip": (1, 3, 0), "knee": 2, "shoulder": (165, 16, 0), "elbow": 3}),
)  # fmt: skip


def _running_keys() -> list[tuple[float, Keys]]:
    keys: list[tuple[float, Keys]] = []
    starts = {"left": 0.20, "right": 0.40}  # when the foot last left the floor
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
    return [(time, values) for time, values in keys if time < 1.32 or "elbow" not in values]


def _running_contacts() -> list[Contact]:
    return [Contact(f"{side}_toe", down, up) for side, down, up in _STRIDES]


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Tumble from one corner of the carpet towards the opposite one; corner, line and start vary with ``rng``."""
    times = knots(FRAMES)

    heading = 45.0 + 90.0 * float(rng.integers(4)) + float(rng.normal(0.0, 1.5))
    direction = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    middle = rng.normal(0.0, 0.15, 2)
    angles = np.stack([np.full_like(times, heading), curve(_TUMBLE, times), curve(_TWIST, times)], axis=1)
    pelvis = Rotation.from_euler("ZYZ", angles, degrees=True).as_matrix()
    rotations = joint_rotations(interpolate([*_running_keys(), *_KEYS], times), pelvis)
    hip_height = measurements["thigh"] + measurements["shank"] + measurements["ankle_height"]
    travel = curve(_TRAVEL, times) * hip_height / 0.9
    path = middle + (travel - travel[-1] / 2)[:, None] * direction
    roots = np.concatenate([path, (curve(_HEIGHT, times) * hip_height)[:, None]], axis=1)
    return fit(measurements, FRAMES, roots, rotations, [*_running_contacts(), *_CONTACTS], (0.15, 0.15, 0.15))
