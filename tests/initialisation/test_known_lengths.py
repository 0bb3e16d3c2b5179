"""Lengths that were measured in the hall, by cameras in a ring about it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pzcap.initialisation import known_lengths
from pzcap.initialisation.known_lengths import Point, Ratio, Sight, ratio_of, scale_of
from pzcap.initialisation.tuning import LENGTHS
from pzcap.types import Array, Camera, PzcapError
from tests.scenes.captures import facing, project

_PLACES_M = np.array([[9.0, 8.0, 1.8], [-9.0, 8.5, 1.6], [-8.5, -9.0, 2.0], [9.5, -8.0, 1.7]])


def meet(sights: list[Sight]) -> Point:
    return known_lengths.meet(sights, LENGTHS.floor_m)


def cameras(target_m: Array) -> list[Camera]:
    return [Camera(640, 480, facing(place, target_m), 600.0, np.array([319.5, 239.5]), -0.05) for place in _PLACES_M]


def sights(point_m: Array, seen_by: list[int], noise_px: Array | None = None) -> list[Sight]:
    found = []
    for k, c in enumerate(seen_by):
        camera = cameras(point_m + np.array([0.4, -0.3, 0.5]))[c]
        px = project(camera, point_m[None])[0]
        found.append(Sight(camera, px if noise_px is None else px + noise_px[k], 0.0))
    return found


@given(x=st.floats(-6.0, 6.0), y=st.floats(-6.0, 6.0), z=st.floats(0.0, 2.5))
def test_lines_of_sight_meet_where_the_point_is(x: float, y: float, z: float) -> None:
    point_m = np.array([x, y, z])
    np.testing.assert_allclose(meet(sights(point_m, [0, 1, 3])).place_m, point_m, atol=1e-6)
    assert meet(sights(point_m, [0, 1, 3])).misfit < 1e-3


@given(x=st.floats(-6.0, 6.0), y=st.floats(-6.0, 6.0))
def test_what_one_picture_shows_lies_on_the_floor(x: float, y: float) -> None:
    point_m = np.array([x, y, 0.0])
    np.testing.assert_allclose(meet(sights(point_m, [2])).place_m, point_m, atol=1e-6)


@pytest.mark.parametrize("seen_by", [[1], [0, 1], [0, 1, 2, 3]])
def test_a_point_is_as_sure_as_it_says(seen_by: list[int]) -> None:
    rng, point_m = np.random.default_rng(0), np.array([3.0, -2.0, 0.0])
    errors = []
    for _ in range(300):
        lifted = np.array([0.0, 0.0, LENGTHS.floor_m * rng.normal()]) if len(seen_by) == 1 else np.zeros(3)
        found = meet(sights(point_m + lifted, seen_by, LENGTHS.click_px * rng.normal(size=(len(seen_by), 2))))
        off = found.place_m - point_m
        errors.append(off[:2] @ np.linalg.solve(found.covariance_m2[:2, :2], off[:2]))
    assert np.mean(errors) == pytest.approx(2.0, rel=0.2)


def test_marks_of_different_points_do_not_fit() -> None:
    one, other = np.array([1.0, 2.0, 0.0]), np.array([1.0, 2.0, 0.4])
    assert meet([*sights(one, [0]), *sights(other, [1])]).misfit > LENGTHS.most_misfit


def test_a_line_of_sight_above_the_horizon_meets_no_floor() -> None:
    camera = Camera(
        640, 480, facing(np.array([0.0, 0.0, 1.5]), np.array([9.0, 0.0, 1.5])), 600.0, np.array([320.0, 240.0]), 0.0
    )
    with pytest.raises(PzcapError, match=r"behind|do not meet"):
        meet([Sight(camera, np.array([320.0, 100.0]), 0.0)])


def test_a_length_is_as_sure_as_its_ends_along_it() -> None:
    one, other = (meet(sights(np.array(place), [0, 1, 2, 3])) for place in ([-6.0, 6.0, 0.0], [6.0, 6.0, 0.0]))
    found = ratio_of("side", 12.12, 0.001, (one, other))
    assert np.exp(found.log) == pytest.approx(1.01, abs=1e-6)
    assert 2e-4 < found.sigma < 4e-3
    with pytest.raises(PzcapError, match="one and the same"):
        ratio_of("side", 12.0, 0.001, (one, one))


def test_a_length_that_contradicts_the_others_is_left_out() -> None:
    ratios = [Ratio(name, log, 0.002) for name, log in (("a", 0.051), ("b", 0.049), ("c", 0.2), ("d", 0.050))]
    found = scale_of(ratios, 1.0)
    assert found.apart == ("c",)
    assert np.log(found.factor) == pytest.approx(0.05, abs=1e-9)
    assert found.sigma == pytest.approx(0.002 / np.sqrt(3.0))


def test_a_length_that_looks_surest_has_one_vote() -> None:
    """Of three sides one was written down as 21 m for 12: relative to that, it is known best."""
    ratios = [Ratio("south", 0.0, 0.0016), Ratio("east", 0.56, 0.0010), Ratio("west", 0.0, 0.0015)]
    found = scale_of(ratios, 1.0)
    assert found.apart == ("east",)
    assert found.torn == ()
    assert found.factor == pytest.approx(1.0)


def test_as_many_against_as_many_are_all_named() -> None:
    ratios = [Ratio(name, log, 0.002) for name, log in (("a", 0.0), ("b", 0.001), ("c", 0.3), ("d", 0.301))]
    found = scale_of(ratios, 1.0)
    assert found.torn == ("a", "b", "c", "d")
    assert found.apart == ()
    assert found.sigma > 0.05


def test_two_that_contradict_each_other_are_believed_half_and_known_less_well() -> None:
    found = scale_of([Ratio("a", 0.0, 0.002), Ratio("b", 0.1, 0.002)], 1.0)
    assert found.apart == ()
    assert np.log(found.factor) == pytest.approx(0.05)
    assert found.sigma > 0.04
    assert found.torn == ("a", "b")
    assert scale_of([Ratio("a", 0.0, 0.002), Ratio("b", 0.01, 0.002)], 1.0).torn == ()


def test_marks_that_several_lengths_share_count_once() -> None:
    ratios = [Ratio(name, 0.0, 0.002) for name in "abcd"]
    assert scale_of(ratios, 2.0).sigma == pytest.approx(np.sqrt(2.0) * scale_of(ratios, 1.0).sigma)
