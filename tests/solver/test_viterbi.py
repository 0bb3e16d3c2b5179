"""Dynamic programming against all sequences there are."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pzcap.solver.viterbi import best_path


@given(st.lists(st.integers(1, 4), min_size=1, max_size=5), st.floats(0.0, 0.4), st.integers(0, 2**32 - 1))
def test_the_best_path_is_the_best_of_all(counts: list[int], forbidden: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scores = [rng.normal(size=count) for count in counts]
    transitions = [rng.normal(size=(after, before)) for before, after in pairwise(counts)]
    for each in transitions:
        each[rng.random(each.shape) < forbidden] = -np.inf

    def total(path: tuple[int, ...]) -> float:
        moves = zip(transitions, path[1:], path, strict=False)
        return float(sum(s[k] for s, k in zip(scores, path, strict=True)) + sum(t[k, j] for t, k, j in moves))

    best = max(total(path) for path in product(*map(range, counts)))
    assert total(tuple(best_path(scores, transitions))) == pytest.approx(best, abs=1e-12)


def test_of_equally_good_paths_the_lowest_states_win() -> None:
    assert best_path([np.zeros(3)] * 4, [np.zeros((3, 3))] * 3) == [0, 0, 0, 0]
