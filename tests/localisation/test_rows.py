"""Rows of a frame that are not exposed at once: their places, their light, and the read-out that follows."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.calibration.calibrate import CalibratedCamera, Footage
from pzcap.calibration.stitching import Brightness, SweptFrames, ZoomedFrames
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import wrapped
from pzcap.imaging import row_bands
from pzcap.imaging.row_bands import row_time
from pzcap.localisation.frame_prior import FramePrior
from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.localisation.photometric_alignment import Aligner
from pzcap.localisation.readout import History, Readout, Sway
from pzcap.localisation.rectification import is_sheared, rectified, rectified_points
from pzcap.localisation.sweep_readout import (
    Remaining,
    Still,
    evenly_lit,
    in_sweep,
    in_zoom_run,
    put_right,
    still_of,
)
from pzcap.localisation.tuning import READOUT
from pzcap.types import Array, Image, Localisation, Panorama, ReferenceCamera
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of, whole_turn

OPTICS = synthetic.Optics()
CAMERA = camera_of(OPTICS)
FOCAL, HEIGHT = OPTICS.reference_focal_px, OPTICS.height
ZOOMING = replace(CAMERA, lens=replace(CAMERA.lens, k1=np.array([-0.06, 0.07])))
"""The lens bends less as it zooms."""


def found(pan_rad: float, shear: Array, shear_sigma: Array, focal_px: float = FOCAL) -> Localisation:
    nothing = np.empty((0, 2))
    return Localisation(
        pan_rad, OPTICS.tilt_rad, focal_px, 1e-10 * np.eye(2), True, nothing, nothing,
        sway_sigma=np.full(2, 1e-5), shear=shear, shear_sigma=shear_sigma,
    )  # fmt: skip


def rolled(pan_rad: float, focal_px: float, shear: Array) -> Image:
    """A frame each row of which is rendered by the camera of its own time, from a stack of whole frames."""
    times = np.linspace(-0.5, 0.5, 25)
    stack = [synthetic.render(OPTICS, pan_rad + shear[0] * t, focal_px * np.exp(shear[1] * t)) for t in times]
    rows = row_time(np.arange(float(HEIGHT)), HEIGHT)
    near = np.clip(np.searchsorted(times, rows) - 1, 0, len(times) - 2)
    share = ((rows - times[near]) * (len(times) - 1))[:, None, None]
    first = np.array([stack[k][v] for v, k in enumerate(near)], np.float64)
    second = np.array([stack[k + 1][v] for v, k in enumerate(near)], np.float64)
    return np.rint(first + share * (second - first)).astype(np.uint8)


@pytest.fixture(scope="module")
def panorama() -> Panorama:
    return whole_turn(0)


@pytest.fixture(scope="module")
def sheared() -> Image:
    return rolled(0.3, 1.3 * FOCAL, np.array([0.006, 0.004]))


def test_a_frame_shows_its_shear(panorama: Panorama, sheared: Image) -> None:
    """Pan and focal length are those of the middle row; taken for a frame without shear they are off."""
    aligner, start = Aligner(panorama, CAMERA), ViewPlace(0.3, OPTICS.tilt_rad, 1.3 * FOCAL)
    free = aligner.align(sheared, start, 1.5, None, FramePrior(start, 1e-3, 1e-3, 0.02, 0.02)).at
    held = aligner.align(sheared, start, 1.5).at
    assert free.pan_shear_rad == pytest.approx(0.006, abs=1.5e-4)
    assert free.zoom_shear == pytest.approx(0.004, abs=4e-4)
    assert abs(free.pan_rad - 0.3) < 5e-5
    assert abs(held.pan_rad - 0.3) > 2 * abs(free.pan_rad - 0.3)


def test_a_rectified_frame_is_the_one_that_is_exposed_at_once(sheared: Image) -> None:
    where = found(0.3, np.array([0.006, 0.004]), np.ones(2), 1.3 * FOCAL)
    whole = synthetic.render(OPTICS, 0.3, 1.3 * FOCAL).astype(np.float64)
    inner = np.s_[10:-10, 10:-10]
    off = [np.abs(one.astype(np.float64) - whole)[inner].mean() for one in (sheared, rectified(sheared, CAMERA, where))]
    assert off[1] < 0.5 * off[0]  # what is left is the resampling


@settings(deadline=None)
@given(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.integers(0, 2**31))
def test_rectified_points_are_seen_from_the_middle_of_the_read_out(pan: float, zoom: float, seed: int) -> None:
    """A direction seen by the camera of its row's time, found by iteration, stands where the middle row's sees it."""
    where, rng = found(0.2, np.array([pan, zoom]), np.ones(2)), np.random.default_rng(seed)
    there = rng.uniform([30, 30], [OPTICS.width - 30, HEIGHT - 30], (20, 2))
    view = geometry.view_at(ZOOMING, 0.2, OPTICS.tilt_rad, FOCAL)
    direction = geometry.pixel_to_direction(view, there)
    exposed = there.copy()
    for _ in range(6):
        for n, time in enumerate(row_time(exposed[:, 1], HEIGHT).tolist()):
            own = geometry.view_at(ZOOMING, 0.2 + pan * time, OPTICS.tilt_rad, FOCAL * float(np.exp(zoom * time)))
            exposed[n] = geometry.direction_to_pixel(own, direction[0][n], direction[1][n])[0]
    np.testing.assert_allclose(rectified_points(exposed, ZOOMING, where), there, atol=0.005)


def test_only_what_is_displaced_is_put_right() -> None:
    assert not is_sheared(CAMERA, found(0.0, np.array([1e-5, 1e-6]), np.ones(2)))
    assert is_sheared(CAMERA, found(0.0, np.array([1e-3, 0.0]), np.ones(2)))


def followed(
    readout: float, sigma: float, seed: int, frames: int = 60, panorama_rad: float = 0.0, swing: float = 0.1,
    alike: int = 1,
) -> Readout:  # fmt: skip
    """The read-out after frames of a camera that is panned to and fro, by ``swing`` radians of its phase a frame, their
    shear known to ``sigma``, and as many ``alike`` in its error; the panorama is sheared itself by ``panorama_rad``."""
    rng, history = np.random.default_rng(seed), History(Readout(0.0, 0.6, 0.6), Sway(OPTICS.tilt_rad, np.full(2, 1e-8)))
    errors = np.repeat(rng.normal(0.0, sigma, (-(-frames // alike), 2)), alike, axis=0)
    for k in range(frames):
        pan, zoom = 0.02 / swing * np.sin(swing * k), 1.0 + 0.1 * np.sin(0.07 * k)
        rate = np.array([0.02 * np.cos(swing * k), 0.007 * np.cos(0.07 * k) / zoom])
        expected = None
        if len(history.seen) > 1:
            before, latest = history.seen[-2:]
            last = latest.pan_rad - before.pan_rad
            zoomed = float(np.log(latest.focal_px / before.focal_px))
            mean, spread = history.readout.shear(np.array([last, zoomed]), np.zeros(2))
            expected = found(0.0, mean, spread)
        shear, spread = readout * rate + errors[k], np.full(2, sigma)
        shear[0] += panorama_rad
        if expected is not None and (expected.shear_sigma > 0.0).all():  # a posterior, as the alignment has it
            information = spread**-2.0 + expected.shear_sigma**-2.0
            shear = (spread**-2.0 * shear + expected.shear_sigma**-2.0 * expected.shear) / information
            spread = information**-0.5
        history = history.followed_by(found(pan, shear, spread, FOCAL * zoom), expected)
    return history.readout


@pytest.mark.parametrize("swing", [0.1, 0.35])  # half a hertz, and 1.7 Hz, at 30 frames a second
def test_a_camera_that_swings_fast_has_the_same_read_out(swing: float) -> None:
    found = [followed(0.5, 5e-5, seed, swing=swing).share for seed in range(6)]
    assert np.mean(found) == pytest.approx(0.5, abs=0.0015)


@pytest.mark.parametrize("readout", [-0.7, 0.0, 0.5])
def test_the_read_out_is_found_with_its_sign_and_a_sigma_that_holds(readout: float) -> None:
    ratios = []
    for seed in range(12):
        estimate = followed(readout, 2e-4, seed)
        assert estimate.share == pytest.approx(readout, abs=0.03)  # three times what is sure
        ratios.append((estimate.share - readout) / estimate.sigma)
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_frames_that_err_alike_are_not_counted_one_by_one() -> None:
    found = [followed(0.5, 2e-4, seed, alike=16) for seed in range(12)]
    boast, claim = (
        np.sqrt(np.mean([((one.share - 0.5) / sigma) ** 2 for one, sigma in zip(found, sigmas, strict=True)]))
        for sigmas in ([one.sigma for one in found], [one.deviation for one in found])
    )
    assert boast > 2.0
    assert 0.3 < claim < 1.5


def test_a_sheared_panorama_is_no_read_out() -> None:
    """A camera that turns one way, slowly, cannot tell them apart; one that turns to and fro can."""
    once = [followed(0.3, 5e-5, seed, frames=12, panorama_rad=2e-4) for seed in range(6)]
    both = [followed(0.3, 5e-5, seed, frames=70, panorama_rad=2e-4) for seed in range(6)]
    assert all(abs(one.share - 0.3) < 3.0 * one.sigma for one in (*once, *both))
    assert np.mean([one.sigma for one in both]) < 0.5 * np.mean([one.sigma for one in once])
    assert np.mean([one.panorama[0] for one in both]) == pytest.approx(2e-4, rel=0.5)


def test_sway_is_forgotten_while_the_head_stands_and_found_again_when_it_moves() -> None:
    sway = Sway(OPTICS.tilt_rad, np.full(2, np.deg2rad(0.03) ** 2))
    still = found(0.0, np.zeros(2), np.ones(2))
    for _ in range(60):
        sway = sway.updated(still)
    assert (np.sqrt(sway.variance) < np.deg2rad(0.003)).all()
    bumped = Localisation(
        0.0, OPTICS.tilt_rad + np.deg2rad(0.05), FOCAL, np.eye(2), True, np.empty((0, 2)), np.empty((0, 2)),
        sway_sigma=np.full(2, 1e-5),
    )  # fmt: skip
    assert np.sqrt(sway.updated(bumped).variance[0]) > np.deg2rad(0.015)


# --------------------------------------------------------------------------------------------------------------
# Light


def test_a_banded_frame_is_aligned_and_evened(panorama: Panorama) -> None:
    image, time = synthetic.render(OPTICS, 0.3, FOCAL), row_time(np.arange(float(HEIGHT)), HEIGHT)
    gain = 0.75 * (1.0 + 0.3 * np.sin(2 * np.pi * 1.6 * time + 0.7))
    banded = np.rint(image * gain[:, None, None]).astype(np.uint8)
    start = ViewPlace(0.3 + 1.0 / FOCAL, OPTICS.tilt_rad, FOCAL)
    aligner = Aligner(panorama, CAMERA)
    aligned, even = aligner.align(banded, start, 1.5), aligner.align(image, start, 1.5)
    assert aligned.bands.size
    assert not even.bands.size
    assert aligned.agreement > even.agreement - 0.05
    assert abs(aligned.at.pan_rad - even.at.pan_rad) * FOCAL < 0.05
    evened = row_bands.without_bands(banded, aligned.bands).astype(np.float64)
    level = evened.mean(axis=(1, 2)) / np.maximum(image.mean(axis=(1, 2)), 1.0)
    assert np.std(level[20:-20]) / np.mean(level) < 0.03


def test_bands_of_sweep_reference_and_zoom_run_are_divided_out() -> None:
    """Of those frames that were used; the others stay as they are."""
    image = synthetic.render(OPTICS, 0.3, FOCAL)
    time, rng = row_time(np.arange(float(HEIGHT)), HEIGHT), np.random.default_rng(3)
    bands = 0.05 * rng.normal(size=(6, 4))

    def banded(number: int) -> Image:
        return np.rint(0.75 * image * row_bands.gain(bands[number], time)[:, None, None]).astype(np.uint8)

    kept, zoomed = np.array([0, 2, 3]), np.array([1, 4])
    sweep = [(0, banded(0)), (1, image), (2, banded(1)), (3, banded(2))]
    zoom = [(0, image), (1, banded(4)), (4, banded(5))]
    footage = Footage(banded(3), synthetic.calibration_object(), sweep, zoom, False)
    even, dim = evenly_lit(footage, bands, kept, zoomed), np.rint(0.75 * image)
    assert even.zoom is not None
    for number, frame in even.sweep:
        assert np.abs(frame - (dim if number in kept else image.astype(float))).max() <= 2.0
    for number, frame in even.zoom:
        assert np.abs(frame - (dim if number in zoomed else image.astype(float))).max() <= 2.0
    assert np.abs(even.reference_image - dim).max() <= 2.0


def test_footage_in_steady_light_is_left_as_it_is() -> None:
    footage = Footage(np.zeros((HEIGHT, 4, 3), np.uint8), None, [], None, False)
    assert evenly_lit(footage, np.zeros((6, 0)), np.arange(3), np.arange(2)) is footage


# --------------------------------------------------------------------------------------------------------------
# What a picture by a camera at rest tells of the sweep


def swept_at(panorama: Panorama, step_rad: float) -> tuple[CalibratedCamera, SweptFrames]:
    """A sweep of the whole turn in steps of ``step_rad``."""
    pan_rad = np.arange(0.0, 2 * np.pi, abs(step_rad)) * np.sign(step_rad)
    taken = geometry.at(CAMERA, 0.0, OPTICS.tilt_rad, FOCAL)
    reference = ReferenceCamera(taken, np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)))
    found = CalibratedCamera(reference, replace(panorama, sweep_pan_rad=wrapped(pan_rad)), CAMERA)
    view = geometry.view_at(CAMERA, 0.0, OPTICS.tilt_rad, FOCAL)
    return found, SweptFrames((), np.arange(len(pan_rad)), cast(Brightness, None), view)


@pytest.mark.parametrize("step_rad", [0.06, -0.04])
def test_a_picture_at_rest_shows_the_read_out_of_the_sweep(panorama: Panorama, sheared: Image, step_rad: float) -> None:
    """A frame that is sheared before a panorama that is not is as one that is not before one that is, the other way."""
    found, swept = swept_at(panorama, step_rad)
    still = Still(sheared, ViewPlace(0.3, OPTICS.tilt_rad, 1.3 * FOCAL), False)
    remaining = in_sweep(still, found, swept)
    assert remaining.share == pytest.approx(-0.006 / step_rad, rel=0.03)
    assert remaining.sigma == pytest.approx(READOUT.least_shear_rad / abs(step_rad), rel=0.2)
    assert remaining.matters
    upright = Still(synthetic.render(OPTICS, 0.3, FOCAL), ViewPlace(0.3, OPTICS.tilt_rad, FOCAL), False)
    assert not in_sweep(upright, found, swept).matters
    elsewhere = Still(synthetic.render(OPTICS, 2.0, FOCAL), ViewPlace(0.3, OPTICS.tilt_rad, FOCAL), False)
    assert in_sweep(elsewhere, found, swept) == Remaining(0.0, 0.0)  # and not surely none


def test_a_lens_that_zooms_meanwhile_is_not_taken_for_a_sheared_sweep(panorama: Panorama) -> None:
    """Rows that differ in focal length shift what is seen beside the middle as rows that differ in pan do."""
    found, swept = swept_at(panorama, 0.04)
    picture = rolled(0.3, FOCAL, np.array([0.0, 0.02]))
    place = ViewPlace(0.3, OPTICS.tilt_rad, FOCAL)
    assert not in_sweep(Still(picture, place, True), found, swept).matters
    assert in_sweep(Still(picture, place, False), found, swept).matters


def test_a_zoom_run_shows_the_read_out_that_is_left(panorama: Panorama) -> None:
    found, _ = swept_at(panorama, 0.1)
    log_focal = np.log(FOCAL) + 0.05 * np.arange(13)
    zoomed = ZoomedFrames(np.arange(10, 23), log_focal, 0.3)
    frames = [
        (int(number), rolled(0.3, float(np.exp(x)), np.array([0.0, 0.05 * 0.04])))
        for number, x in zip(zoomed.numbers, log_focal, strict=True)
    ]
    remaining = in_zoom_run([(0, frames[0][1]), *frames], found, zoomed)
    assert remaining is not None
    assert remaining.share == pytest.approx(0.04, abs=3.0 * remaining.sigma)
    assert remaining.matters
    assert in_zoom_run(frames[:5], found, zoomed) is None
    assert in_zoom_run([], found, ZoomedFrames(np.zeros(0, np.int64), np.zeros(0), 0.0)) is None


def test_sweep_and_zoom_run_count_by_their_variances_unless_they_contradict_each_other() -> None:
    sweep = Remaining(0.002, 0.002)
    both = sweep.with_other(Remaining(0.004, 0.001))
    assert (both.share, both.sigma) == (pytest.approx(0.0036), pytest.approx(0.002 / 5**0.5))
    assert sweep.with_other(Remaining(0.08, 0.001)) is sweep
    assert not Remaining(0.0, 0.0).matters
    assert Remaining(0.0, 0.0).with_other(sweep) is sweep


def test_without_an_object_a_frame_of_the_zoom_run_is_the_one_at_rest(panorama: Panorama) -> None:
    found, swept = swept_at(panorama, 0.1)
    pictures = [(number, np.full((HEIGHT, OPTICS.width, 3), number, np.uint8)) for number in range(60)]
    zoomed = ZoomedFrames(np.array([3, 7, 20]), np.log(FOCAL * np.array([0.8, 1.02, 1.5])), 0.4)
    footage = Footage(pictures[0][1], synthetic.calibration_object(), pictures, pictures, True)
    with_object = still_of(footage, found, zoomed)
    assert with_object is not None
    assert (with_object.image[0, 0, 0], with_object.at.pan_rad, with_object.at.focal_px) == (0, 0.0, FOCAL)
    assert not with_object.zooms
    without = footage._replace(calibration_object=None)
    at_rest = still_of(without, found, zoomed)
    assert at_rest is not None
    assert (at_rest.image[0, 0, 0], at_rest.at.pan_rad, at_rest.zooms) == (7, 0.4, True)
    assert at_rest.at.focal_px == pytest.approx(1.02 * FOCAL)
    assert still_of(without._replace(zoom=None), found, zoomed) is None
    assert still_of(without, found, ZoomedFrames(np.zeros(0, np.int64), np.zeros(0), 0.0)) is None
    kept = put_right(footage, 0.05, found, swept, zoomed)
    np.testing.assert_array_equal(kept.reference_image, footage.reference_image)
    marked = pictures[0][1].copy()
    marked[:, 100:] = 200
    rolling = without._replace(reference_image=marked, sweep=[(0, marked), *pictures[1:]])
    turned = put_right(rolling, 0.05, found, swept, zoomed)
    np.testing.assert_array_equal(turned.reference_image, next(iter(turned.sweep))[1])
    assert (turned.reference_image != marked).any()
