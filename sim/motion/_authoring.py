"""Key poses as anatomical joint angles in degrees, interpolated smoothly over time.

Channels, each a triple or a single number (zero where it is not mentioned):
    trunk (forward, left, twist left), shared by lumbar and thorax; neck (forward, left, twist left);
    {left,right}_{shoulder,hip} (flexion, abduction, inward twist); _elbow, _knee (flexion); _wrist (towards the
    front of the forearm); _ankle (plantar flexion).
A channel ``shoulder`` stands for both sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from pzcap.types import SEGMENTS, Array

Keys = Mapping[str, float | tuple[float, float, float]]

_PAIRED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_JOINT_OF = {
    "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist", "thigh": "hip", "shank": "knee", "foot": "ankle",
}  # fmt: skip


def _euler(order: str, *angles: Array) -> Array:
    return Rotation.from_euler(order, np.stack(angles, axis=1), degrees=True).as_matrix()


def interpolate(keys: Sequence[tuple[float, Keys]], times_s: Array) -> dict[str, Array]:
    """Join the keys: channel -> (T, 3) or (T, 1) degrees; monotone between keys, so nothing overshoots."""
    collected: dict[str, list[tuple[float, tuple[float, ...]]]] = {}
    for time, values in keys:
        for name, value in values.items():
            triple = value if isinstance(value, tuple) else (float(value),)
            for channel in (f"left_{name}", f"right_{name}") if name in _PAIRED else (name,):
                collected.setdefault(channel, []).append((time, triple))
    out = {}
    for channel, entries in collected.items():
        entries.sort(key=lambda entry: entry[0])
        at, values_of = np.array([e[0] for e in entries]), np.array([e[1] for e in entries])
        if len(at) == 1:
            out[channel] = np.repeat(values_of, len(times_s), axis=0)
        else:
            out[channel] = PchipInterpolator(at, values_of)(np.clip(times_s, at[0], at[-1]))
    return out


def curve(keys: Sequence[tuple[float, float]], times_s: Array) -> Array:
    """Join (time, value) keys: (T,); monotone between them, and constant before the first and after the last."""
    at, values = np.array(keys, dtype=float).T
    return np.asarray(PchipInterpolator(at, values)(np.clip(times_s, at[0], at[-1])))


def joint_rotations(channels: Mapping[str, Array], pelvis: Array) -> Array:
    """Return rotations (T, 16, 3, 3), parent from segment, of channels and the pelvis's own (T, 3, 3)."""
    count = len(pelvis)
    out = np.tile(np.eye(3), (count, 16, 1, 1))
    out[:, 0] = pelvis
    zero = np.zeros((count, 3))
    trunk, neck = channels.get("trunk", zero) / 2, channels.get("neck", zero)
    for name, angles in (("lumbar", trunk), ("thorax", trunk), ("head", neck)):
        out[:, SEGMENTS.index(name)] = _euler("YXZ", angles[:, 0], -angles[:, 1], angles[:, 2])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for kind, joint in _JOINT_OF.items():
            channel = f"{side}_{joint}"
            if channel not in channels:
                continue
            angles = channels[channel]
            if joint in ("shoulder", "hip"):
                rotation = _euler("YXZ", -angles[:, 0], sign * angles[:, 1], -sign * angles[:, 2])
            else:
                rotation = _euler("Y", angles[:, 0] * (-1.0 if joint in ("elbow", "wrist") else 1.0))
            out[:, SEGMENTS.index(f"{side}_{kind}")] = rotation
    return out
