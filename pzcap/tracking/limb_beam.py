"""Beam search of a limb: followed frame by frame from one in which it is known, several hypotheses at a time.

Gauss-Newton steps follow the nearest edge, and when that is another limb's, or the hall's, they stay with it. A limb's
score (`pzcap.tracking.appearance`) is far higher where the limb truly is, but falls to nothing within a decimetre, so
that a search in all of its reach would need thousands of postures. From frame to frame a limb moves little beside what
it did before: of the postures about that of each hypothesis, those that have scored most so far go on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Final, NamedTuple

import numpy as np

from pzcap.body.kinematics import forward
from pzcap.body.skeleton import LIMBS
from pzcap.tracking.appearance import LimbAppearance, LimbContext, Postures
from pzcap.tracking.bidirectional_fusion import with_segments
from pzcap.tracking.limbs import POSTURES, turn_to, turned
from pzcap.tracking.pixel_time import rates_between
from pzcap.tracking.tuning import BEAM, REACQUISITION
from pzcap.types import Array, Pose


class Hypothesis(NamedTuple):
    """A limb in one frame and in the one before, and its score so far."""

    pose: Pose
    before: Pose
    total_m2: float


_AROUND: Final[Array] = POSTURES[np.prod(POSTURES[:, 2:], axis=1) == 0.0]
"""(K, 4) Turns about a posture that are tried, as shares of ``BEAM.spread_rad``."""
_MIDDLE: Final = int(np.argmin(np.abs(_AROUND).sum(axis=1)))


def follow_limb(
    limbs: LimbAppearance, limb: int, contexts: Sequence[LimbContext], before: Pose, last: Pose, period: float
) -> list[list[Pose]]:
    """The poses of each of the frames ``contexts``, the limb as the hypotheses have it, the best first. It is known in
    the two frames before the first: in that ``before`` and in the ``last``. An instant every ``period`` frame periods,
    backward in time where that is negative."""
    beam, found = [Hypothesis(last, before, 0.0)], []
    for context in contexts:
        beam = _next(limbs, limb, context, beam, period)
        found.append([each.pose for each in beam])
    return found


def _next(
    limbs: LimbAppearance, limb: int, context: LimbContext, beam: Sequence[Hypothesis], period: float
) -> list[Hypothesis]:
    """The hypotheses in one more frame: the best of what goes on from those in the frame before."""
    tried = [_going_on(limbs, limb, context, each, period) for each in beam]
    totals = np.concatenate([
        each.total_m2 + one.score_m2 - REACQUISITION.leap_m2 * _leap(one) for each, one in zip(beam, tried, strict=True)
    ])  # fmt: skip
    turns = np.concatenate([one.turns for one in tried])
    places = np.concatenate([one.moved_m for one in tried])
    return [
        Hypothesis(turned(limb, context.pose, turns[n]), beam[n // len(_AROUND)].pose, float(totals[n]))
        for n in islice(apart(totals, places, BEAM.apart_m), BEAM.width)
    ]


def _going_on(limbs: LimbAppearance, limb: int, context: LimbContext, each: Hypothesis, period: float) -> Postures:
    """Postures (K,) about the one in which a hypothesis would be if the limb turned on at its speed."""
    segments = LIMBS[limb]
    stays = with_segments(context.pose, segments, each.pose)
    turn = turn_to(limb, with_segments(each.pose, segments, each.before), each.pose)
    goes_on = turned(limb, stays, turn)
    rates = rates_between(forward(limbs.body, each.pose), forward(limbs.body, goes_on), period)
    moving = replace(context, objective=replace(context.objective, rates=rates))
    around = turn_to(limb, context.pose, goes_on) + BEAM.spread_rad * _AROUND
    return limbs.postures(limb, moving, around, coarse=True)


def _leap(tried: Postures) -> Array:
    """(K,) Squared distances from where the limb was expected, in those that are usual."""
    off = tried.moved_m - tried.moved_m[_MIDDLE]
    return np.asarray(np.sum(off**2, axis=(1, 2)) / REACQUISITION.leap_m**2)


def apart(score: Array, places: Array, least_m: float) -> Iterator[int]:
    """Those of some postures whose joints, at ``places`` (K, 2, 3), lie ``least_m`` apart from each other: of those
    that do not, the one of the greatest ``score`` (K,); the best first."""
    left = np.ones(len(score), bool)
    while left.any():
        best = int(np.argmax(np.where(left, score, -np.inf)))
        yield best
        left &= np.abs(places - places[best]).max(axis=(1, 2)) > least_m
