"""Two estimates of each instant, from the keyframe before it and from the one after it, made one: drift removed.

Where the two agree they are averaged limb by limb, weighted by confidence, which falls with the distance from the
keyframe (Yamamoto 2005). Where they do not, one of them has lost the limb. Which one is decided for all frames of the
interval together: the limb that explains more of the silhouettes and looks more like itself, and that leaps least on
its way from one keyframe to the other. In the same way it is decided whether a limb that was looked for once more
(`pzcap.tracking.reacquisition`) is taken from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pzcap.body.skeleton import Body, difference, forward, retract
from pzcap.limbs.search import LIMBS
from pzcap.tracking.frame_tracker import Step
from pzcap.types import PARENTS, Array, Mask, Pose

AGREE_M: Final = 0.05
_LEAP_M: Final = 0.04  # what a joint's motion may change by in a frame
_WORST_LEAP: Final = 10.0  # of the squares of that: a limb found again leaps once
_BESIDE: Final = 3  # frames around a leap that may be wrong with it
_NEARER: Final = 2.0  # what a pass is worth beside its own keyframe: where nothing tells, the leap is in the middle
_WORTH_M2: Final = 0.01  # of a limb that weighs as much as a leap
_APART_M: Final = 0.02  # where a limb was found again nearer than this, it was not lost


def merge(
    body: Body, before: Pose, ahead: Sequence[Step], back: Sequence[Step], after: Pose,
    worth: Callable[[int, Pose], Array],
) -> tuple[list[Pose], Array]:  # fmt: skip
    """The poses between two keyframes from the steps of both passes, in the order of the frames; and how far apart
    (T, 16), metres, the two have the joints of a limb that they disagree about, 0 where they agree.

    ``worth(frame, pose)`` is as `pzcap.tracking.appearance.Likeness.worth` has it.
    """
    share = np.array([a.variance / (a.variance + b.variance) for a, b in zip(ahead, back, strict=True)])  # of ``back``
    joints = np.array([
        [_joints(body, pose) for pose in (before, *(step.pose for step in steps), after)] for steps in (ahead, back)
    ])  # (2, T + 2, 16, 3)  # fmt: skip
    way = np.arange(1, len(ahead) + 1) / (len(ahead) + 1)
    nearer = _NEARER * np.stack([1.0 - way, way])
    apart = np.linalg.norm(joints[0, 1:-1] - joints[1, 1:-1], axis=-1)
    doubt = np.zeros(apart.shape)
    differ = np.array([apart[:, list(members)].max(axis=1) > AGREE_M for members in LIMBS])  # (4, T)
    limbs_worth = np.zeros((2, len(ahead), len(LIMBS)))
    for t in np.flatnonzero(differ.any(axis=0)).tolist():
        limbs_worth[:, t] = [worth(t, steps[t].pose) for steps in (ahead, back)]
    for (limb, members), disagree in zip(enumerate(LIMBS), differ, strict=True):
        share[:, list(members)] = share[:, list(members)].mean(axis=1, keepdims=True)
        doubt[:, list(members)] = np.where(disagree[:, None], apart[:, list(members)], 0.0)
        if not disagree.any():
            continue
        gain = limbs_worth[:, :, limb] / _WORTH_M2 + nearer
        choice = _smoothest(joints[:, :, list(members[1:])], gain)
        for frame in np.flatnonzero(disagree):
            share[frame, list(members)] = choice[frame]
    return [_blend(body, a.pose, b.pose, s) for a, b, s in zip(ahead, back, share, strict=True)], doubt


def choose(
    body: Body, before: Pose, one: Sequence[Pose], other: Sequence[Pose], where: Mask, gain: Array
) -> list[Pose]:
    """The poses of ``one``, but limbs as ``other`` has them, ``where`` (t, 16) that is allowed in the first frames and
    elsewhere, its ``gain`` there (t, 4), square metres, is worth it and it is no leap from the frames beside.

    ``before`` is the pose before the first.
    """
    joints = np.array([[_joints(body, pose) for pose in (before, *poses)] for poses in (one, other)])
    joints = np.append(joints, 2.0 * joints[:, -1:] - joints[:, -2:-1], axis=1)  # what goes on after the last
    elsewhere = where & (np.linalg.norm(joints[0] - joints[1], axis=2)[1 : len(where) + 1] > _APART_M)
    poses = list(one)
    for limb, members in enumerate(LIMBS):
        for run in runs(elsewhere[:, list(members)].any(axis=1)):
            worth = gain[run.start : run.stop, limb] / _WORTH_M2
            moving = joints[:, run.start : run.stop + 2, list(members[1:])]  # with the frames beside the run
            for t, choice in zip(run, _smoothest(moving, np.stack([np.zeros(len(run)), worth])), strict=True):
                if choice:
                    poses[t] = taking(poses[t], members, other[t])
    return poses


def taking(pose: Pose, segments: Sequence[int], other: Pose) -> Pose:
    """The ``pose`` with some segments turned as the ``other`` has them."""
    rotations = pose.rotations.copy()
    rotations[list(segments)] = other.rotations[list(segments)]
    return Pose(pose.root_position_m, rotations)


def runs(marked: Mask) -> list[range]:
    """The frames that follow each other without a gap among those that are ``marked`` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]])))
    return [range(first, stop) for first, stop in edges.reshape(-1, 2).tolist()]


def _joints(body: Body, pose: Pose) -> Array:
    return forward(body, pose)[:, :3, 3]


def _smoothest(joints_m: Array, gain: Array) -> NDArray[np.int64]:
    """Which of two candidates (T,) to take in each frame, so that the sum of ``gain`` (2, T), less the leaps of the
    joints (2, T + 2, J, 3), is greatest. The first and the last frame of the joints are known: both are alike."""
    count = gain.shape[1]
    total = np.zeros((2, 2))  # of the frame before the last, and of the last
    origin = np.zeros((count + 1, 2, 2), np.int64)
    for t in range(1, count + 2):
        now = np.empty((2, 2))
        own = gain[:, t - 1] if t <= count else np.zeros(2)
        for b in range(2):
            for c in range(2):
                scores = [total[a, b] - _leap(joints_m, t, a, b, c) for a in range(2)]
                origin[t - 1, b, c] = int(np.argmax(scores))
                now[b, c] = max(scores) + own[c]
        total = now
    last = divmod(int(np.argmax(total)), 2)
    path = [last[1], last[0]]
    for t in range(count + 1, 1, -1):
        path.append(int(origin[t - 1, path[-1], path[-2]]))
    return np.array(path[::-1][1:-1])


def _leap(joints_m: Array, t: int, a: int, b: int, c: int) -> float:
    """Cost of candidates ``a``, ``b`` and ``c`` in the frames up to ``t``."""
    if t < 2:
        return 0.0
    bend = joints_m[c, t] - 2.0 * joints_m[b, t - 1] + joints_m[a, t - 2]
    return float(np.minimum(np.sum(bend**2, axis=-1) / (2.0 * _LEAP_M**2), _WORST_LEAP).sum())


def _blend(body: Body, ahead: Pose, back: Pose, share: Array) -> Pose:
    """Each segment turned in the world by its ``share`` (16,) from ``ahead`` to ``back``, and the root moved.

    In the world, not against its parent: where one of the two has the pelvis turned, and the lumbar back by as much, a
    share of the one and another of the other would turn all that hangs on them.
    """
    one, other = (Rotation.from_matrix(forward(body, pose)[:, :3, :3]) for pose in (ahead, back))
    world = one * Rotation.from_rotvec(share[:, None] * (one.inv() * other).as_rotvec())
    local = Rotation.concatenate([world[:1], world[list(PARENTS[1:])].inv() * world[1:]])
    root = ahead.root_position_m + share[0] * (back.root_position_m - ahead.root_position_m)
    there = Pose(root, local.as_quat(scalar_first=True))
    return retract(ahead, difference(there, ahead))  # a hinge keeps to its axis


def leaping(body: Body, before: Pose, poses: Sequence[Pose], after: Pose, doubt_m: Array) -> Mask:
    """Segments (T, 16) that the passes disagree about (``doubt_m`` of `merge`) at or beside a leap of their limb."""
    joints = np.array([_joints(body, pose) for pose in (before, *poses, after)])
    bend = np.linalg.norm(joints[2:] - 2.0 * joints[1:-1] + joints[:-2], axis=-1)
    found = np.zeros(doubt_m.shape, bool)
    for members in LIMBS:
        rows = list(members)
        doubted = doubt_m[:, rows].max(axis=1) > 0.0
        leaps = np.flatnonzero(doubted & (bend[:, rows].max(axis=1) > 2.0 * _LEAP_M))
        for frame in leaps:
            beside = slice(max(frame - _BESIDE, 0), frame + _BESIDE + 1)
            found[beside, rows[0] : rows[-1] + 1] |= doubted[beside, None]
    return found
