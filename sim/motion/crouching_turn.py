"""Crouching turn: down into a deep crouch with the arms wrapped around the trunk, round on the spot in small steps on
the balls of the feet, and up again.

The poses are authored facing +x and turning to the left; `fit` keeps the feet where they stand.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from sim.motion._authoring import Keys, curve, interpolate, joint_rotations
from sim.motion._clip import MotionClip
from sim.motion._fit import Contact, fit, knots

FRAMES: Final = 151

_DOWN: Final = 1.25  # the crouch is reached, and the turn begins
_STEP: Final = 0.28  # s, of each foot in turn
_STEPS: Final = 9
_TURN: Final = 45.0  # degrees that a step is ahead of the other foot; the last only joins it
_SWING: Final = 0.6  # share of a step that the foot is in the air
_UP: Final = _DOWN + _STEPS * _STEP

# Degrees of the pelvis, height in hip heights, and how far the root is behind the middle of the feet in leg lengths.
_LEAN: Final = [(0.00, 0), (0.35, 0), (1.20, 30), (_UP, 30), (_UP + 0.75, 4), (_UP + 1.0, 0)]
_HEIGHT: Final = [(0.00, 0.995), (0.30, 0.99), (1.20, 0.50), (_UP, 0.50), (_UP + 0.85, 0.99), (_UP + 1.1, 0.995)]
_BEHIND: Final = [(0.00, 0.06), (0.35, 0.06), (1.20, 0.20), (_UP, 0.20), (_UP + 0.80, 0.06)]

_HUG: Final[Keys] = {
    "left_shoulder": (46, 5, 88), "right_shoulder": (38, 9, 92), "left_elbow": 109, "right_elbow": 103, "wrist": 40,
}  # fmt: skip
_CROUCH: Final[Keys] = {"hip": (100, 14, 0), "knee": 118, "ankle": -16, "trunk": (42, 0, 0), "neck": (10, 0, 0)}

_KEYS: Final[tuple[tuple[float, Keys], ...]] = (
    (0.00, {"shoulder": (4, 10, 0), "elbow": 10, "wrist": 5, "hip": (0, 5, 0), "knee": 3, "ankle": 0,
            "trunk": (0, 0, 0), "neck": (0, 0, 0)}),
    (0.35, {"hip": (2, 5, 0), "knee": 5, "ankle": -2, "trunk": (2, 0, 0), "shoulder": (30, 25, 10), "elbow": 60}),
    (1.20, _CROUCH),
    (_UP, _CROUCH),
    (_UP + 0.80, {"hip": (3, 5, 0), "knee": 5, "ankle": -1, "trunk": (3, 0, 0), "neck": (0, 0, 0)}),
    (_UP + 1.10, {"shoulder": (4, 10, 0), "elbow": 10, "wrist": 5, "hip": (0, 5, 0), "knee": 3, "ankle": 0,
                  "trunk": (0, 0, 0)}),
)  # fmt: skip


def _steps(turns: float) -> tuple[list[Contact], dict[str, list[tuple[float, float]]]]:
    """Times of stance of heels and balls, and the heading (s, degrees) of each foot; left and right in turn."""
    contacts, headings = [], {"left": [(0.0, 0.0)], "right": [(0.0, 0.0)]}
    for side, first in (("left", 0), ("right", 1)):
        start = 0.0
        contacts.append(Contact(f"{side}_heel", 0.0, 0.70))
        for step in range(first, _STEPS, 2):
            lift = _DOWN + step * _STEP
            down = lift + _SWING * _STEP
            contacts.append(Contact(f"{side}_toe", start, lift))
            headings[side] += [(lift, headings[side][-1][1]), (down, turns * min((step + 1) * _TURN, 360.0))]
            start = down
        contacts += [Contact(f"{side}_toe", start, 9.0), Contact(f"{side}_heel", _UP + 0.55, 9.0)]
    return contacts, headings


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Turn once round near the middle of the hall; place and heading vary with ``rng``."""
    return crouch(measurements, rng, 1.0, _HUG)


def crouch(measurements: dict[str, float], rng: np.random.Generator, turns: float, hug: Keys) -> MotionClip:
    """Crouch and turn round so many ``turns``, the arms held as ``hug`` has them."""
    times = knots(FRAMES)
    contacts, foot_headings = _steps(turns)
    turned = curve([(0.0, 0.0), (_DOWN, 0.0), (_UP, 360.0 * turns), (9.0, 360.0 * turns)], times)
    channels = interpolate([*_KEYS, (0.85, hug), (_UP + 0.25, hug)], times)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # a bent hip brings the foot round by abduction
        channels[f"{side}_hip"][:, 1] += sign * (curve(foot_headings[side], times) - turned)
    heading = float(rng.uniform(0.0, 360.0))
    azimuth = heading + turned
    pelvis = Rotation.from_euler("ZY", np.stack([azimuth, curve(_LEAN, times)], axis=1), degrees=True).as_matrix()
    leg = measurements["thigh"] + measurements["shank"] + measurements["ankle_height"]
    facing = np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))], axis=1)
    path = rng.normal(0.0, 0.5, 2) - (curve(_BEHIND, times) * leg)[:, None] * facing
    roots = np.concatenate([path, (curve(_HEIGHT, times) * leg)[:, None]], axis=1)
    return fit(measurements, FRAMES, roots, joint_rotations(channels, pelvis), contacts, (0.05, 0.05, 0.05))
