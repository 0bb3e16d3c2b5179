"""The belief about the hall's distances, and the things that are taken to stand apart from floor and walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pzcap.calibration.beliefs import information, standing_apart
from pzcap.calibration.parameters import CalibrationParameters, hall_size, place_of_travel, to_vector
from tests.calibration.test_bundle_adjustment import HALL, SIGMAS, truth

BOX = np.zeros((4, 36), np.bool_)
BOX[1, 10:13] = True  # on the floor, half way to the wall


def hall_with(nearer: float, offset: float) -> CalibrationParameters:
    """A hall with a box that is nearer by so large a share than what is behind it, and slight departures all over."""
    departures = np.random.default_rng(0).normal(0.0, 0.02, BOX.shape) + nearer * BOX
    return replace(truth(), offset=np.array([offset, 0.0]), surroundings=replace(HALL, departures=departures))


def test_a_box_stands_apart_where_it_can_be_seen_to_shift() -> None:
    np.testing.assert_array_equal(standing_apart(hall_with(0.6, 0.004)), BOX)
    assert not standing_apart(hall_with(0.1, 0.004)).any()  # hardly nearer
    assert not standing_apart(hall_with(0.6, 0.0004)).any()  # parallax of a hundredth of a pixel
    assert not standing_apart(hall_with(-0.6, 0.004)).any()  # nothing is behind a wall or under the floor


def test_only_what_stands_apart_is_open() -> None:
    state = hall_with(0.0, 0.004)
    shut, opened = (np.linalg.inv(information(state, SIGMAS, apart)[-144:, -144:]) for apart in (None, BOX))
    ratio = np.sqrt(np.diag(opened) / np.diag(shut)).reshape(BOX.shape)
    assert ratio[BOX].min() > 300.0
    assert ratio[~BOX].max() < 3.0
    np.testing.assert_array_equal(
        information(state, SIGMAS)[: -hall_size(state)], information(state, SIGMAS, BOX)[: -hall_size(state)]
    )


def test_the_further_the_centre_is_off_the_less_is_open() -> None:
    near, far = (
        np.diag(information(hall_with(0.0, offset), SIGMAS, BOX))[-144:].reshape(BOX.shape)[BOX]
        for offset in (0.004, 0.08)
    )
    assert np.all(far > 100.0 * near)


def test_the_travel_has_its_place() -> None:
    state = replace(hall_with(0.6, 0.004), travel=0.123)
    assert to_vector(state)[place_of_travel(state)] == 0.123
