"""The crew beside the cameras: measure the athlete with a tape, pose keyframes by hand, walk about the hall."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.ranges import Degrees, Metres, Range
from pzcap.types import HINGE_AXES, MEASUREMENTS, SEGMENTS, Pose, Subject
from sim.motion import MotionClip


@dataclass(frozen=True, slots=True)
class CrewConfig:
    """Errors of the crew's measurements and keyframes, and discipline during the sweep."""

    tape_sigma_m: Metres = 0.005
    """Standard deviation of a reading of the tape, m: repeated readings of a girth differ by as much."""
    keyframes: Literal["hand", "none"] = "hand"
    """Who poses keyframes. hand: a person, to the images; none: nobody, and the capture holds none."""
    keyframes_per_s: Annotated[float, Range(0.0, 240.0)] = 1.0
    """Keyframes posed by hand for each second of the motion, the first and the last frame included."""
    keyframe_position_m: Metres = 0.00577
    """Standard deviation of a keyframe's root position along each axis, m: 10 mm in all."""
    keyframe_rotation_deg: Degrees = 3.0
    """Standard deviation of a keyframe's joint rotations, degrees, about a random axis (a hinge: about its own)."""
    walks_in_sweep: bool = False
    """A person walks to and fro in the hall while the cameras sweep it. Off: docs/capture.md asks for an empty hall."""


def measure(measurements: dict[str, float], config: CrewConfig, rng: np.random.Generator) -> Subject:
    """Read the tape, to the millimetre."""
    errors = rng.normal(size=len(MEASUREMENTS)) * config.tape_sigma_m
    read = {
        name: round(max(measurements[name] + error, 0.005), 3)
        for name, error in zip(MEASUREMENTS, errors.tolist(), strict=True)
    }
    return Subject(read, max(config.tape_sigma_m, 0.0005))


def keyframe_indices(frames: int, frame_rate: float, config: CrewConfig) -> list[int]:
    """Keyframes evenly spaced from the first frame to the last, at the rate asked for but never fewer than two; none
    where nobody poses any."""
    if config.keyframes == "none":
        return []
    count = min(max(2, round((frames - 1) / frame_rate * config.keyframes_per_s)), frames)
    return [int(i) for i in np.rint(np.linspace(0, frames - 1, count))]


def pose_by_hand(pose: Pose, config: CrewConfig, rng: np.random.Generator) -> Pose:
    """A pose as a person fits it: the true one with the errors of ``config``."""
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


def to_and_fro(clip: MotionClip, rng: np.random.Generator) -> Callable[[float], Pose]:
    """Poses over time of a person who walks the way of ``clip`` there and back across the middle of the hall."""
    ends = np.array([clip.at(t).root_position_m for t in (0.0, clip.duration_s)])
    middle = np.array([*ends[:, :2].mean(axis=0), 0.0])
    spot = np.array([*rng.uniform(-1.5, 1.5, 2), 0.0])
    heading = rng.uniform(0, 2 * np.pi)

    def at(time_s: float) -> Pose:
        way, at_s = divmod(time_s, clip.duration_s)
        pose, turn = clip.at(at_s), Rotation.from_euler("z", heading + np.pi * (way % 2))
        pelvis = turn * Rotation.from_quat(pose.rotations[0], scalar_first=True)
        rotations = np.vstack([pelvis.as_quat(scalar_first=True), pose.rotations[1:]])
        return Pose(spot + turn.apply(pose.root_position_m - middle), rotations)

    return at
