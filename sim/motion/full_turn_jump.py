"""Full-turn jump: a step forward, take-off from both feet, a whole turn about the vertical with the arms in, landing.

The poses are authored facing +x and turning to the left; `fit` makes the flight ballistic and keeps its angular
momentum, so that the body turns faster while the arms are in; then the whole is turned to a heading of its own.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from sim.motion._authoring import Keys, curve, interpolate, joint_rotations
from sim.motion._clip import MotionClip
from sim.motion._fit import Contact, fit, knots

FRAMES: Final = 106

_TAKE_OFF: Final = 1.50
_LANDING: Final = 2.08

_CONTACTS: Final[tuple[Contact, ...]] = (
    # a step with the left foot, the right one joins it
    Contact("left_heel", 0.00, 0.30), Contact("left_toe", 0.00, 0.38),
    Contact("right_heel", 0.00, 0.66), Contact("right_toe", 0.00, 0.78),
    Contact("left_heel", 0.70, 1.36), Contact("left_toe", 0.76, _TAKE_OFF),
    Contact("right_heel", 1.08, 1.36), Contact("right_toe", 1.04, _TAKE_OFF),
    Contact("left_toe", _LANDING, 6.0), Contact("right_toe", _LANDING, 6.0),
    Contact("left_heel", _LANDING + 0.07, 6.0), Contact("right_heel", _LANDING + 0.07, 6.0),
)  # fmt: skip

# Degrees, seconds. The shoulders wind up to the right, lead at take-off, and wait for the feet at the end.
_TURN: Final = [(0.00, 0), (1.05, 0), (1.28, -12), (1.40, 4), (1.50, 32), (2.08, 336), (2.18, 352), (2.50, 360)]
_LEAN: Final = [
    (0.00, 0), (0.50, 4), (0.95, 6), (1.22, 32), (1.50, 2), (1.80, 0), (2.08, 6), (2.30, 30), (2.90, 3), (3.30, 0),
]  # fmt: skip

# Root along the path (m) and height (hip heights when standing).
_TRAVEL: Final = [
    (0.00, 0.00), (0.20, 0.03), (0.75, 0.42), (1.08, 0.68), (1.25, 0.70), (1.50, 0.86), (2.08, 1.22), (2.32, 1.28),
    (2.90, 1.33),
]  # fmt: skip
_HEIGHT: Final = [
    (0.00, 1.0), (0.35, 0.98), (0.72, 0.96), (1.00, 0.95), (1.24, 0.72), (1.50, 1.07), (1.79, 1.47), (2.08, 1.02),
    (2.32, 0.68), (2.90, 0.98), (3.20, 1.0),
]  # fmt: skip

_KEYS: Final[tuple[tuple[float, Keys], ...]] = (
    (0.00, {"shoulder": (5, 10, 0), "elbow": 10, "hip": (0, 4, 0), "knee": 3, "ankle": 0, "trunk": (0, 0, 0),
            "neck": (0, 0, 0)}),
    # the step: left, right
    (0.36, {"left_hip": (10, 4, 0), "left_knee": 25, "left_ankle": 15, "left_shoulder": (-15, 12, 0),
            "right_shoulder": (25, 10, 0)}),
    (0.54, {"left_hip": (35, 4, 0), "left_knee": 42, "left_ankle": 0, "right_hip": (-5, 4, 0)}),
    (0.72, {"left_hip": (28, 4, 0), "left_knee": 8, "left_ankle": -4, "right_hip": (-16, 4, 0), "right_knee": 12,
            "right_ankle": 18, "shoulder": (5, 14, 0), "elbow": 20}),
    (0.90, {"right_hip": (18, 4, 0), "right_knee": 50, "right_ankle": 5, "left_hip": (8, 4, 0), "left_knee": 12,
            "left_ankle": -8}),
    (1.06, {"right_hip": (14, 4, 0), "right_knee": 18, "right_ankle": 2, "left_hip": (6, 4, 0), "left_knee": 16,
            "shoulder": (-35, 14, 0), "elbow": 15, "trunk": (4, 0, 0)}),
    # the swing: down with the arms behind, and up with both
    (1.24, {"hip": (78, 8, 0), "knee": 84, "ankle": -30, "trunk": (22, 0, -14), "left_shoulder": (-25, 25, 0),
            "right_shoulder": (-45, 25, 0), "elbow": 20, "neck": (-15, 0, 4)}),
    (1.40, {"hip": (38, 5, 0), "knee": 44, "ankle": -8, "trunk": (10, 0, 8), "shoulder": (50, 30, 0), "elbow": 40}),
    (1.50, {"hip": (4, 3, 0), "knee": 6, "ankle": 38, "trunk": (-2, 0, 22), "left_shoulder": (85, 40, 0),
            "right_shoulder": (95, 15, 0), "elbow": 65, "neck": (0, 0, 12)}),
    # the turn: legs closed, and arms as they are given
    (1.64, {"hip": (2, 1, 0), "knee": 3, "ankle": 48, "trunk": (0, 0, 10), "wrist": 5, "neck": (0, 0, 18)}),
    (1.92, {"hip": (6, 1, 0), "knee": 6, "ankle": 42, "trunk": (4, 0, 0), "neck": (8, 0, 10)}),
    (2.08, {"hip": (26, 6, 0), "knee": 24, "ankle": 18, "trunk": (8, 0, -4), "shoulder": (55, 45, 15), "elbow": 60,
            "neck": (8, 0, 0)}),
    # landing
    (2.32, {"hip": (82, 10, 0), "knee": 88, "ankle": -32, "trunk": (22, 0, 0), "shoulder": (70, 38, 0), "elbow": 25,
            "neck": (-12, 0, 0)}),
    (2.90, {"hip": (8, 5, 0), "knee": 8, "ankle": -2, "trunk": (2, 0, 0), "shoulder": (60, 40, 0), "elbow": 20,
            "neck": (0, 0, 0)}),
    (3.35, {"hip": (0, 4, 0), "knee": 3, "ankle": 0, "trunk": (0, 0, 0), "shoulder": (5, 10, 0), "elbow": 10}),
)  # fmt: skip

_IN_FLIGHT: Final = (1.64, 1.92)
_HANDS_AT_THE_CHEST: Final[tuple[Keys, Keys]] = (
    {"shoulder": (32, 12, 72), "elbow": 112}, {"shoulder": (32, 12, 72), "elbow": 110},
)  # fmt: skip


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Jump near the middle of the hall; place and heading vary with ``rng``."""
    return jump(measurements, rng, 1.0, _HANDS_AT_THE_CHEST)


def jump(measurements: dict[str, float], rng: np.random.Generator, turns: float, arms: tuple[Keys, Keys]) -> MotionClip:
    """Jump with so many ``turns`` of the body, the ``arms`` as they are at the beginning and the end of the flight."""
    times = knots(FRAMES)
    heading = float(rng.uniform(0.0, 360.0))
    direction = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    middle = rng.normal(0.0, 0.5, 2)
    angles = np.stack([heading + turns * curve(_TURN, times), curve(_LEAN, times)], axis=1)
    pelvis = Rotation.from_euler("ZY", angles, degrees=True).as_matrix()
    keys = [*_KEYS, *zip(_IN_FLIGHT, arms, strict=True)]
    rotations = joint_rotations(interpolate(keys, times), pelvis)
    hip_height = measurements["thigh"] + measurements["shank"] + measurements["ankle_height"]
    travel = curve(_TRAVEL, times) * hip_height / 0.9
    path = middle + (travel - travel[-1] / 2)[:, None] * direction
    roots = np.concatenate([path, (curve(_HEIGHT, times) * hip_height)[:, None]], axis=1)
    return fit(measurements, FRAMES, roots, rotations, _CONTACTS, (0.10, 0.10, 0.10))
