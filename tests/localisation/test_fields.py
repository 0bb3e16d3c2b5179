"""Cameras by both fields of interlaced frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pzcap.localisation.fields import by_both_fields, expected_second
from pzcap.localisation.readout import History, Readout, Sway
from pzcap.types import Array, Localisation

NOWHERE = np.empty((0, 2))
COURSE = np.polynomial.Polynomial([0.3, 0.01, -0.002, 0.0004])
SIGMA = 1e-5


def frame(at: float, blended: float, course: Callable[[float], float] = COURSE) -> Localisation:
    """A frame at a time, of whose fields so much is the other's; log focal has half the course of pan."""
    first, second = course(at), course(at + 0.5)
    shown = first + blended * (second - first), second - blended * (second - first)
    there = np.array([shown[1], 6.0 + 0.5 * shown[1]])
    focal_px = float(np.exp(6.0 + 0.5 * shown[0]))
    covariance = SIGMA**2 * np.eye(2)
    return Localisation(shown[0], 0.0, focal_px, covariance, True, NOWHERE, NOWHERE, second_field=there)


def off(found: list[Localisation | None]) -> Array:
    """(F, 2) pan and log focal minus those of the course."""
    frames = [one for one in found if one is not None]
    true = [COURSE(number) for number in range(len(frames))]
    return np.array([
        [one.pan_rad - at, np.log(one.focal_px) - 6.0 - 0.5 * at] for one, at in zip(frames, true, strict=True)
    ])  # fmt: skip


@pytest.mark.parametrize("blended", [0.0, 0.2, 0.5])
def test_blended_fields_do_not_displace_a_frame(blended: float) -> None:
    seen = [frame(number, blended) for number in range(8)]
    assert (np.abs(off(list(seen))).max() > 1e-3) == (blended > 0.0)
    mended = by_both_fields(seen)
    np.testing.assert_allclose(off(mended)[2:-1], 0.0, atol=1e-12)  # a cubic through four frames is the course


def test_a_hand_that_trembles_leaves_it_less_sure() -> None:
    def tremor(at: float) -> float:
        return 0.3 + 1e-3 * float(np.sin(2 * np.pi * at / 6.0))

    mended = by_both_fields([frame(number, 0.5, tremor) for number in range(40)])
    inner = [(number, one) for number, one in enumerate(mended) if one is not None][2:-1]
    errors = np.array([one.pan_rad - tremor(number) for number, one in inner])
    sigmas = np.sqrt([one.covariance[0, 0] for _, one in inner])
    assert 0.3 < np.sqrt(np.mean(errors**2) / np.mean(sigmas**2)) < 3.0
    assert np.sqrt(np.mean(errors**2)) < 0.3 * 1e-3 * 0.25  # a blend would be a quarter of a frame late


def test_a_steady_course_is_as_sure_as_its_frames() -> None:
    mended = by_both_fields([frame(number, 0.3, np.polynomial.Polynomial([0.3, 0.01])) for number in range(8)])
    for one in mended[1:]:
        assert one is not None
        np.testing.assert_allclose(one.covariance, SIGMA**2 * np.eye(2), atol=1e-20)


def test_whole_frames_and_those_without_a_neighbour_stay() -> None:
    whole = [replace(frame(number, 0.3), second_field=np.zeros(0)) for number in range(4)]
    assert by_both_fields(whole) == whole
    alone = [None, frame(1, 0.3), None, replace(frame(3, 0.3), valid=False), frame(4, 0.3)]
    assert by_both_fields(alone) == alone


def test_across_half_a_turn() -> None:
    there = np.polynomial.Polynomial([np.pi - 0.02, 0.01])
    seen = [frame(number, 0.5, there) for number in range(6)]
    seen = [
        replace(one, pan_rad=(one.pan_rad + np.pi) % (2 * np.pi) - np.pi,
                second_field=(one.second_field - [2 * np.pi if one.second_field[0] > np.pi else 0.0, 0.0]))
        for one in seen
    ]  # fmt: skip
    for number, one in enumerate(by_both_fields(seen)):
        if one is not None and number > 0:
            away = (one.pan_rad - there(number) + np.pi) % (2 * np.pi) - np.pi
            assert abs(away) < 1e-9


def test_the_second_field_is_expected_half_a_step_further() -> None:
    before, found = frame(0, 0.0), frame(1, 0.0)
    history = History(Readout(0.0, 0.1, 0.1), Sway(0.0, np.array([1e-6, 4e-6])), (before,), (None,))
    expected = expected_second(history, found)
    assert expected.pan_rad == pytest.approx(found.pan_rad + 0.5 * (found.pan_rad - before.pan_rad))
    assert expected.focal_px == pytest.approx(found.focal_px * (found.focal_px / before.focal_px) ** 0.5)
    np.testing.assert_allclose(expected.sway_sigma, [1e-3, 2e-3])
    assert expected_second(History(Readout(0.0, 0.1, 0.1), Sway(0.0, np.ones(2))), found).pan_rad == pytest.approx(
        found.pan_rad
    )
