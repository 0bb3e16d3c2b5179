"""Offsets of all cameras from delays between pairs of them, and whether these agree.

Camera ``b`` shows ``delay`` seconds later in its file what ``a`` shows: ``offset_a - offset_b = delay``. Of n cameras
there are n (n - 1) / 2 pairs for n - 1 unknowns; what is left over tells whether a way to know them can be trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pzcap.types import Array


@dataclass(frozen=True, slots=True)
class Delay:
    """How much later camera ``b`` shows in its file what camera ``a`` shows."""

    a: int
    b: int
    delay_s: float
    sigma_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """Common time of each file's time 0; that of the first camera is 0."""

    offset_s: Array  # (C,)
    sigma_s: Array  # (C,)
    left_s: float  # largest by which a pair that was used disagrees


def solve(cameras: int, delays: Sequence[Delay], agree_s: float) -> Offsets | None:
    """The offsets of all cameras by those delays that agree to ``agree_s``: of contradicting ones those that contradict
    most are left out. None where the rest does not connect all cameras, or where it cannot be told what is wrong."""
    used, left_out = list(delays), list[Delay]()
    while connected(cameras, used):
        found = _least_squares(cameras, used)
        off = np.array([abs(found.offset_s[d.a] - found.offset_s[d.b] - d.delay_s) for d in used])
        if not off.size or off.max() <= agree_s:
            return None if _doubtful(cameras, used, left_out, agree_s) else found
        left_out.append(used.pop(int(np.argmax(off / [d.sigma_s for d in used]))))
    return None


def _doubtful(cameras: int, used: Sequence[Delay], left_out: Sequence[Delay], agree_s: float) -> bool:
    """True where one of those that were left out could stand in for one that was used: in a single loop, or where two
    lead to a camera and contradict each other, either may be wrong."""
    for other in left_out:
        for each in used:
            instead = [*(one for one in used if one is not each), other]
            if connected(cameras, instead) and _least_squares(cameras, instead).left_s <= agree_s:
                return True
    return False


def connected(cameras: int, delays: Sequence[Delay]) -> bool:
    """True where the delays lead from each camera to each other one."""
    reached, before = {0}, 0
    while len(reached) > before:
        before = len(reached)
        for each in delays:
            if {each.a, each.b} & reached:
                reached |= {each.a, each.b}
    return len(reached) == cameras


def _least_squares(cameras: int, delays: Sequence[Delay]) -> Offsets:
    rows, right = np.zeros((len(delays), cameras)), np.zeros(len(delays))
    for k, each in enumerate(delays):
        rows[k, each.a], rows[k, each.b] = 1.0 / each.sigma_s, -1.0 / each.sigma_s
        right[k] = each.delay_s / each.sigma_s
    offset, covariance = np.zeros(cameras), np.zeros((cameras, cameras))
    if cameras > 1:
        normal = rows[:, 1:].T @ rows[:, 1:]
        offset[1:] = np.linalg.solve(normal, rows[:, 1:].T @ right)
        # the errors of the delays of one camera have a common part: more pairs do not make it smaller
        covariance[1:, 1:] = np.linalg.inv(normal) * (cameras / 2.0)
    off = [abs(offset[d.a] - offset[d.b] - d.delay_s) for d in delays]
    sigma = np.sqrt(np.diag(covariance))
    if cameras > 1:
        sigma[0] = float(sigma[1:].mean())
    return Offsets(offset, sigma, max(off, default=0.0))
