"""Constants of `imaging` that no user sets."""

from __future__ import annotations

from typing import Final, NamedTuple


class CombTuning(NamedTuple):
    """`comb`: two fields in one picture."""

    every: int = 12  # rows, of which one comparison of each kind is made
    soft_px: float = 3.0  # standard deviation by which rows are smoothed: combs of up to twice as much are measured
    panned_px: float = 0.3  # comb that has to be expected: codecs blend a smaller one away
    least: int = 6  # pictures with such a comb
    share: float = 0.3
    """Share of the comb of half a frame period, from which on a picture is said to be woven: 1 where it is, 0 where
    not."""
    sigmas: float = 6.0  # standard deviations from which on it is sure


class BandsTuning(NamedTuple):
    """`row_bands`: bands of mains light."""

    cosines: int = 12  # of the rows' gain: six periods in a frame, or some fewer of any phase
    sigma: float = 0.2  # standard deviation of each
    least: float = 0.02  # root mean square from which on a frame has bands at all
    least_of_sweep: float = 0.008
    """The same of most of the frames that overlap, which tell more. Seen where there are none: 0.002 to 0.005."""
    least_of_one: float = 0.025  # the same of any one of these frames. Seen where there are none: 0.004 to 0.015
    telling: int = 3  # one pixel in so many tells whether it is worth while to look for them
    telling_cosines: int = 6  # by which overlaps tell it
    suspicious: float = 0.015  # root mean square, by those of one frame, from which on it is
    least_pixels: int = 200  # with fewer none are looked for
    telling_rounds: int = 2  # of the reweighted fit by these
    rounds: int = 5  # of that by all
    scale_sigmas: float = 3.0  # scale of its Geman-McClure weight, standard deviations


COMB: Final = CombTuning()
BANDS: Final = BandsTuning()
