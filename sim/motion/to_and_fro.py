"""A pedestrian who walks to and fro, forward and then backward on the same path, for 100 s: a long take."""

from __future__ import annotations

from typing import Final

import numpy as np

from sim.motion import pedestrian
from sim.motion._clip import END_POINTS, FRAME_RATE, MotionClip

FRAMES: Final = 3000
_KNOT_S: Final = 0.02


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Walk the arc of `pedestrian.make` ten times to and ten times fro; at the ends the walk slows down to rest."""
    walk = pedestrian.make(measurements, rng)
    knots_s = np.arange(0.0, (FRAMES - 1) / FRAME_RATE + _KNOT_S, _KNOT_S)
    way_s = walk.duration_s * (1.0 - np.cos(np.pi * knots_s / (FRAMES / FRAME_RATE / 20))) / 2.0
    poses = [walk.at(t) for t in way_s.tolist()]
    contact = np.array([[walk.contacts(t)[end] for end in END_POINTS] for t in way_s.tolist()])
    roots_m, rotations = np.array([pose.root_position_m for pose in poses]), np.array([one.rotations for one in poses])
    return MotionClip.from_samples(FRAMES, knots_s, roots_m, rotations, contact)
