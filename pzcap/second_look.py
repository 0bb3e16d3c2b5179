"""Limbs that neither pass has kept, found again by what they look like.

Between two keyframes a limb can be lost from both sides: held before the trunk it has no outline, and what it looks
like is forgotten while it is followed wrongly. Beside the keyframes it is known (`Follower.known`), and from there it
is followed once more, inward from both ends of the frames in which it does not look like itself, each time searched for
near where it was in the frame before (`Likeness.search`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.evidence import Appearance, Evidence
from pzcap.following import BESIDE
from pzcap.likeness import Likeness
from pzcap.limbs import LIMBS
from pzcap.types import SEGMENTS, Mask, Pose
from pzcap.views import PlacedView

_AROUND: Final = 2  # frames on either side that a verdict takes in, and that may be wrong with those that are
_UNLIKE_M2: Final = 0.006  # what looks otherwise than it should, more than does not: less is an odd light
_ADAPT: Final = 0.15  # share that a frame has in what a limb that was found again looks like

_OF_LIMB: Final[Mask] = np.array([np.isin(np.arange(len(SEGMENTS)), limb) for limb in LIMBS])  # (4, 16)

Placed = Sequence[PlacedView | None]


@dataclass(frozen=True, slots=True, eq=False)
class Again:
    """Some frames after a second look."""

    poses: list[Pose]
    lost: Mask  # (T, 16) what was followed once more
    known: list[Appearance]  # what the skin looks like in each view, where nothing was lost


def look_again(
    likeness: Likeness, poses: Sequence[Pose], evidence: Sequence[Evidence], placed: Sequence[Placed],
    known: Sequence[Appearance], doubtful: Mask, before: Pose | None, after: Pose | None,
) -> Again | None:  # fmt: skip
    """Follow the limbs once more that are ``doubtful`` (T, 16) or do not look as they are ``known`` to, the body being
    where it was ``placed``, and ``before`` and ``after`` these frames where that is known. None if there are none."""
    doubted = np.array([doubtful[:, list(limb)].any(axis=1) for limb in LIMBS]).T
    lost = doubted | _unlike(likeness, poses, evidence, placed, known)
    if not lost.any():
        return None
    learned = _learn(known, evidence, placed, lost)
    lost = doubted | _unlike(likeness, poses, evidence, placed, learned)
    lost = np.array([_window(lost, t).any(axis=0) for t in range(len(lost))])
    if not lost.any():
        return None
    return Again(_follow(likeness, poses, evidence, learned, lost, before, after), lost @ _OF_LIMB, learned)


def _unlike(
    likeness: Likeness, poses: Sequence[Pose], evidence: Sequence[Evidence], placed: Sequence[Placed],
    known: Sequence[Appearance],
) -> Mask:  # fmt: skip
    """(T, 4) the limbs that do not look as they are ``known`` to, in most of five frames."""
    alike = np.array([
        likeness.of(pose, each, where, known) for pose, each, where in zip(poses, evidence, placed, strict=True)
    ])  # fmt: skip
    return np.array([np.median(_window(alike, t), axis=0) < -_UNLIKE_M2 for t in range(len(alike))])


def _learn(
    known: Sequence[Appearance], evidence: Sequence[Evidence], placed: Sequence[Placed], lost: Mask
) -> list[Appearance]:
    """What the skin looks like, all frames heard in which a limb is not ``lost`` (T, 4)."""
    learned = [look.copy() for look in known]
    for count, (each, where, gone) in enumerate(zip(evidence, placed, lost, strict=True), start=BESIDE):
        each.learn(_without(each, where, [s for k in np.flatnonzero(gone) for s in LIMBS[k]]), learned, 1.0 / count)
    return learned


def _follow(
    likeness: Likeness, poses: Sequence[Pose], evidence: Sequence[Evidence], learned: Sequence[Appearance], lost: Mask,
    before: Pose | None, after: Pose | None,
) -> list[Pose]:  # fmt: skip
    """The poses with the ``lost`` (T, 4) limbs followed once more; what they look like is learned on the way, too."""
    learned = [look.copy() for look in learned]
    chain = [before or poses[0], *poses, after or poses[-1]]
    for limb, segments in enumerate(LIMBS):
        others = [s for group in ((0, 1, 2, 3), *LIMBS) if group != segments for s in group]
        for t, neighbour in _inward(lost[:, limb]):
            each = evidence[t]
            as_beside = taking(poses[t], segments, chain[neighbour + 1])
            found = likeness.search(limb, as_beside, each, learned)
            chain[t + 1] = taking(chain[t + 1], segments, found)
            placed = each.visibility(found)
            if likeness.of(found, each, placed, learned)[limb] > 0.0:
                each.learn(_without(each, placed, others), learned, _ADAPT)
    return chain[1:-1]


def _inward(lost: Mask) -> Iterator[tuple[int, int]]:
    """Each frame of every run of (T,), from its ends to its middle, and the frame outside it, done before."""
    for run in runs(lost):
        for step in range(len(run)):
            left, right = run[step // 2], run[-1 - step // 2]
            yield (left, left - 1) if step % 2 == 0 else (right, right + 1)


def taking(pose: Pose, segments: Sequence[int], other: Pose) -> Pose:
    """The ``pose`` with some segments turned as the ``other`` has them."""
    rotations = pose.rotations.copy()
    rotations[list(segments)] = other.rotations[list(segments)]
    return Pose(pose.root_position_m, rotations)


def runs(marked: Mask) -> list[range]:
    """The frames that follow each other without a gap among those that are ``marked`` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]])))
    return [range(first, stop) for first, stop in edges.reshape(-1, 2).tolist()]


def _window(values: NDArray, t: int) -> NDArray:
    return values[max(t - _AROUND, 0) : t + _AROUND + 1]


def _without(evidence: Evidence, placed: Placed, segments: Sequence[int]) -> list[PlacedView | None]:
    """The views as if some segments were hidden."""
    hidden = np.isin(evidence.body.surface.segment, segments)
    return [
        None if where is None else replace(where, facing=np.where(hidden, np.float32(0.0), where.facing))
        for where in placed
    ]
