"""Fusion of the forward and the backward pass between two keyframes: drift removed.

Where the two agree they are averaged limb by limb, weighted by confidence, which falls with the distance from the
keyframe (Yamamoto 2005). Where they do not, one of them has lost the limb. Which one is decided for all frames of the
interval together (Viterbi): the limb that explains more of the silhouettes and looks more like itself, and that leaps
least on its way from one keyframe to the other. In the same way it is decided whether a limb is taken as reacquired
(`pzcap.tracking.reacquisition`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from pzcap.body.kinematics import difference, forward, joints, retract
from pzcap.body.skeleton import LIMBS, Body
from pzcap.solver.viterbi import best_path
from pzcap.tracking.frame_tracker import FrameEstimate
from pzcap.tracking.tuning import FUSION
from pzcap.types import PARENTS, Array, Indices, Mask, Pose


class Fused(NamedTuple):
    """The frames between two keyframes after both passes."""

    poses: list[Pose]
    apart_m: Array  # (T, 16) distance of the two's joints in limbs that they disagree about, 0 where they agree
    doubt_m: Array  # (T, 16) standard deviation of the joints for that: root mean square distance from where they are


def fuse(
    body: Body, before: Pose, ahead: Sequence[FrameEstimate], back: Sequence[FrameEstimate], after: Pose,
    score: Callable[[int, int], Array],
) -> Fused:  # fmt: skip
    """The poses between two keyframes from the estimates of both passes, in the order of the frames.

    ``score(k, t)``, of the estimates of the first pass (0) or the second, is as
    `pzcap.tracking.appearance.LimbAppearance.score` has it. The odds that the pass was right which was not chosen are
    those of the scores.
    """
    share = np.array([a.variance / (a.variance + b.variance) for a, b in zip(ahead, back, strict=True)])  # of ``back``
    positions = np.array([
        [joints(body, pose) for pose in (before, *(each.pose for each in steps), after)] for steps in (ahead, back)
    ])  # (2, T + 2, 16, 3)  # fmt: skip
    way = np.arange(1, len(ahead) + 1) / (len(ahead) + 1)
    nearer = FUSION.own_keyframe * np.stack([1.0 - way, way])
    apart = np.linalg.norm(positions[0, 1:-1] - positions[1, 1:-1], axis=-1)
    disputed, doubt = np.zeros(apart.shape), np.zeros(apart.shape)
    differ = np.array([apart[:, list(members)].max(axis=1) > FUSION.agree_m for members in LIMBS])  # (4, T)
    scores = np.zeros((2, len(ahead), len(LIMBS)))
    for t in np.flatnonzero(differ.any(axis=0)).tolist():
        scores[:, t] = [score(k, t) for k in (0, 1)]
    for limb, members in enumerate(LIMBS):
        rows = list(members)
        share[:, rows] = share[:, rows].mean(axis=1, keepdims=True)
        disputed[:, rows] = np.where(differ[limb, :, None], apart[:, rows], 0.0)
        if differ[limb].any():
            choice = _smoothest(positions[:, :, rows[1:]], scores[:, :, limb] / FUSION.leap_m2 + nearer)
            share[np.ix_(differ[limb], rows)] = choice[differ[limb], None]
            lead = np.where(choice == 1, 1.0, -1.0) * (scores[1, :, limb] - scores[0, :, limb])
            doubt[:, rows] = np.sqrt(expit(-lead / FUSION.odds_m2))[:, None] * disputed[:, rows]
    poses = [_blend(body, a.pose, b.pose, s) for a, b, s in zip(ahead, back, share, strict=True)]
    return Fused(poses, disputed, doubt)


def choose(
    body: Body, before: Pose, one: Sequence[Pose], other: Sequence[Pose], least_m: Array, gain: Array
) -> list[Pose]:
    """The poses of ``one``, but limbs as ``other`` has them where, in the first frames, the two differ by ``least_m``
    (t, 16), the ``gain`` (t, 4), square metres, is worth it and it is no leap from the frames beside.

    ``before`` is the pose before the first.
    """
    positions = np.array([[joints(body, pose) for pose in (before, *poses)] for poses in (one, other)])
    positions = np.append(positions, 2.0 * positions[:, -1:] - positions[:, -2:-1], axis=1)  # extrapolated by a frame
    apart = np.linalg.norm(positions[0] - positions[1], axis=2)[1 : len(least_m) + 1]
    differ, poses = apart > least_m, list(one)
    for limb, members in enumerate(LIMBS):
        for run in runs(differ[:, list(members)].any(axis=1)):
            gains = np.stack([np.zeros(len(run)), gain[run.start : run.stop, limb] / FUSION.leap_m2])
            moving = positions[:, run.start : run.stop + 2, list(members[1:])]  # with the frames beside the run
            for t in (np.flatnonzero(_smoothest(moving, gains)) + run.start).tolist():
                poses[t] = with_segments(poses[t], members, other[t])
    return poses


def with_segments(pose: Pose, segments: Sequence[int], other: Pose) -> Pose:
    """The ``pose`` with some segments turned as the ``other`` has them."""
    rotations = pose.rotations.copy()
    rotations[list(segments)] = other.rotations[list(segments)]
    return Pose(pose.root_position_m, rotations)


def runs(marked: Mask) -> list[range]:
    """Intervals of consecutive frames among those that are ``marked`` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]])))
    return [range(first, stop) for first, stop in edges.reshape(-1, 2).tolist()]


def _smoothest(joints_m: Array, gain: Array) -> Indices:
    """The candidate, 0 or 1, to take in each frame (T,), so that the sum of ``gain`` (2, T), less the leaps of the
    joints (2, T + 2, J, 3), is greatest. In the first and the last frame of the joints both are alike.

    A leap is judged by three frames, so that a state of the chain is the pair of candidates in two.
    """
    count = gain.shape[1]
    before, here, after = joints_m[:, None, None, :-2], joints_m[:, None, 1:-1], joints_m[:, 2:]
    bend = after - 2.0 * here + before  # (2, 2, 2, T, J, 3) of the candidates in three consecutive frames
    leap = np.minimum(np.sum(bend**2, axis=-1) / (2.0 * FUSION.leap_m**2), FUSION.worst_leap).sum(axis=-1)
    transitions = np.full((count, 4, 4), -np.inf)
    for a, b, c in np.ndindex(2, 2, 2):
        transitions[:, 2 * b + c, 2 * a + b] = -leap[a, b, c]
    scores = [*(np.tile(each, 2) for each in gain.T), np.zeros(4)]
    return np.array(best_path(scores, transitions)[:-1]) % 2


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


def discontinuous(body: Body, before: Pose, poses: Sequence[Pose], after: Pose, apart_m: Array) -> Mask:
    """Segments (T, 16) that the passes disagree about (``apart_m`` of `Fused`) at or beside a leap of their
    limb."""
    positions = np.array([joints(body, pose) for pose in (before, *poses, after)])
    bend = np.linalg.norm(positions[2:] - 2.0 * positions[1:-1] + positions[:-2], axis=-1)
    found = np.zeros(apart_m.shape, bool)
    for members in LIMBS:
        rows = list(members)
        disputed = apart_m[:, rows].max(axis=1) > 0.0
        for frame in np.flatnonzero(disputed & (bend[:, rows].max(axis=1) > 2.0 * FUSION.leap_m)):
            beside = slice(max(frame - FUSION.beside_leap, 0), frame + FUSION.beside_leap + 1)
            found[beside, rows[0] : rows[-1] + 1] |= disputed[beside, None]
    return found
