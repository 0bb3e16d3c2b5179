"""Other people in the hall while the motion is filmed: walkers dressed like the athlete, a coach, a spotter.

Their ways are laid out by the athlete's, so that they are in the way wherever that leads. All of them walk with the
legs of the pedestrian; a coach keeps beside the athlete, and a spotter comes up and has both hands on the hips for a
second.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, SEGMENTS, Array, Pose
from sim.motion import MotionClip
from sim.people.anthropometry import body_tree

Company = Literal["none", "bystanders", "coach", "spotter"]

_REACH_M: Final = 0.58
"""Distance of a spotter whose hands are on the athlete, to the side of where the athlete goes."""
_TOUCH_S: Final = 1.0
_COMES_S: Final = 0.4  # it takes to come up, and to leave
_FOLLOWS_S: Final = 0.5  # somebody who keeps beside the athlete follows so much of the way, before and after
_BESIDE_M: Final = (3.0, 4.5)
"""How far walkers pass before and behind the athlete, seen from the first two cameras."""

Walker = Callable[[float], Pose]


@dataclass(frozen=True, slots=True, eq=False)
class Companion:
    """Another person."""

    name: str  # before the names of the bodies
    measurements: dict[str, float]
    at: Walker


def walkers(
    clip: MotionClip, people: Sequence[tuple[dict[str, float], MotionClip]], cameras_m: Array, end_s: float
) -> list[Companion]:
    """Two who walk across, one between the athlete and the first camera, one behind as the second sees it.

    ``people``: the measurements of each and how they walk; ``cameras_m`` (C, 3).
    """
    middle = np.mean([clip.at(t).root_position_m for t in np.linspace(0.0, end_s, 9)], axis=0)
    found = []
    for k, ((measurements, walk), away_m) in enumerate(zip(people, (_BESIDE_M[0], -_BESIDE_M[1]), strict=True)):
        towards = cameras_m[k, :2] - middle[:2]
        towards /= np.linalg.norm(towards)
        spot = middle[:2] + away_m * towards
        across = np.arctan2(towards[0], -towards[1]) + np.pi * k
        found.append(Companion(f"walker{k}_", measurements, _through(walk, spot, across, end_s)))
    return found


def _through(walk: MotionClip, spot: Array, heading: float, end_s: float) -> Walker:
    """Walks through ``spot`` (2,) at half of ``end_s``, towards ``heading``."""
    start_s = max(0.0, (walk.duration_s - end_s) / 2)
    first, middle, last = (walk.at(start_s + share * end_s).root_position_m for share in (0.0, 0.5, 1.0))
    way = last - first
    turn = Rotation.from_euler("z", heading - float(np.arctan2(way[1], way[0])))

    def at(time_s: float) -> Pose:
        pose = walk.at(start_s + time_s)
        place = turn.apply(pose.root_position_m - np.r_[middle[:2], 0.0]) + np.r_[spot, 0.0]
        return Pose(place, _turned(pose.rotations, turn))

    return at


def _turned(rotations: Array, turn: Rotation) -> Array:
    pelvis = turn * Rotation.from_quat(rotations[0], scalar_first=True)
    return np.vstack([pelvis.as_quat(scalar_first=True), rotations[1:]])


def coach(
    clip: MotionClip, measurements: dict[str, float], walk: MotionClip, end_s: float, apart_m: float, touches: bool
) -> Companion:
    """Somebody who goes along ``apart_m`` beside the athlete, and as a spotter (``touches``) lays hands on the hips for
    a second in the middle of the time."""
    times = np.linspace(0.0, end_s, 61)
    way = np.array([clip.at(t).root_position_m[:2] for t in times])
    width = max(1, round(_FOLLOWS_S / max(times[1], 1e-6)))
    padded = np.pad(way, ((width, width), (0, 0)), mode="edge")
    smooth = np.stack([np.convolve(padded[:, k], np.ones(2 * width + 1) / (2 * width + 1), "valid") for k in (0, 1)], 1)
    along = way[-1] - way[0]
    along = along / np.linalg.norm(along) if np.linalg.norm(along) > 0.3 else np.array([1.0, 0.0])
    aside = np.array([-along[1], along[0]])
    begins_s = 0.5 * (end_s - _TOUCH_S)
    arms = _Arms(measurements)

    def at(time_s: float) -> Pose:
        athlete = clip.at(time_s)
        closeness = _closeness(time_s, begins_s) if touches else 0.0
        beside = np.array([np.interp(time_s, times, smooth[:, k]) for k in (0, 1)])
        # whoever touches is where the athlete is, not where the way leads
        beside += closeness * (athlete.root_position_m[:2] - beside)
        place = beside + (apart_m + closeness * (_REACH_M - apart_m)) * aside
        legs = walk.at((0.3 * walk.duration_s + time_s) % walk.duration_s)
        facing = Rotation.from_euler("z", float(np.arctan2(-aside[1], -aside[0])))
        heading = Rotation.from_quat(legs.rotations[0], scalar_first=True).as_euler("ZYX")
        pelvis = facing * Rotation.from_euler("ZYX", [0.0, *heading[1:]])
        rotations = np.vstack([pelvis.as_quat(scalar_first=True), legs.rotations[1:]])
        pose = Pose(np.array([*place, legs.root_position_m[2]]), rotations)
        if closeness == 0.0:
            return pose
        hips = [athlete.root_position_m + np.r_[0.13 * aside + side * 0.12 * along, 0.05] for side in (1.0, -1.0)]
        return arms.reaching(pose, hips, closeness)

    return Companion("coach_", measurements, at)


def _closeness(time_s: float, begins_s: float) -> float:
    """0 where the spotter is away, 1 where hands touch, smooth between."""
    outside = max(begins_s - time_s, time_s - begins_s - _TOUCH_S, 0.0)
    share = float(np.clip(1.0 - outside / _COMES_S, 0.0, 1.0))
    return share * share * (3.0 - 2.0 * share)


class _Arms:
    """Arms of a person, bent so that the hands are where they are to be."""

    def __init__(self, measurements: dict[str, float]) -> None:
        self._offsets = body_tree(measurements).offsets_m
        self._lengths = measurements["upper_arm"], measurements["forearm"] + 0.5 * measurements["hand"]

    def reaching(self, pose: Pose, targets: Sequence[Array], share: float) -> Pose:
        """The ``pose`` with a hand at each of ``targets`` (3,), the left one at the nearer, ``share`` of the way
        there."""
        rotations, upper, lower = pose.rotations.copy(), *self._lengths
        turn = Rotation.identity()
        place = pose.root_position_m.copy()
        for name in ("pelvis", "lumbar", "thorax"):
            s = SEGMENTS.index(name)
            place = place + turn.apply(self._offsets[s])
            turn = turn * Rotation.from_quat(rotations[s], scalar_first=True)
        shoulders = [place + turn.apply(self._offsets[SEGMENTS.index(f"{side}_upper_arm")]) for side in _SIDES]
        if np.linalg.norm(shoulders[0] - targets[0]) > np.linalg.norm(shoulders[0] - targets[1]):
            targets = targets[::-1]
        for side, shoulder, target in zip(_SIDES, shoulders, targets, strict=True):
            far = turn.inv().apply(target - shoulder)
            reach = min(float(np.linalg.norm(far)), 0.98 * (upper + lower))
            bend = float(np.arccos(np.clip((reach**2 - upper**2 - lower**2) / (2 * upper * lower), -1.0, 1.0)))
            elbow = Rotation.from_rotvec(bend * np.array(HINGE_AXES[f"{side}_forearm"]))
            hand = np.array([0.0, 0.0, -upper]) + elbow.apply([0.0, 0.0, -lower])
            align, _ = Rotation.align_vectors(far[None], hand[None])
            for name, wanted in ((f"{side}_upper_arm", align), (f"{side}_forearm", elbow)):
                s = SEGMENTS.index(name)
                now = Rotation.from_quat(rotations[s], scalar_first=True)
                step = Rotation.from_rotvec(share * (now.inv() * wanted).as_rotvec())
                rotations[s] = (now * step).as_quat(scalar_first=True)
        return Pose(pose.root_position_m, rotations)


_SIDES: Final = ("left", "right")
