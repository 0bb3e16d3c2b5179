"""Limbs that neither pass has kept, found again by what they look like.

Between two keyframes a limb can be lost from both sides: held before the trunk it has no outline, and what it looks
like is forgotten while it is followed wrongly. Beside the keyframes it is known (`Follower.known`). So where it does
not look like itself, or lies on the hall, its postures in all these frames are chosen once more, together: those that
are worth most (`pzcap.tracking.appearance`) and lead on from one frame to the next (dynamic programming, Bellman,
1957), from coarse to fine. What it looks like is also learned from all other frames in which the passes agree: of two
that do not at least one is wrong, and nothing misleads as much as a limb that was learned elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.body.skeleton import difference, retract
from pzcap.limbs.search import LIMBS, POSTURES, turn_to
from pzcap.tracking.appearance import Glance, LimbAppearance, Postures
from pzcap.tracking.bidirectional_fusion import runs, taking
from pzcap.tracking.frame_tracker import BESIDE
from pzcap.tracking.observation import PlacedView
from pzcap.tracking.pose_objective import Appearance, PoseObjective
from pzcap.types import SEGMENTS, Mask, Pose

_AROUND: Final = 2  # frames on either side that a verdict takes in
_WITH_IT: Final = 6  # and that may be wrong with those that are
_ASTRAY: Final = 0.25  # of what a limb covers, all views together, is hall: where it should be less is
_TOO_LITTLE_M2: Final = 0.05  # to tell that by
_UNLIKE_M2: Final = 0.006  # what looks otherwise than it should, more than does not: less is an odd light
_SIZES_RAD: Final = (0.8, 0.4, 0.16, 0.06)  # by which postures differ, from coarse to fine
_FAR_RAD: Final = 0.3  # those that differ by more are judged from afar
LEAP_M: Final = 0.04
"""What a joint may well move by in a frame, besides what was expected."""
LEAP_M2: Final = 0.005
"""What that costs its limb of what it is worth; a leap costs as the square of its length."""
WORST_LEAP: Final = 10.0
"""Of such squares, the most that count: an arm that swings moves further than was expected, and is still worth most
where it is seen."""

_OF_LIMB: Final[Mask] = np.array([np.isin(np.arange(len(SEGMENTS)), limb) for limb in LIMBS])  # (4, 16)

Placed = Sequence[PlacedView | None]


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """What the passes from the keyframes leave behind."""

    poses: list[list[Pose]]  # of each pass
    disputed: Mask  # (T, 16) what they do not agree about
    doubtful: Mask  # (T, 16) what of that is at or beside a leap
    known: Sequence[Appearance]  # what the skin looks like in each view beside the keyframes


@dataclass(frozen=True, slots=True, eq=False)
class Again:
    """Some frames after a second look."""

    poses: list[Pose]
    lost: Mask  # (T, 16) what was found once more
    known: list[Appearance]  # what the skin looks like in each view, where nothing was lost


def reacquire(
    likeness: LimbAppearance, poses: Sequence[Pose], evidence: Sequence[PoseObjective], placed: Sequence[Placed],
    passes: Passes, before: Pose | None, after: Pose | None,
) -> Again | None:  # fmt: skip
    """Find the limbs once more that are doubtful, lie on the hall or do not look as they are known to, the body being
    where it was ``placed``, and ``before`` and ``after`` these frames where that is known. None if there are none."""
    disputed, doubted = (
        np.array([segments[:, list(limb)].any(axis=1) for limb in LIMBS]).T
        for segments in (passes.disputed, passes.doubtful)
    )
    doubted |= _astray(likeness, poses, evidence, placed)
    lost = doubted | _unlike(likeness, poses, evidence, placed, passes.known)
    if not lost.any():
        return None
    learned = _learn(passes.known, evidence, placed, _widened(lost) | disputed)
    lost = _widened(doubted | _unlike(likeness, poses, evidence, placed, learned))
    if not lost.any():
        return None
    candidates = list(zip(poses, *passes.poses, strict=True))
    return Again(_find(likeness, candidates, evidence, learned, lost, before, after), lost @ _OF_LIMB, learned)


def _widened(lost: Mask) -> Mask:
    """(T, 4) with the frames beside those in which a limb is ``lost``: where it goes astray, it looks right as yet."""
    return np.array([_window(lost, t, _WITH_IT).any(axis=0) for t in range(len(lost))])


def _unlike(
    likeness: LimbAppearance, poses: Sequence[Pose], evidence: Sequence[PoseObjective], placed: Sequence[Placed],
    known: Sequence[Appearance],
) -> Mask:  # fmt: skip
    """(T, 4) the limbs that do not look as they are ``known`` to, in most of five frames."""
    alike = np.array([
        likeness.of(pose, each, where, known) for pose, each, where in zip(poses, evidence, placed, strict=True)
    ])  # fmt: skip
    return np.array([np.median(_window(alike, t), axis=0) < -_UNLIKE_M2 for t in range(len(alike))])


def _astray(
    likeness: LimbAppearance, poses: Sequence[Pose], evidence: Sequence[PoseObjective], placed: Sequence[Placed]
) -> Mask:
    """(T, 4) the limbs that lie on the hall, in most of five frames."""
    area = np.array([
        likeness.support(pose, each, where) for pose, each, where in zip(poses, evidence, placed, strict=True)
    ])  # fmt: skip
    share = area[..., 1] / np.maximum(area.sum(axis=2), _TOO_LITTLE_M2)
    return np.array([np.median(_window(share, t), axis=0) > _ASTRAY for t in range(len(share))])


def _learn(
    known: Sequence[Appearance], evidence: Sequence[PoseObjective], placed: Sequence[Placed], lost: Mask
) -> list[Appearance]:
    """What the skin looks like, all frames heard in which a limb is not ``lost`` (T, 4)."""
    learned = [look.copy() for look in known]
    for count, (each, where, gone) in enumerate(zip(evidence, placed, lost, strict=True), start=BESIDE):
        each.learn(_without(each, where, [s for k in np.flatnonzero(gone) for s in LIMBS[k]]), learned, 1.0 / count)
    return learned


def _find(
    likeness: LimbAppearance, candidates: Sequence[Sequence[Pose]], evidence: Sequence[PoseObjective],
    learned: Sequence[Appearance], lost: Mask, before: Pose | None, after: Pose | None,
) -> list[Pose]:  # fmt: skip
    """The poses, of each frame's ``candidates`` the first, with the ``lost`` (T, 4) limbs found once more: about the
    way from the frame before to that after, or about the candidates."""
    poses = [pose for pose, *_ in candidates]
    found = list(poses)
    around = [before, *poses, after]
    for limb, segments in enumerate(LIMBS):
        for run in runs(lost[:, limb]):
            first, last = around[run.start], around[run.stop + 1]
            first, last = first or last or poses[run.start], last or first or poses[run.start]
            shares = (np.arange(len(run)) + 1.0) / (len(run) + 1.0)
            passing = [retract(first, share * difference(last, first)) for share in shares]
            starts = [taking(poses[t], segments, pose) for t, pose in zip(run, passing, strict=True)]
            glances = [likeness.glance(limb, pose, evidence[t], learned) for t, pose in zip(run, starts, strict=True)]
            for t, pose in zip(run, _way(likeness, limb, glances, [candidates[t] for t in run]), strict=True):
                found[t] = taking(found[t], segments, pose)
    return found


def _way(
    likeness: LimbAppearance, limb: int, glances: Sequence[Glance], candidates: Sequence[Sequence[Pose]]
) -> list[Pose]:
    """The postures of a limb in frames that follow each other which are together worth most.

    To those about the way so far come the limb as the ``candidates`` have it and, as it may have been lost in the
    middle of a run alone, as the frames beside it have it (Barnes et al., 2009).
    """
    way, others = [glance.pose for glance in glances], list(candidates)
    for size in _SIZES_RAD:
        postures = []
        for glance, pose, beside in zip(glances, way, others, strict=True):
            around = turn_to(limb, glance.pose, pose) + size * POSTURES
            turns = np.vstack([around, *(turn_to(limb, glance.pose, other) for other in beside)])
            postures.append(likeness.postures(limb, glance, turns, afar=size > _FAR_RAD))
        chosen = zip(glances, postures, best_way(postures), strict=True)
        way = [likeness.turned(limb, glance.pose, each.turns[k]) for glance, each, k in chosen]
        others = [[way[n] for n in (t - 2, t - 1, t + 1, t + 2) if 0 <= n < len(way)] for t in range(len(way))]
    return way


def best_way(postures: Sequence[Postures]) -> list[int]:
    """Which posture of each frame, so that the sum of what they are worth, less what leaps cost, is greatest."""
    total, origins = postures[0].worth_m2, []
    for one, other in pairwise(postures):
        leap = np.sum((other.moved_m[:, None] - one.moved_m) ** 2, axis=(2, 3)) / LEAP_M**2
        reached = total - LEAP_M2 * np.minimum(leap, WORST_LEAP)
        origins.append(np.argmax(reached, axis=1))
        total = reached.max(axis=1) + other.worth_m2
    way = [int(np.argmax(total))]
    for origin in reversed(origins):
        way.append(int(origin[way[-1]]))
    return way[::-1]


def _window(values: NDArray, t: int, around: int = _AROUND) -> NDArray:
    return values[max(t - around, 0) : t + around + 1]


def _without(evidence: PoseObjective, placed: Placed, segments: Sequence[int]) -> list[PlacedView | None]:
    """The views as if some segments were hidden."""
    hidden = np.isin(evidence.body.surface.segment, segments)
    return [
        None if where is None else replace(where, facing=np.where(hidden, np.float32(0.0), where.facing))
        for where in placed
    ]
