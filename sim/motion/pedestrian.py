"""A pedestrian: walks on an arc that starts close to camera 3 and ends close to camera 2 (fig. 11 of the paper)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import Array
from sim.anthropometry import body_tree
from sim.motion._authoring import joint_rotations
from sim.motion._clip import MotionClip
from sim.motion._kinematics import Frames

FRAMES = 150


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Walk from near (7.5, 6) to near (7.5, -5) with the middle of the hall to the right."""
    times = np.arange(0.0, (FRAMES - 1) / 30 + 1e-9, 1 / 60)
    start, end = np.array([7.6, 5.0]) + rng.normal(0, 0.1, 2), np.array([7.6, -3.2]) + rng.normal(0, 0.1, 2)
    s = times / times[-1]
    bulge = 1.2 * np.sin(np.pi * s)
    xy = start + s[:, None] * (end - start) - np.stack([bulge, 0 * bulge], axis=1)
    velocity = np.gradient(xy, times, axis=0)
    heading = np.degrees(np.arctan2(velocity[:, 1], velocity[:, 0]))
    phase = 2 * np.pi * 0.93 * times
    channels: dict[str, Array] = {"trunk": np.stack([0 * s + 3, 0 * s, 4 * np.sin(phase)], axis=1)}
    for side, p in (("left", phase), ("right", phase + np.pi)):
        channels[f"{side}_hip"] = np.stack([8 + 24 * np.cos(p), 0 * s, 0 * s], axis=1)
        channels[f"{side}_knee"] = (8 + 50 * np.clip(-np.sin(p), 0, 1) ** 2)[:, None]
        channels[f"{side}_shoulder"] = np.stack([-22 * np.cos(p), 0 * s + 6, 0 * s], axis=1)
        channels[f"{side}_elbow"] = (25 - 10 * np.cos(p))[:, None]
    rotations = joint_rotations(channels, Rotation.from_euler("Z", heading[:, None], degrees=True).as_matrix())
    tree = body_tree(measurements)
    frames = Frames.place(tree, np.concatenate([xy, 0 * s[:, None]], axis=1), rotations)
    soles = frames.joints_m[:, [12, 15], 2] - measurements["ankle_height"]
    roots = np.concatenate([xy, -soles.min(axis=1, keepdims=True)], axis=1)
    contact = np.zeros((len(times), 4), dtype=bool)
    contact[:, 2:] = soles < soles.min(axis=1, keepdims=True) + 0.01
    quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(-1, 16, 4)
    return MotionClip.from_samples(FRAMES, times, roots, quaternions, contact)
