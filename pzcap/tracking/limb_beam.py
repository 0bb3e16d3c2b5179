"""Beam search of a limb: followed frame by frame from one in which it is known, several hypotheses at a time.

Gauss-Newton steps follow the nearest edge, and when that is another limb's, or the hall's, they stay with it. A limb's
score (`pzcap.tracking.appearance`) is far higher where the limb truly is, but falls to nothing within a decimetre, so
that a search in all of its reach would need thousands of postures. From frame to frame a limb moves little beside what
it did before: of the postures about that of each hypothesis, those that have scored most so far go on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Final, NamedTuple

import numpy as np

from pzcap.body.kinematics import forward
from pzcap.body.skeleton import LIMBS, Body
from pzcap.tracking.appearance import LimbAppearance, LimbContext
from pzcap.tracking.bidirectional_fusion import with_segments
from pzcap.tracking.limbs import POSTURES, LimbMotion, turn_to, turned
from pzcap.tracking.pixel_time import AT_REST, rates_between
from pzcap.tracking.tuning import BEAM, REACQUISITION
from pzcap.types import Array, Pose


class _Hypothesis(NamedTuple):
    """A limb in one frame and in the one before, and its score so far."""

    motion: LimbMotion
    before: Pose
    total_m2: float


_AROUND: Final[Array] = POSTURES[np.prod(POSTURES[:, 2:], axis=1) == 0.0]
"""(K, 4) Turns about a posture that are tried, as shares of ``BeamLook.spread_rad``."""


def follow_limb(
    limbs: LimbAppearance, limb: int, contexts: Sequence[LimbContext], before: Pose, last: Pose, period: float
) -> list[list[LimbMotion]]:
    """The limb in each of the frames ``contexts``, as the hypotheses have it, the best first. It is known in the two
    frames before the first: in that ``before`` and in the ``last``. An instant every ``period`` frame periods, backward
    in time where that is negative."""
    beam, found = [_Hypothesis(LimbMotion(last, AT_REST), before, 0.0)], []
    for context in contexts:
        beam = _next(limbs, limb, context, beam, period)
        found.append([each.motion for each in beam])
    return found


def _next(
    limbs: LimbAppearance, limb: int, context: LimbContext, beam: Sequence[_Hypothesis], period: float
) -> list[_Hypothesis]:
    """The hypotheses in one more frame: the best of what goes on from those in the frame before."""
    expected = [_going_on(limbs.body, limb, context.pose, each, period) for each in beam]
    turns = np.array([turn_to(limb, context.pose, each.pose) for each in expected])
    usual_m = limbs.postures(limb, context, turns, coarse=True).moved_m
    carried_m2, rates = np.array([each.total_m2 for each in beam]), np.array([each.rates for each in expected])
    origin = np.arange(len(beam))
    for look in BEAM.looks:
        turns = (turns[:, None] + look.spread_rad * _AROUND).reshape(-1, 4)
        origin = np.repeat(origin, len(_AROUND))
        tried = limbs.postures(limb, context, turns, rates[origin], coarse=look.coarse)
        leap = np.sum((tried.moved_m - usual_m[origin]) ** 2, axis=(1, 2)) / REACQUISITION.leap_m**2
        total_m2 = carried_m2[origin] + tried.score_m2 - REACQUISITION.leap_m2 * leap
        best = list(islice(apart(total_m2, tried.moved_m, BEAM.apart_m), look.width))
        turns, origin, total_m2 = tried.turns[best], origin[best], total_m2[best]
    found = []
    for turn, n, total in zip(turns, origin.tolist(), total_m2.tolist(), strict=True):
        came, pose = beam[n].motion.pose, turned(limb, context.pose, turn)
        moving = LimbMotion(pose, rates_between(forward(limbs.body, came), forward(limbs.body, pose), period))
        found.append(_Hypothesis(moving, came, total))
    return found


def _going_on(body: Body, limb: int, pose: Pose, each: _Hypothesis, period: float) -> LimbMotion:
    """The limb of a hypothesis one frame on, in which the body has the ``pose``, if it turned on at its speed."""
    segments, came = LIMBS[limb], each.motion.pose
    turn = turn_to(limb, with_segments(came, segments, each.before), came)
    goes_on = turned(limb, with_segments(pose, segments, came), turn)
    return LimbMotion(goes_on, rates_between(forward(body, came), forward(body, goes_on), period))


def apart(score: Array, places: Array, least_m: float) -> Iterator[int]:
    """Those of some postures whose joints, at ``places`` (K, 2, 3), lie ``least_m`` apart from each other: of those
    that do not, the one of the greatest ``score`` (K,); the best first."""
    left = np.ones(len(score), bool)
    while left.any():
        best = int(np.argmax(np.where(left, score, -np.inf)))
        yield best
        left &= np.abs(places - places[best]).max(axis=(1, 2)) > least_m
