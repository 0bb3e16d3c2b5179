"""Constants of `imaging` that no user sets."""

from __future__ import annotations

from typing import Final, NamedTuple


class CombTuning(NamedTuple):
    """`comb`: two fields in one picture."""

    every: int = 12  # rows, of which one comparison of each kind is made
    soft_px: float = 3.0
    """Standard deviation by which rows are smoothed: combs of up to twice as much are measured."""
    panned_px: float = 0.3  # comb that has to be expected: codecs blend a smaller one away
    least: int = 6  # pictures with such a comb
    share: float = 0.3
    """Share of the comb of half a frame period, from which on a picture is said to be woven: 1 where it is, 0 where
    not."""
    sigmas: float = 6.0  # standard deviations from which on it is sure


COMB: Final = CombTuning()
