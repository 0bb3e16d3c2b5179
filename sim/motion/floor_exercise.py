"""Floor exercise: run-up, hurdle, round-off, back handspring, back somersault, landing, along the carpet's diagonal."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from sim.anthropometry import body_tree
from sim.motion._authoring import interpolate, joint_rotations
from sim.motion._clip import MotionClip
from sim.motion._kinematics import Frames

FRAMES = 171


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Tumble along a diagonal of the carpet."""
    times = np.arange(0.0, (FRAMES - 1) / 30 + 1e-9, 1 / 60)
    heading = 45.0 + 90.0 * rng.integers(4) + rng.normal(0, 2)
    theta = PchipInterpolator(
        [0, 2.4, 2.75, 3.1, 3.42, 3.75, 3.9, 4.5, 4.7, 6], [0, 20, 180, 360, 540, 720, 740, 1060, 1080, 1080]
    )(times)
    phi = PchipInterpolator([0, 2.4, 2.75, 3.1, 6], [0, 0, -90, -180, -180])(times)
    travel = PchipInterpolator([0, 0.3, 2, 3.2, 4.6, 4.8, 6], [-5.5, -5.4, 0, 2.5, 5, 5.2, 5.2])(times)
    height = PchipInterpolator(
        [0, 2.4, 2.75, 3.15, 3.3, 3.42, 3.8, 4.2, 4.6, 4.8, 5.3, 6],
        [0.9, 0.8, 1.0, 0.8, 1.0, 1.0, 0.8, 1.7, 0.85, 0.6, 0.9, 0.9],
    )(times)
    pelvis = Rotation.from_euler("ZYZ", np.stack([0 * times + heading, theta, phi], axis=1), degrees=True).as_matrix()
    keys = [(0.0, {"shoulder": (10.0, 5.0, 0.0)}), (2.3, {"shoulder": (170.0, 0.0, 0.0)}), (3.8, {"shoulder": (170.0, 0.0, 0.0)}),
            (4.1, {"shoulder": (40.0, 0.0, 0.0), "hip": (0.0, 0.0, 0.0), "knee": 10.0}), (4.2, {"hip": (110.0, 5.0, 0.0), "knee": 110.0}),
            (4.5, {"hip": (40.0, 5.0, 0.0), "knee": 50.0}), (5.2, {"hip": (0.0, 5.0, 0.0), "knee": 0.0, "shoulder": (160.0, 5.0, 0.0)})]  # fmt: skip
    rotations = joint_rotations(interpolate(keys, times), pelvis)
    direction = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    roots = np.concatenate([travel[:, None] * direction, height[:, None]], axis=1)
    frames = Frames.place(body_tree(measurements), roots, rotations)
    ends = frames.joints_m[:, [6, 9, 12, 15], 2]
    contact = ends < 0.2
    quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(-1, 16, 4)
    return MotionClip.from_samples(FRAMES, times, roots, quaternions, contact)
