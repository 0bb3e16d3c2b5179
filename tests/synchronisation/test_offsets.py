"""Offsets of all cameras from delays of pairs, of which some are wrong."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pzcap.synchronisation.offsets import Delay, solve

TRUE = np.array([0.0, 1.25, -0.5, 3.0])


def delays(wrong: dict[tuple[int, int], float] | None = None) -> list[Delay]:
    return [
        Delay(a, b, float(TRUE[a] - TRUE[b]) + (wrong or {}).get((a, b), 0.0), 0.01)
        for a, b in combinations(range(4), 2)
    ]


def test_pairs_that_agree_give_the_offsets() -> None:
    found = solve(4, delays(), 0.03)
    assert found is not None
    np.testing.assert_allclose(found.offset_s, TRUE, atol=1e-12)
    assert (found.sigma_s > 0.005).all()


def test_one_that_contradicts_is_left_out() -> None:
    found = solve(4, delays({(1, 2): 0.4}), 0.03)
    assert found is not None
    np.testing.assert_allclose(found.offset_s, TRUE, atol=1e-12)


@pytest.mark.parametrize(
    "kept",
    [
        [(0, 1), (1, 2), (0, 2)],  # camera 3 knows nothing
        [],
    ],
)
def test_cameras_that_nothing_connects_are_not_known(kept: list[tuple[int, int]]) -> None:
    assert solve(4, [each for each in delays() if (each.a, each.b) in kept], 0.03) is None


def test_three_cameras_that_contradict_each_other_are_not_known() -> None:
    """Which of three delays is wrong nobody can tell."""
    three = [each for each in delays({(0, 2): 0.4}) if each.b < 3]
    assert solve(3, three, 0.03) is None
