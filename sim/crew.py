"""What people do by hand beside filming: measure the athlete with a tape, pose a figure at keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, MEASUREMENTS, SEGMENTS, Pose, Subject


@dataclass(frozen=True, slots=True)
class CrewConfig:
    """How well people measure and pose. Standard deviations."""

    tape_sigma_m: float = 0.005
    keyframes_per_s: float = 1.0
    keyframe_position_m: float = 0.00577  # along each axis; 10 mm in all
    keyframe_rotation_deg: float = 3.0  # of a joint; about a random axis, or about its own for a hinge


def measure(measurements: dict[str, float], config: CrewConfig, rng: np.random.Generator) -> Subject:
    """Read the tape, to the millimetre."""
    errors = rng.normal(size=len(MEASUREMENTS)) * config.tape_sigma_m
    read = {
        name: round(max(measurements[name] + error, 0.005), 3)
        for name, error in zip(MEASUREMENTS, errors.tolist(), strict=True)
    }
    return Subject(read, max(config.tape_sigma_m, 0.0005))


def keyframe_indices(frames: int, frame_rate: float, config: CrewConfig) -> list[int]:
    """Evenly spaced from the first frame to the last, at the rate asked for but never fewer than two."""
    count = min(max(2, round((frames - 1) / frame_rate * config.keyframes_per_s)), frames)
    return [int(i) for i in np.rint(np.linspace(0, frames - 1, count))]


def pose_by_hand(pose: Pose, config: CrewConfig, rng: np.random.Generator) -> Pose:
    """A pose as a person fits it: near the true one."""
    sigma = np.deg2rad(config.keyframe_rotation_deg)
    direction = rng.normal(size=(len(SEGMENTS), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for s, name in enumerate(SEGMENTS):
        if name in HINGE_AXES:
            direction[s] = HINGE_AXES[name]
    turn = Rotation.from_rotvec(direction * rng.normal(size=(len(SEGMENTS), 1)) * sigma)
    rotations = (Rotation.from_quat(pose.rotations, scalar_first=True) * turn).as_quat(scalar_first=True)
    position = pose.root_position_m + rng.normal(size=3) * config.keyframe_position_m
    return Pose(position, rotations)
