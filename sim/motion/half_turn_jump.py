"""Half-turn jump: the full-turn jump with half the turn, and arms that are held otherwise each time.

Following hands in a leap is developed on this one, so that the other is left for the test.
"""

from __future__ import annotations

import numpy as np

from sim.motion._authoring import Keys
from sim.motion._clip import MotionClip
from sim.motion.full_turn_jump import jump


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Jump near the middle of the hall; arms, place and heading vary with ``rng``."""
    arms: Keys = {
        f"{side}_{joint}": angles
        for side in ("left", "right")
        for joint, angles in (
            ("shoulder", (rng.uniform(10.0, 60.0), rng.uniform(5.0, 30.0), rng.uniform(30.0, 80.0))),
            ("elbow", rng.uniform(60.0, 120.0)),
        )
    }
    return jump(measurements, rng, 0.5, (arms, arms))
