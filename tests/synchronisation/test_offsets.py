"""Offsets of all cameras from delays of pairs, of which some are wrong."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pzcap.synchronisation.offsets import Delay, connected, solve

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


def test_a_camera_that_two_delays_lead_to_which_contradict_is_not_known() -> None:
    """All others agree, and either of the two agrees with them."""
    some = [each for each in delays({(0, 3): 1.2}) if (each.a, each.b) != (0, 1)]
    assert solve(4, some, 0.03) is None
    assert solve(4, [each for each in some if (each.a, each.b) != (0, 3)], 0.03) is not None


@given(st.integers(3, 6), st.data())
def test_no_wrong_delay_is_believed_where_others_contradict_it(cameras: int, data: st.DataObject) -> None:
    """One delay is wrong, some are not known: the offsets come out right, or not at all, but for a camera that nothing
    but the wrong one leads to."""
    true = np.arange(cameras) * 0.7
    pairs = list(combinations(range(cameras), 2))
    known = data.draw(st.lists(st.sampled_from(pairs), min_size=2, unique=True))
    wrong = data.draw(st.sampled_from(known))
    some = [Delay(a, b, float(true[a] - true[b]) + 0.4 * ((a, b) == wrong), 0.01) for a, b in known]
    found = solve(cameras, some, 0.03)
    bridge = not connected(cameras, [each for each in some if (each.a, each.b) != wrong])
    assert found is None or bridge or np.allclose(found.offset_s, true)
