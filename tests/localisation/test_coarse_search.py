"""Frames found by correlation: the panorama is the synthetic hall itself, so nothing but the search can fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.geometry.camera import wrapped
from pzcap.localisation.coarse_search import Correlator
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
