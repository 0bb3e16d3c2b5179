"""A pedestrian: walks on an arc that starts close to camera 3 and ends close to camera 2 (fig. 11 of the paper).

Joint angles over a gait cycle follow the curves of natural walking in D. A. Winter, *Biomechanics and Motor Control
of Human Movement*, ch. 2; the swing of the arms and the turn of the shoulders against the pelvis are set by eye.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from pzcap.types import Array
from sim.motion._authoring import joint_rotations
from sim.motion._clip import FRAME_RATE, MotionClip
from sim.motion._fit import Contact, fit, knots

FRAMES: Final = 150
_START_M: Final = np.array([8.2, 3.9])
_END_M: Final = np.array([8.2, -3.7])
_BULGE_M: Final = 1.0  # of the arc towards the middle of the hall

# Percent of the cycle, from heel strike to heel strike of the same foot -> degrees.
_CYCLE: Final[dict[str, list[tuple[float, float]]]] = {
    "hip": [(0, 29), (10, 25), (30, 6), (50, -12), (60, -6), (73, 17), (85, 30), (93, 31)],
    "knee": [(0, 4), (14, 19), (27, 11), (40, 5), (50, 13), (60, 38), (71, 62), (85, 28), (95, 4)],
    "ankle": [(0, -2), (7, 6), (20, -3), (42, -10), (52, -2), (62, 19), (75, 2), (87, -2)],
    "shoulder": [(0, -26), (50, 20)],
    "elbow": [(0, 16), (50, 38)],
}
_HEEL_DOWN: Final = (0.0, 0.40)
_TOE_DOWN: Final = (0.10, 0.60)


def _curve(name: str, phase: Array) -> Array:
    keys = np.array(_CYCLE[name])
    at, degrees = np.append(keys[:, 0], 100) / 100, np.append(keys[:, 1], keys[0, 1])
    return CubicSpline(at, degrees, bc_type="periodic")(phase % 1.0)


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Walk once along the arc at constant speed; start, end and the phase of the first step vary with ``rng``."""
    return walk(measurements, rng, _START_M, _END_M, _BULGE_M)


def walk(
    measurements: dict[str, float], rng: np.random.Generator, start_m: Array, end_m: Array, bulge_m: float
) -> MotionClip:
    """Walk from ``start_m`` to ``end_m`` (2,), about, on an arc that bulges ``bulge_m``, about, to the right."""
    times = knots(FRAMES)
    duration = (FRAMES - 1) / FRAME_RATE
    start, end = start_m + rng.normal(0.0, 0.1, 2), end_m + rng.normal(0.0, 0.1, 2)
    path, heading = _arc(start, end, bulge_m * float(rng.uniform(0.8, 1.2)), times / duration)
    speed = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) / duration
    # Stride length and cadence rise together with speed: a walk ratio of 0.42 m per step/s at leg length 0.9 m.
    leg = measurements["thigh"] + measurements["shank"] + measurements["ankle_height"]
    cadence = np.sqrt(speed / (0.42 * leg / 0.9))
    phase = cadence / 2.0 * times + float(rng.uniform())
    wave = 2 * np.pi * phase
    zero = np.zeros_like(times)
    # The pelvis turns forward and drops on the side of the swinging leg; the shoulders turn against it.
    channels: dict[str, Array] = {
        "trunk": np.stack([zero + 4, 3 * np.sin(wave), -10 * np.cos(wave)], axis=1),
        "neck": np.stack([zero - 3, zero, 5 * np.cos(wave)], axis=1),
    }
    contacts = []
    for side, lag in (("left", 0.0), ("right", 0.5)):
        own = phase - lag
        channels[f"{side}_hip"] = np.stack([_curve("hip", own), zero + 2, zero - 5], axis=1)
        channels[f"{side}_shoulder"] = np.stack([_curve("shoulder", own), zero + 8, zero + 5], axis=1)
        channels[f"{side}_elbow"] = _curve("elbow", own)[:, None]
        channels[f"{side}_knee"] = _curve("knee", own)[:, None]
        channels[f"{side}_ankle"] = _curve("ankle", own)[:, None]
        channels[f"{side}_wrist"] = zero[:, None] + 10
        for step in range(int(np.floor(own[0])) - 1, int(np.ceil(own[-1])) + 1):
            for point, (down, up) in (("heel", _HEEL_DOWN), ("toe", _TOE_DOWN)):
                begin, finish = ((step + at - own[0]) * 2.0 / cadence for at in (down, up))
                contacts.append(Contact(f"{side}_{point}", begin, finish))
    turn = np.stack([np.degrees(heading) - 5 * np.cos(wave), zero, 3 * np.sin(wave)], axis=1)
    pelvis = Rotation.from_euler("ZYX", turn, degrees=True).as_matrix()
    height = leg * (0.975 + 0.015 * np.cos(2 * wave - 0.3 * 2 * np.pi))
    roots = np.concatenate([path, height[:, None]], axis=1)
    return fit(measurements, FRAMES, roots, joint_rotations(channels, pelvis), contacts, (0.05, 0.05, 0.05))


def _arc(start: Array, end: Array, bulge: float, fraction: Array) -> tuple[Array, Array]:
    """Return points (T, 2) along a circular arc and headings (T,); it bulges to the right of the chord."""
    chord = end - start
    length = float(np.linalg.norm(chord))
    along = chord / length
    right = np.array([along[1], -along[0]])
    half = 2 * np.arctan2(2 * bulge, length)
    radius = length / (2 * np.sin(half))
    angle = half * (2 * fraction - 1)
    centre = (start + end) / 2 - right * (radius - bulge)
    points = centre + radius * (np.sin(angle)[:, None] * along + np.cos(angle)[:, None] * right)
    tangent = np.cos(angle)[:, None] * along - np.sin(angle)[:, None] * right
    return points, np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
