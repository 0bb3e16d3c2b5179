"""Frames found by correlation: the panorama is the synthetic hall itself, so nothing but the search can fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.geometry.camera import wrapped
from pzcap.localisation.coarse_search import Correlator, _correlation
from pzcap.localisation.tuning import SEARCH
from pzcap.types import Array
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of, whole_turn

OPTICS = synthetic.Optics()
FOCAL = OPTICS.reference_focal_px
CORRELATOR = Correlator(whole_turn(0), camera_of(OPTICS), (0.5 * FOCAL, 5.0 * FOCAL))


def off_px(pan_rad: Array | float, truth_rad: float, focal_px: float) -> float:
    """Pixels of the frame by which a pan is off."""
    return abs(float(wrapped(pan_rad - truth_rad))) * focal_px


@settings(deadline=None, max_examples=30)
@given(st.floats(-np.pi, np.pi), st.floats(np.log(0.55), np.log(4.8)))
def test_the_likeliest_place_is_the_right_one(pan: float, log_zoom: float) -> None:
    """Anywhere, on the seam as well, at any zoom: to a fortieth of the width, within reach of the alignment."""
    focal = FOCAL * float(np.exp(log_zoom))
    found = CORRELATOR.places(synthetic.render(OPTICS, pan, focal, gain=1.2, noise_seed=3))
    assert off_px(found[0].pan_rad, pan, focal) < OPTICS.width / 40
    assert abs(np.log(found[0].focal_px / focal)) < 1.5 * SEARCH.zoom_step
    assert found[0].tilt_rad == pytest.approx(OPTICS.tilt_rad)


@settings(deadline=None, max_examples=30)
@given(st.floats(-np.pi, np.pi), st.floats(np.log(0.7), np.log(3.0)), st.floats(0.0, 2.0 * np.pi))
def test_bands_of_mains_light_are_no_likeness(pan: float, log_zoom: float, phase: float) -> None:
    """Those of lamps at 100 Hz in a frame that is read in 16 ms."""
    focal = FOCAL * float(np.exp(log_zoom))
    image = synthetic.render(OPTICS, pan, focal, noise_seed=3)
    row = np.arange(OPTICS.height)[:, None, None] / OPTICS.height
    banded = np.clip(image * (1.0 + 0.5 * np.sin(2.0 * np.pi * 1.6 * row + phase)), 0, 255).astype(np.uint8)
    found = CORRELATOR.places(banded)
    assert off_px(found[0].pan_rad, pan, focal) < OPTICS.width / 40


def test_the_correlation_is_that_of_each_part_by_itself() -> None:
    rng = np.random.default_rng(4)
    within = rng.uniform(0.0, 255.0, (13, 29)).astype(np.float32)
    seen = (within[3:10, 8:19] + rng.normal(0.0, 20.0, (7, 11))).astype(np.float32)
    found = _correlation(within, seen)
    assert found.shape == (7, 19)
    own = seen - seen.mean(axis=1, keepdims=True)
    for top, left in np.ndindex(found.shape):
        part = within[top : top + 7, left : left + 11].astype(np.float64)
        part -= part.mean(axis=1, keepdims=True)
        expected = np.sum(part * own) / np.sqrt(np.sum(part**2) * np.sum(own**2))
        assert found[top, left] == pytest.approx(expected, abs=1e-4)
    lifted = within + rng.uniform(-50.0, 50.0, (13, 1)).astype(np.float32)
    np.testing.assert_allclose(_correlation(lifted, seen), found, atol=1e-4)


@pytest.mark.parametrize("pan", [1.0, 2.6])  # the latter within a quarter of a turn of the seam, on both its sides
def test_places_lie_apart_and_the_likeliest_comes_first(pan: float) -> None:
    found = CORRELATOR.places(synthetic.render(OPTICS, pan, 2.0 * FOCAL))
    assert [place.correlation for place in found] == sorted((place.correlation for place in found), reverse=True)
    for k, place in enumerate(found):
        for other in found[:k]:
            assert off_px(place.pan_rad, other.pan_rad, place.focal_px) > OPTICS.width / 8


def test_what_is_nowhere_is_found_nowhere() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (OPTICS.height, OPTICS.width)).astype(np.uint8)
    assert CORRELATOR.places(noise) == []
    assert CORRELATOR.places(np.full_like(noise, 90)) == []


@pytest.mark.parametrize("tilted_deg", [-5.0, 3.0])
def test_a_tilted_frame_is_found_where_tilts_are_free(tilted_deg: float) -> None:
    tilt = OPTICS.tilt_rad + np.deg2rad(tilted_deg)
    image = synthetic.render(replace(OPTICS, tilt_rad=tilt), -2.0, 3.0 * FOCAL)
    free = Correlator(whole_turn(0), camera_of(OPTICS), (0.5 * FOCAL, 5.0 * FOCAL), free_tilt=True)
    found = free.places(image)[0]
    assert off_px(found.pan_rad, -2.0, 3.0 * FOCAL) < OPTICS.width / 40
    assert abs(found.tilt_rad - tilt) * 3.0 * FOCAL < OPTICS.width / 40


def test_a_partial_panorama_has_two_ends() -> None:
    """A frame that looks beyond one is not taken for one at the other."""
    whole = whole_turn(0)
    middle = slice(whole.image.shape[1] // 4, 3 * whole.image.shape[1] // 4)
    part = replace(
        whole, image=whole.image[:, middle], valid=whole.valid[:, middle], full_turn=False,
        origin_px=whole.origin_px - np.array([middle.start, 0]),
    )  # fmt: skip
    correlator = Correlator(part, camera_of(OPTICS), (0.5 * FOCAL, 5.0 * FOCAL))
    within = correlator.places(synthetic.render(OPTICS, 1.0, 2.0 * FOCAL))
    assert off_px(within[0].pan_rad, 1.0, 2.0 * FOCAL) < OPTICS.width / 40
    beyond = correlator.places(synthetic.render(OPTICS, 3.0, 2.0 * FOCAL))
    assert all(place.correlation < 0.7 for place in beyond)
