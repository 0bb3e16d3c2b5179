"""Poses of a few frames that tracking starts from: how well they are known, and whether they can be."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.body.kinematics import forward, joint_jacobians, joints, limit_residuals
from pzcap.body.skeleton import DOF_SEGMENT, Body
from pzcap.tracking.tuning import HAND_SIGMA, KEYFRAME
from pzcap.types import HINGE_AXES, JOINTS, SEGMENTS, Array, Keyframe, Pose, PzcapError


def information(key: Keyframe) -> Array:
    """Information (43, 43) on the pose of a keyframe, beside the images."""
    if key.covariance is None:
        return np.diag(1.0 / HAND_SIGMA**2)
    return np.asarray(np.linalg.inv(key.covariance))


def joint_sigma_m(key: Keyframe, body: Body) -> float:
    """Standard deviation of a keyframe's joints along each axis, the mean of all."""
    if key.covariance is None:
        return float(HAND_SIGMA[0])
    jacobians = joint_jacobians(forward(body, key.pose))
    variance = np.einsum("jad,de,jae->j", jacobians, key.covariance, jacobians) / 3.0
    return float(np.sqrt(variance.mean()))


def check(
    keyframes: Sequence[Keyframe], body: Body, frame_count: int | None = None, frame_rate: float = 30.0
) -> tuple[str, ...]:
    """Check keyframes: what looks wrong with them, one line each; empty if nothing does.

    Raises PzcapError where nothing can be tracked from them: none at all, two of one frame, numbers that are no pose,
    none within the ``frame_count`` frame sets.
    """
    if not keyframes:
        raise PzcapError("keyframes: there are none; pose the body in at least one frame (keyframes.json)")
    frames = [key.frame for key in keyframes]
    if len(set(frames)) < len(frames):
        twice = next(f for f in frames if frames.count(f) > 1)
        raise PzcapError(f"keyframes: frame {twice} is posed twice; keep one of the two")
    notes: list[str] = []
    if frame_count is not None:
        outside = [f for f in frames if not 0 <= f < frame_count]
        if len(outside) == len(frames):
            raise PzcapError(
                f"keyframes: none lies within the {frame_count} frames that all cameras recorded; check their timecodes"
            )
        notes += [f"keyframe {f} lies outside the recording and is not used" for f in outside]
    for key in keyframes:
        _check_numbers(key)
        notes += [f"keyframe {key.frame}: {text}" for text in _check_pose(key.pose, body)]
    ordered = sorted(keyframes, key=lambda key: key.frame)
    for a, b in pairwise(ordered):
        moved = float(np.linalg.norm(b.pose.root_position_m - a.pose.root_position_m))
        if moved * frame_rate > KEYFRAME.fastest_m_s * (b.frame - a.frame):
            notes.append(
                f"keyframes {a.frame} and {b.frame}: the pelvis moves {moved:.1f} m in {b.frame - a.frame} frames, "
                "faster than anyone runs; check the timecodes"
            )
    return tuple(notes)


def _check_numbers(key: Keyframe) -> None:
    position, rotations = key.pose.root_position_m, key.pose.rotations
    if position.shape != (3,) or rotations.shape != (len(SEGMENTS), 4):
        raise PzcapError(f"keyframe {key.frame}: a pose has a root position (3) and {len(SEGMENTS)} quaternions (4)")
    if not (np.all(np.isfinite(position)) and np.all(np.isfinite(rotations))):
        raise PzcapError(f"keyframe {key.frame}: holds a number that is not finite; pose the frame again")
    lengths = np.linalg.norm(rotations, axis=1)
    if np.any(np.abs(lengths - 1.0) > 0.01):
        name = SEGMENTS[int(np.argmax(np.abs(lengths - 1.0)))]
        raise PzcapError(f"keyframe {key.frame}: the quaternion of {name} is not of unit length; write w, x, y, z")


def _check_pose(pose: Pose, body: Body) -> list[str]:
    notes = []
    vectors = Rotation.from_quat(pose.rotations, scalar_first=True).as_rotvec()
    for index, name in enumerate(SEGMENTS):
        if name in HINGE_AXES:
            axis = np.array(HINGE_AXES[name])
            beside = float(np.linalg.norm(vectors[index] - axis * (axis @ vectors[index])))
            if beside > KEYFRAME.hinge_rad:
                notes.append(f"{name} turns by {np.rad2deg(beside):.0f} degrees beside its hinge")
    excess, _ = limit_residuals(pose)
    for index in np.unique(DOF_SEGMENT[np.abs(excess) > KEYFRAME.limit_rad]):
        worst = np.rad2deg(np.abs(excess[index == DOF_SEGMENT]).max())
        notes.append(f"{SEGMENTS[index]} is {worst:.0f} degrees beyond what its joint can do")
    heights: Array = joints(body, pose)[:, 2]
    if heights.min() < -KEYFRAME.floor_m:
        notes.append(f"{JOINTS[int(heights.argmin())]} is {-heights.min():.2f} m below the floor")
    return notes
