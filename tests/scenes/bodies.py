"""A subject as a tape measures it, the body built of it, and any pose of it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.body import skeleton as bodies
from pzcap.types import HINGE_AXES, SEGMENTS, Pose, Subject
from sim.people.anthropometry import draw_measurements


def subject(seed: int = 0) -> Subject:
    """A subject drawn from the tables of the simulator."""
    rng = np.random.default_rng(seed)
    return Subject(draw_measurements(rng), 0.005)


def random_pose(seed: int, size: float = 1.0) -> Pose:
    """Any pose; rotations of ``size`` rad, hinges bent by up to 2 rad."""
    rng = np.random.default_rng(seed)
    vectors = rng.normal(0, size, (len(SEGMENTS), 3))
    for i, name in enumerate(SEGMENTS):
        if name in HINGE_AXES:
            vectors[i] = rng.uniform(0, 2) * np.array(HINGE_AXES[name])
    return Pose(rng.normal(0, 2, 3), Rotation.from_rotvec(vectors).as_quat(scalar_first=True))


BODY = bodies.build(subject())
