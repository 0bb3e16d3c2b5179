"""The crew beside the cameras: measure the athlete with a tape, pose keyframes by hand, walk about the hall."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, MEASUREMENTS, SEGMENTS, Garment, Pose, Subject
from sim.motion import MotionClip
from sim.people.company import Company
from sim.ranges import Degrees, Metres, Range, Share


@dataclass(frozen=True, slots=True)
class CrewConfig:
    """Errors of the crew's measurements and keyframes, and discipline during the sweep."""

    tape_sigma_m: Metres = 0.005
    """Standard deviation of a reading of the tape, m: repeated readings of a girth differ by as much."""
    tape: Literal["full", "stature", "none"] = "full"
    """What is measured with it. full: all that subject.json has a name for; stature: nothing else; none: nothing."""
    calibration_object: bool = True
    """Film a calibration object at the reference pose. Off: the crew has none, and no reference image either."""
    tape_guess: Share = 0.0
    """Relative standard deviation of each length where it is guessed by eye and from tables in place of a tape, and
    subject.json says so; of girths a quarter more. 0: all is measured."""
    tape_scale: Annotated[float, Range(0.5, 2.0)] = 1.0
    """What the tape reads of a metre, unknown to the crew: 0.91 where another's measurements were taken, of somebody a
    tenth smaller."""
    lengths: Literal["none", "carpet"] = "none"
    """Distances in the hall that the crew measures and marks in the pictures. carpet: the four sides of the carpet, its
    corners marked in the sweep of each camera that shows them."""
    length_sigma_m: Metres = 0.005
    """Standard deviation of such a distance, m."""
    click_px: Annotated[float, Range(0.0, 20.0)] = 0.7
    """Standard deviation of a mark in a picture, pixels each way."""
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
    sync: Literal["timecode", "sound", "flash", "none"] = "timecode"
    """What tells how the cameras' recordings of the motion lie to each other: timecode; or the videos have none, and
    there is sound, with three claps in the middle of the hall; a flash, by a lamp that is lit for a quarter of a
    second; or none, the motion alone. Without timecode, that of the papers counts from the first camera's first
    picture."""
    company: Company = "none"
    """Others in the hall during the motion, dressed like the athlete. bystanders: two who walk by, before and behind;
    coach: one who keeps beside; spotter: one who comes up and has both hands on the athlete for a second."""
    coach_m: Annotated[float, Range(0.3, 10.0)] = 1.2
    """Distance that a coach, or a spotter before coming up, keeps to the side of the athlete's way, m."""


def measure(
    measurements: dict[str, float], config: CrewConfig, rng: np.random.Generator, loose_m: Mapping[Garment, float]
) -> Subject:
    """Read the tape, or guess, to the millimetre; and see how loose the clothes are, ``loose_m``, to the centimetre."""
    tape_m = max(config.tape_sigma_m, 0.0005)
    true = {name: config.tape_scale * measurements[name] for name in MEASUREMENTS}
    girths = {name: 1.25 if name.startswith("girth_") else 1.0 for name in MEASUREMENTS}
    sigmas = {name: max(girths[name] * config.tape_guess * true[name], tape_m) for name in MEASUREMENTS}
    scatter = sigmas if config.tape_guess else dict.fromkeys(MEASUREMENTS, config.tape_sigma_m)
    errors = dict(zip(MEASUREMENTS, rng.normal(size=len(MEASUREMENTS)).tolist(), strict=True))
    taken = {"full": MEASUREMENTS, "stature": ("stature",), "none": ()}[config.tape]
    read = {name: round(max(true[name] + scatter[name] * errors[name], 0.005), 3) for name in taken}
    return Subject(
        read, tape_m, {name: round(sigmas[name], 4) for name in taken} if config.tape_guess else {},
        loose_m={name: round(room, 2) for name, room in loose_m.items()},
    )  # fmt: skip


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
