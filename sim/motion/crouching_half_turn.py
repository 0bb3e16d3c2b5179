"""Crouching half turn: the crouching turn with half the turn, and arms that are wrapped otherwise each time.

Following hands on the trunk is developed on this one, so that the other is left for the test.
"""

from __future__ import annotations

import numpy as np

from sim.motion._authoring import Keys
from sim.motion._clip import MotionClip
from sim.motion.crouching_turn import crouch


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Turn near the middle of the hall; arms, place and heading vary with ``rng``."""
    outer, inner = ("left", "right") if rng.uniform() < 0.5 else ("right", "left")
    higher, closer = float(rng.uniform(-6.0, 8.0)), float(rng.uniform(-8.0, 6.0))
    hug: Keys = {
        f"{outer}_shoulder": (48 + higher, 5, 86), f"{outer}_elbow": 107 + closer,
        f"{inner}_shoulder": (36 + higher, 9, 90), f"{inner}_elbow": 101 + closer, "wrist": 30,
    }  # fmt: skip
    return crouch(measurements, rng, 0.5, hug)
