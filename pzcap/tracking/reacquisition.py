"""Reacquisition of limbs that neither pass has kept, by what they look like.

Between two keyframes a limb can be lost from both sides: held before the trunk it has no contour, and its appearance is
forgotten while it is tracked wrongly. Beside the keyframes it is known (`FrameTracker.reference`). So where it does not
look like itself, lies on the hall or scores far less than it mostly does, its postures in all these frames are chosen
anew, together: those that score most (`pzcap.tracking.appearance`) and lead on from one frame to the next (Viterbi),
among those that the passes have, and those to which it leads to follow the limb from the frames before and after
(`pzcap.tracking.limb_beam`), then about these. The reference is also learned from all other frames in which the passes
agree: of two that do not at least one is wrong, and nothing misleads as much as a limb that was learned elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.body.kinematics import difference, forward, retract
from pzcap.body.skeleton import LIMBS
from pzcap.solver.viterbi import best_path
from pzcap.tracking.appearance import LimbAppearance, LimbContext, Postures
from pzcap.tracking.bidirectional_fusion import choose, runs, with_segments
from pzcap.tracking.limb_beam import apart, follow_limb
from pzcap.tracking.limbs import POSTURES, LimbMotion, support, turn_to, turned
from pzcap.tracking.observation import Placed
from pzcap.tracking.pixel_time import AT_REST, sequence_rates
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.skin_appearance import Appearance, Appearances, learn
from pzcap.tracking.tuning import FRAME, REACQUISITION
from pzcap.tracking.view_sequence import ViewSequence
from pzcap.types import SEGMENTS, Array, Mask, Pose

_OF_LIMB: Final[Mask] = np.array([np.isin(np.arange(len(SEGMENTS)), limb) for limb in LIMBS])  # (4, 16)

Neighbours = tuple[Pose | None, Pose | None]  # the poses before and after some frames, where they are known
Places = dict[tuple[int, int], list[LimbMotion]]  # by the number of a frame and a limb's: where the limb may be


@dataclass(frozen=True, slots=True, eq=False)
class PassResults:
    """Results of the passes from the keyframes."""

    poses: list[list[Pose]]  # of each pass
    disputed: Mask  # (T, 16) segments that they do not agree about
    agreed: Mask  # (T, 16) segments that they agree about; none, if there was one pass
    doubtful: Mask  # (T, 16) those of them at or beside a leap
    reference: Appearances  # of the skin in each view, beside the keyframes

    @property
    def sure(self) -> Mask:
        """(T, 4) limbs that the passes agree about, and that leap nowhere."""
        return np.array([(self.agreed & ~self.doubtful)[:, list(limb)].all(axis=1) for limb in LIMBS]).T


@dataclass(frozen=True, slots=True, eq=False)
class Reacquired:
    """Some frames after reacquisition."""

    poses: list[Pose]
    lost: Mask  # (T, 16) segments that were reacquired
    places: Places  # where they were looked for
    reference: list[Appearance]  # of the skin in each view, where nothing was lost
    least_m2: Array  # (4,) score that a limb has where it is, at least


def reacquire(
    limbs: LimbAppearance, poses: Sequence[Pose], objectives: Sequence[PoseObjective], placed: Sequence[Placed],
    passes: PassResults, around: Neighbours, period: float,
) -> Reacquired | None:  # fmt: skip
    """Reacquire the limbs that are doubtful, lie on the hall, do not look like their reference or score little, the
    body being where it was ``placed``, an instant every ``period`` frame periods. None if there are none."""
    disputed, leaping = (
        np.array([segments[:, list(limb)].any(axis=1) for limb in LIMBS]).T
        for segments in (passes.disputed, passes.doubtful)
    )
    frames = list(zip(poses, objectives, placed, strict=True))
    supported = np.array([support(each, pose, where) for pose, each, where in frames])  # (T, 4, 2)
    on_hall = supported[..., 1] / np.maximum(supported.sum(axis=2), REACQUISITION.least_area_m2)
    doubted = leaping | (_filtered(on_hall) > REACQUISITION.largest_hall)

    def similarity(reference: Appearances) -> Array:
        return np.array([limbs.similarity(*frame, reference) for frame in frames])

    similar = similarity(passes.reference)
    score = supported[..., 0] - supported[..., 1] + limbs.weight * similar
    usual_m2 = np.median(score, axis=0)
    doubted |= _filtered(score) < REACQUISITION.lost_share * usual_m2
    lost = doubted | _unlike(similar)
    if not lost.any():
        return None
    reference = _learned(passes.reference, objectives, placed, _widened(lost) | disputed)
    lost = _widened(doubted | _unlike(similarity(reference)))
    if not lost.any():
        return None
    candidates = list(zip(poses, *passes.poses, strict=True))
    sequence = ViewSequence([each.views for each in objectives], period)
    least_m2 = np.minimum(REACQUISITION.least_share * usual_m2, REACQUISITION.least_score_m2)
    found, places = _found(limbs, candidates, sequence, reference, (lost, leaping), around)
    sought = np.array([[(t, limb) in places for limb in range(len(LIMBS))] for t in range(len(poses))])
    return Reacquired(found, sought @ _OF_LIMB, places, reference, least_m2) if places else None


def accepted(
    limbs: LimbAppearance, before: Pose, pairs: Sequence[tuple[Pose, Pose]], sequence: ViewSequence,
    again: Reacquired, agreed: Mask,
) -> list[Pose]:  # fmt: skip
    """The first pose of each pair, but limbs that were lost in the first frames as the second has them, where that
    scores well, and clearly more. Both are judged through the same cameras, those of the ``sequence``. Where the passes
    have ``agreed`` (t, 16), it must lie elsewhere by more than loose clothes explain."""
    gain = np.full((len(again.lost), len(LIMBS)), -np.inf)
    one, other = zip(*pairs, strict=True)
    moving = [sequence.objectives(limbs.body, poses) for poses in (one, other)]
    for t in np.flatnonzero(again.lost.any(axis=1)).tolist():
        here, there = (limbs.score(pose, own[t], again.reference) for pose, own in zip(pairs[t], moving, strict=True))
        worth = there - here - REACQUISITION.least_gain_m2
        gain[t] = worth - REACQUISITION.short_of * np.maximum(again.least_m2 - there, 0.0)
    least_m = np.where(agreed, REACQUISITION.apart_agreed_m, REACQUISITION.apart_m)
    return choose(limbs.body, before, one, other, np.where(again.lost, least_m, np.inf), gain)


def posterior_spread(
    limbs: LimbAppearance, poses: Sequence[Pose], objectives: Sequence[PoseObjective], reference: Appearances,
    places: Places,
) -> Array:  # fmt: skip
    """Root mean square distance (T, 16), metres, of the joints of limbs from where they are in postures all over their
    reach, and in the ``places`` where they were looked for, as far as these lie apart; NaN of limbs that were looked
    for nowhere, and of the joint that a limb turns in.

    The odds of two postures are those of their scores, so that the distance is small where the limb scores much more
    than elsewhere. A score falls to nothing within a decimetre: postures all over the reach miss another place.
    """
    found, reach = np.full((len(poses), len(SEGMENTS)), np.nan), np.vstack([POSTURES, 2.0 * POSTURES])
    for (t, limb), others in places.items():
        context = limbs.context(limb, poses[t], objectives[t], reference)
        about = limbs.postures(limb, context, reach, coarse=True)
        rates = objectives[t].rates
        here = LimbMotion(poses[t], AT_REST if rates is None else rates)
        there = _scored(limbs, limb, context, [here, *others])
        order = np.concatenate([[np.inf], there.score_m2[1:]])  # what lies about its place is none other
        _, *elsewhere = apart(order, there.moved_m, REACQUISITION.apart_agreed_m)
        score = np.concatenate([about.score_m2, there.score_m2[elsewhere]])
        odds = np.exp((score - score.max()) / REACQUISITION.odds_m2)
        squared = np.sum(np.vstack([about.moved_m, there.moved_m[elsewhere]]) ** 2, axis=2)
        found[t, list(LIMBS[limb][1:])] = np.sqrt(odds @ squared / odds.sum())
    return found


def _unlike(similarity: Array) -> Mask:
    """(T, 4) limbs that do not look like their reference."""
    return _filtered(similarity) < -REACQUISITION.unlike_m2


def _widened(lost: Mask) -> Mask:
    """(T, 4) with the frames beside those in which a limb is ``lost``: where it goes astray, it looks right as yet."""
    return np.array([_window(lost, t, REACQUISITION.beside).any(axis=0) for t in range(len(lost))])


def _filtered(values: Array) -> Array:
    """Median of (T, N) over five frames."""
    return np.array([np.median(_window(values, t, REACQUISITION.window), axis=0) for t in range(len(values))])


def _window(values: NDArray, t: int, around: int) -> NDArray:
    return values[max(t - around, 0) : t + around + 1]


def _learned(
    reference: Appearances, objectives: Sequence[PoseObjective], placed: Sequence[Placed], lost: Mask
) -> list[Appearance]:
    """The ``reference`` after all frames, the limbs that are ``lost`` (T, 4) in them as if they were hidden."""
    learned, segment = [look.copy() for look in reference], objectives[0].body.surface.segment
    frames = zip(objectives, placed, (lost @ _OF_LIMB)[:, segment], strict=True)
    for count, (objective, where, hidden) in enumerate(frames, start=FRAME.beside_keyframe):
        shown = [
            None if one is None else replace(one, facing=np.where(hidden, np.float32(0.0), one.facing)) for one in where
        ]
        learn(objective.views, shown, learned, 1.0 / count)
    return learned


def _found(
    limbs: LimbAppearance, candidates: Sequence[Sequence[Pose]], sequence: ViewSequence, reference: Appearances,
    verdicts: tuple[Mask, Mask], around: Neighbours,
) -> tuple[list[Pose], Places]:  # fmt: skip
    """The poses, of each frame's ``candidates`` the first, with limbs reacquired one after the other: one that has been
    found leaves its place to no other. Also where they were looked for.

    By the ``verdicts`` (T, 4) some are lost, and some of them leap. One that leaps nowhere, and scores no more anywhere
    else, stays as it is.
    """
    lost, leaping = verdicts
    places: Places = {}
    poses = [pose for pose, *_ in candidates]
    found, chain = list(poses), [around[0], *poses, around[1]]
    for limb, segments in enumerate(LIMBS):
        for run in runs(lost[:, limb]):
            first, last = chain[run.start], chain[run.stop + 1]
            first, last = first or last or poses[run.start], last or first or poses[run.start]
            came, goes = chain[max(run.start - 1, 0)] or first, chain[min(run.stop + 2, len(chain) - 1)] or last
            part = sequence.part(run)
            contexts = _between(limbs, limb, part, found[run.start : run.stop], (first, last), reference)
            ahead = follow_limb(limbs, limb, contexts, came, first, sequence.period)
            back = follow_limb(limbs, limb, contexts[::-1], goes, last, -sequence.period)[::-1]
            passes = [
                _moving(limbs, limb, part, contexts, each)
                for each in zip(*candidates[run.start : run.stop], strict=True)
            ]
            tried = [[*own, *a, *b] for own, a, b in zip(zip(*passes, strict=True), ahead, back, strict=True)]
            leaps = leaping[run.start : run.stop, limb].any()
            if not leaps and _most_gained(limbs, limb, contexts, tried) < REACQUISITION.promising_m2:
                continue
            for t, best, others in zip(run, _path(limbs, limb, part, contexts, tried), tried, strict=True):
                found[t] = with_segments(found[t], segments, best.pose)
                places[t, limb] = [*others, best]
    return found, places


def _moving(
    limbs: LimbAppearance, limb: int, sequence: ViewSequence, contexts: Sequence[LimbContext], poses: Sequence[Pose]
) -> list[LimbMotion]:
    """A limb as ``poses`` have it, in the frames of a ``sequence``."""
    own = [with_segments(context.pose, LIMBS[limb], pose) for context, pose in zip(contexts, poses, strict=True)]
    rates = sequence_rates([forward(limbs.body, pose) for pose in own], sequence.period)
    return [LimbMotion(*each) for each in zip(own, rates, strict=True)]


def _scored(limbs: LimbAppearance, limb: int, context: LimbContext, motions: Sequence[LimbMotion]) -> Postures:
    """A limb where it may be, scored in coarse images as it moves there."""
    turns = np.array([turn_to(limb, context.pose, each.pose) for each in motions])
    return limbs.postures(limb, context, turns, np.array([each.rates for each in motions]), coarse=True)


def _most_gained(
    limbs: LimbAppearance, limb: int, contexts: Sequence[LimbContext], candidates: Sequence[Sequence[LimbMotion]]
) -> float:
    """By how much more a limb scores at the best of the other ``candidates`` than at the first, where most in the
    median of some frames."""
    gained = []
    for context, tried in zip(contexts, candidates, strict=True):
        score = _scored(limbs, limb, context, tried).score_m2
        gained.append(score[1:].max() - score[:1])
    return float(_filtered(np.array(gained)).max())


def _between(
    limbs: LimbAppearance, limb: int, sequence: ViewSequence, poses: Sequence[Pose], ends: tuple[Pose, Pose],
    reference: Appearances,
) -> list[LimbContext]:  # fmt: skip
    """The frames of a ``sequence``, made ready to score a limb, which lies between what it is at its ``ends``."""
    first, last = ends
    shares = (np.arange(len(poses)) + 1.0) / (len(poses) + 1.0)
    starts = [
        with_segments(pose, LIMBS[limb], retract(first, share * difference(last, first)))
        for pose, share in zip(poses, shares, strict=True)
    ]
    pairs = zip(starts, sequence.objectives(limbs.body, starts), strict=True)
    return [limbs.context(limb, pose, objective, reference) for pose, objective in pairs]


def _path(
    limbs: LimbAppearance, limb: int, sequence: ViewSequence, contexts: Sequence[LimbContext],
    candidates: Sequence[Sequence[LimbMotion]],
) -> list[LimbMotion]:  # fmt: skip
    """The postures of a limb in a ``sequence`` that score most together.

    To those about the path so far, the limb moving as that has it, come the ``candidates`` and, as it may have been
    lost in the middle of a run alone, the limb as the frames beside have it (Barnes et al., 2009).
    """
    path, others = _moving(limbs, limb, sequence, contexts, [each.pose for each in contexts]), list(candidates)
    for size in REACQUISITION.sizes_rad:
        postures = []
        for context, here, beside in zip(contexts, path, others, strict=True):
            around = turn_to(limb, context.pose, here.pose) + size * POSTURES
            turns = np.vstack([around, *(turn_to(limb, context.pose, each.pose) for each in beside)])
            rates = np.array([*[here.rates] * len(around), *(each.rates for each in beside)])
            postures.append(limbs.postures(limb, context, turns, rates))
        chosen = zip(contexts, postures, smoothest(postures), strict=True)
        poses = [turned(limb, context.pose, each.turns[k]) for context, each, k in chosen]
        path = _moving(limbs, limb, sequence, contexts, poses)
        others = [[path[n] for n in (t - 2, t - 1, t + 1, t + 2) if 0 <= n < len(path)] for t in range(len(path))]
    return path


def smoothest(postures: Sequence[Postures]) -> list[int]:
    """The posture of each frame, so that the sum of their scores, less the cost of leaps, is greatest."""
    transitions = []
    for one, other in pairwise(postures):
        leap = np.sum((other.moved_m[:, None] - one.moved_m) ** 2, axis=(2, 3)) / REACQUISITION.leap_m**2
        transitions.append(-REACQUISITION.leap_m2 * np.minimum(leap, REACQUISITION.worst_leap))
    return best_path([each.score_m2 for each in postures], transitions)
