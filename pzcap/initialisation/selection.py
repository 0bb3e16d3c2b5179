"""Choice of the frames that become keyframes: as few as serve, where the pose is surest.

Between two keyframes the variance of what is tracked grows with the frames from the nearest one, so that a frame at a
distance ``d`` from one of variance ``v`` is worth ``v + growth d``; before the first and after the last, where the body
is tracked from one side only, it grows faster. Keyframes are added one after the other, each where the sum over all
frames falls most, until one more no longer pays: more of them are not better, since all err alike by what the detector
means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pzcap.initialisation.tuning import SELECTION
from pzcap.types import Array


def chosen(candidates_m2: Mapping[int, float], given_m2: Mapping[int, float], frames: int, rate: float) -> list[int]:
    """The candidates to be keyframes, in order, beside those that are ``given``; both by frame, with the variance of a
    joint there. ``frames`` in all, ``rate`` a second."""
    price = SELECTION.growth_m2 * (SELECTION.spacing_s * rate) ** 2 / 8.0
    taken = dict(given_m2)
    while True:
        now = _worth(taken, frames)
        gains = {
            frame: float(np.sum(now - _worth(taken | {frame: variance}, frames)))
            for frame, variance in candidates_m2.items()
            if frame not in taken
        }
        best = max(gains, key=gains.__getitem__, default=None)
        if best is None or gains[best] < price:
            return sorted(set(taken) - set(given_m2))
        taken[best] = candidates_m2[best]


def worthwhile(given: Sequence[int], frames: int, rate: float) -> bool:
    """True where a keyframe more, however sure, would pay beside the ``given`` ones."""
    some = dict.fromkeys(range(0, frames, max(frames // 200, 1)), 0.0)
    return bool(chosen(some, dict.fromkeys(given, 0.0), frames, rate))


def _worth(taken: Mapping[int, float], frames: int) -> Array:
    """(F,) variance of each frame by the nearest of the keyframes ``taken``."""
    if not taken:
        return np.full(frames, SELECTION.unknown_m2)
    at, variance = np.array(sorted(taken)), np.array([taken[frame] for frame in sorted(taken)])
    every = np.arange(frames)
    growth = np.where((every < at[0]) | (every > at[-1]), SELECTION.one_sided, 1.0) * SELECTION.growth_m2
    worth = (variance[:, None] + growth * np.abs(every - at[:, None])).min(axis=0)
    return np.asarray(np.minimum(worth, SELECTION.unknown_m2))
