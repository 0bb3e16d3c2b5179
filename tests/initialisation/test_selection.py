"""Frames that become keyframes: where the pose is sure, and no more than serve."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pzcap.initialisation.selection import chosen, worthwhile

RATE = 30.0


def test_spread_over_the_take_at_some_distance_from_each_other() -> None:
    found = chosen(dict.fromkeys(range(171), 1e-3), {}, 171, RATE)
    assert 4 <= len(found) <= 8
    assert found[0] < 20
    assert found[-1] > 150
    assert all(10 < b - a < 60 for a, b in pairwise(found))


def test_the_surer_of_two_near_by() -> None:
    variance = dict.fromkeys(range(60), 4e-3) | {20: 2e-4, 40: 2e-4}
    found = chosen(variance, {}, 60, RATE)
    assert {20, 40} <= set(found)


def test_given_ones_count() -> None:
    every = dict.fromkeys(range(90), 1e-3)
    assert not chosen(every, dict.fromkeys(range(0, 90, 15), 1e-4), 90, RATE)
    beside = chosen(every, {0: 1e-4, 15: 1e-4}, 90, RATE)
    assert beside
    assert min(beside) > 25


def test_no_candidate_no_keyframe() -> None:
    assert chosen({}, {}, 50, RATE) == []


def test_one_second_apart_by_hand_leaves_nothing_to_gain() -> None:
    assert not worthwhile([int(i) for i in np.linspace(0, 170, 7)], 171, RATE)
    assert worthwhile([0], 171, RATE)
    assert worthwhile([], 2, RATE)
