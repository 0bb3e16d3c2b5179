"""Direct alignment: derivatives, how far it pulls in, how exact it is, and what a person in the picture does to it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pzcap.calibration.settings import PanZoomConfig
from pzcap.geometry.camera import direction_to_pixel, view_at
from pzcap.geometry.cylinder import from_centre, from_panorama
from pzcap.localisation.alignment_equations import normal_equations
from pzcap.localisation.panorama_sampler import (
    BY_LOG_FOCAL,
    BY_PAN,
    BY_PAN_SHEAR,
    BY_ROLL,
    BY_TILT,
    BY_ZOOM_SHEAR,
    COLUMN,
    KNOWN,
    SAMPLE,
    VALUE,
    PanoramaSampler,
    ViewPlace,
)
from pzcap.localisation.photometric_alignment import Aligner
from pzcap.localisation.tuning import ALIGNMENT, LEVELS
from pzcap.types import Array, InverseDepthMap, Panorama
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of, whole_turn

OPTICS = synthetic.Optics()
FOCAL, TILT = OPTICS.reference_focal_px, OPTICS.tilt_rad
SCALE = 4.0  # grey levels
PIXELS = np.stack(np.meshgrid(np.linspace(20, 300, 15), np.linspace(20, 220, 11)), axis=-1).reshape(-1, 2)


@pytest.fixture(scope="module")
def panorama() -> Panorama:
    """The hall at the resolution of a frame, so that the panorama is no sharper than one of a sweep."""
    whole = whole_turn(0)
    width = round(2 * np.pi * FOCAL)
    scale = width / whole.image.shape[1]
    image = cv2.resize(whole.image, (width, round(whole.image.shape[0] * scale)), interpolation=cv2.INTER_AREA)
    origin = (whole.origin_px + 0.5) * scale - 0.5
    return replace(
        whole, image=image, valid=np.ones(image.shape[:2], bool), px_per_rad=width / (2 * np.pi), origin_px=origin
    )


@pytest.fixture(scope="module")
def aligner(panorama: Panorama) -> Aligner:
    return Aligner(panorama, camera_of(OPTICS))


@pytest.fixture(scope="module")
def sampler(panorama: Panorama) -> PanoramaSampler:
    return PanoramaSampler(panorama, camera_of(OPTICS), 4000)


HALL = InverseDepthMap(1.7, np.linspace(0.05, 0.6, 12), np.linspace(0, 0.1, 24).reshape(2, 12), np.array([-0.4, 0.3]))


def finest(sampler: PanoramaSampler, at: ViewPlace) -> Array:
    """What the panorama shows at PIXELS."""
    return sampler.sample(sampler.levels[-1], sampler.rays(PIXELS, at), at)


def test_the_levels_go_from_coarse_to_fine() -> None:
    assert [level.halvings for level in LEVELS] == sorted({level.halvings for level in LEVELS}, reverse=True)
    assert [level.reach_px for level in LEVELS] == sorted({level.reach_px for level in LEVELS}, reverse=True)


def test_samples_stand_where_the_camera_looks(panorama: Panorama) -> None:
    """The compiled loop against `camera.direction_to_pixel` and `cylinder.from_centre`, parallax and the seam
    included."""
    camera = replace(camera_of(OPTICS), offset_m=np.array([0.005, -0.003]), travel_m=0.004)
    panorama = replace(panorama, surroundings=HALL)
    beside = PanoramaSampler(panorama, camera, 4000)
    for pan in (-3.0, 0.2, 3.1):
        sampled = finest(beside, ViewPlace(pan, camera.tilt_rad, 500.0))
        view = view_at(camera, pan, camera.tilt_rad, 500.0)
        azimuth, slope = from_panorama(panorama, beside.panorama_px(sampled))
        seen, _ = direction_to_pixel(view, *from_centre(panorama, view, azimuth, slope))
        np.testing.assert_allclose(seen, PIXELS, atol=0.005)  # parallax is a pixel, and known to its second order


def test_rays_may_be_taken_as_straight_so_near(sampler: PanoramaSampler) -> None:
    there, layer, linear = ViewPlace(0.2, OPTICS.tilt_rad, 500.0), sampler.levels[-1], ALIGNMENT.linear
    rays = sampler.rays(PIXELS, there)
    assert not rays.far_from(there)
    for by_tilt, by_focal in ((linear, 0.0), (0.0, -linear), (linear, linear)):
        moved = ViewPlace(0.2, there.tilt_rad + by_tilt, there.focal_px * np.exp(by_focal))
        assert rays.far_from(ViewPlace(0.2, there.tilt_rad + 1.01 * by_tilt, 500.0 * np.exp(1.01 * by_focal)))
        straight, exact = sampler.sample(layer, rays, moved), finest(sampler, moved)
        np.testing.assert_allclose(straight[:, COLUMN:], exact[:, COLUMN:], atol=1e-3)


def test_derivatives_match_finite_differences() -> None:
    """On a panorama so smooth that differences of neighbouring pixels are its derivatives."""
    whole = whole_turn(0)
    row, column = np.mgrid[: whole.image.shape[0], : whole.image.shape[1]]
    waves = 127 + 60 * np.sin(column / 9.0) + 60 * np.cos(row / 7.0 + column / 40.0)
    smooth = replace(whole, image=np.repeat(np.rint(waves).astype(np.uint8)[..., None], 3, axis=2))
    sampler = PanoramaSampler(smooth, camera_of(OPTICS), 4000)
    there, step = ViewPlace(0.3, OPTICS.tilt_rad, 600.0, 0.002, 0.004, 0.01), 2e-3
    here = finest(sampler, there)
    for column, along in (
        (BY_PAN, 0),
        (BY_LOG_FOCAL, 1),
        (BY_TILT, 2),
        (BY_ROLL, 3),
        (BY_PAN_SHEAR, 4),
        (BY_ZOOM_SHEAR, 5),
    ):
        there_and_back = [finest(sampler, there.stepped(sign * step * np.eye(6)[along], 0.1)) for sign in (1.0, -1.0)]
        numeric = there_and_back[0] - there_and_back[1]
        numeric_grey = numeric[:, VALUE] / (2 * step)
        assert np.corrcoef(here[:, column], numeric_grey)[0, 1] > 0.99
        assert np.polyfit(numeric_grey, here[:, column], 1)[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("pan", "zoom"), [(0.3, 1.0), (-3.13, 0.75), (1.5, 2.4)])
def test_pulls_in_from_the_frame_before(aligner: Aligner, pan: float, zoom: float) -> None:
    focal = FOCAL * zoom
    image = synthetic.render(OPTICS, pan, focal, gain=0.9)
    found = aligner.align(image, ViewPlace(pan + 6.0 / FOCAL, TILT, focal * 1.02), 15.0)
    assert np.rad2deg(found.at.pan_rad - pan) == pytest.approx(0.0, abs=0.005)
    assert found.at.focal_px == pytest.approx(focal, rel=5e-4)
    assert found.agreement > 0.7
    assert found.report.converged


def test_where_a_frame_is_does_not_hang_on_where_it_was_expected(aligner: Aligner) -> None:
    """Most steps are made on some of the pixels, and the last ones are lengthened: they end where all pixels say."""
    image = synthetic.render(OPTICS, 0.3, 1.3 * FOCAL)
    starts = [(off / FOCAL, 1.3 * FOCAL * zoom) for off in (-1.4, 0.0, 0.9) for zoom in (0.998, 1.001)]
    found = [aligner.align(image, ViewPlace(0.3 + off, TILT, focal), 1.5) for off, focal in starts]
    assert all(each.report.converged for each in found)
    assert np.ptp([each.at.pan_rad for each in found]) * 1.3 * FOCAL < 0.01  # pixels
    assert np.ptp([np.log(each.at.focal_px) for each in found]) * OPTICS.width / 2 < 0.01


@pytest.mark.parametrize("focal", [FOCAL, 3.0 * FOCAL, 4.8 * FOCAL])
def test_a_fit_is_not_at_rest_before_its_vignetting_is(aligner: Aligner, focal: float) -> None:
    """Where it is right from the first step on, corners that are still too dark would pass for what does not fit."""
    for pan in np.arange(-2.5, 3.0, 0.5):
        dark = synthetic.render(replace(OPTICS, vignetting=0.4), pan, focal)
        even = synthetic.render(replace(OPTICS, vignetting=0.0), pan, focal)
        expected = aligner.align(even, ViewPlace(pan, TILT, focal), 1.5).agreement
        assert aligner.align(dark, ViewPlace(pan, TILT, focal), 1.5).agreement > expected - 0.03


def weighed(seed: int, unknown: int) -> tuple[Array, Array, Array, Array, Array, float]:
    """(rows, residual, weights, normal, gradient, flatness) of 500 pixels; pan, focal and two gains are fitted."""
    rng = np.random.default_rng(seed)
    sampled, shading = rng.normal(0.0, 1.0, (500, SAMPLE)), rng.normal(0.0, 1.0, (500, 2))
    sampled[:, KNOWN] = np.arange(500) >= unknown
    brightness, residual = rng.uniform(0.5, 1.5, 500), rng.normal(0.0, 1.0, 500)
    weights, normal, gradient, flatness = normal_equations(sampled, shading, brightness, residual, SCALE, 2)
    rows = np.column_stack([brightness[:, None] * sampled[:, BY_PAN : BY_PAN + 2], shading * sampled[:, [VALUE]]])
    return rows, residual, weights, normal, gradient, flatness


def test_normal_equations_are_those_of_geman_and_mcclure() -> None:
    rows, residual, weights, normal, gradient, _ = weighed(0, unknown=100)
    assert not weights[:100].any()
    np.testing.assert_allclose(weights[100:], 1.0 / (1.0 + (residual[100:] / SCALE) ** 2) ** 2)
    np.testing.assert_allclose(normal, rows.T @ (weights[:, None] * rows), atol=1e-9)
    np.testing.assert_allclose(gradient, -rows.T @ (weights * residual), atol=1e-9)


def test_steps_are_lengthened_by_what_falling_weights_hide_of_the_curvature() -> None:
    _, residual, weights, _, _, flatness = weighed(1, unknown=0)

    def slope(shift: float) -> float:
        moved = residual + shift
        return float(np.sum(moved / (1.0 + (moved / SCALE) ** 2) ** 2))

    curvature = (slope(1e-4) - slope(-1e-4)) / 2e-4
    assert flatness * np.sum(weights) == pytest.approx(curvature, rel=1e-5)


def test_a_fit_that_was_stopped_on_its_way_says_so(aligner: Aligner) -> None:
    """A fast pan smears all edges: grey values agree from pixels away, and the steps towards the place are short."""
    smeared = np.asarray(cv2.blur(synthetic.render(OPTICS, 0.3, 2 * FOCAL), (11, 1)), np.uint8)
    found = [
        aligner.align(smeared, ViewPlace(0.3 + off / FOCAL, TILT, 2 * FOCAL), 4.0)
        for off in np.linspace(-14.0, 14.0, 15)
    ]
    off_px = np.array([abs(each.at.pan_rad - 0.3) * FOCAL for each in found])
    settled = np.array([each.report.converged for each in found])
    sure = np.array([each.agreement > PanZoomConfig().sure_agreement for each in found])
    assert settled.any()
    assert off_px[settled].max() < 0.1
    assert off_px[~settled].max() > 0.5
    assert off_px[~settled & sure].max() > 0.4  # by their grey values alone these would count


def test_a_person_with_a_shadow_is_left_out(aligner: Aligner) -> None:
    image = synthetic.render(OPTICS, 0.3, FOCAL)
    image[50:220, 130:200] = np.random.default_rng(0).integers(0, 255, (170, 70, 3))
    image[200:230, 100:240] = image[200:230, 100:240] // 2
    found = aligner.align(image, ViewPlace(0.3 + 3.0 / FOCAL, TILT, FOCAL * 1.01), 15.0)
    assert np.rad2deg(found.at.pan_rad - 0.3) == pytest.approx(0.0, abs=0.01)
    assert found.at.focal_px == pytest.approx(FOCAL, rel=1e-3)
    inside = (np.abs(found.frame_points_px - (165, 135)) < (33, 83)).all(axis=1)
    assert inside.mean() < 0.1


@pytest.mark.parametrize("brighter", [1.9, 0.35])
def test_what_covers_a_third_of_a_view_does_not_set_its_gain(aligner: Aligner, brighter: float) -> None:
    """A stack of mats that was not there in the sweep: all of it brighter than the hall, or all darker."""
    image = synthetic.render(OPTICS, 0.3, FOCAL)
    mats = synthetic.render(OPTICS, -1.9, FOCAL)[:, :112].astype(float)
    image[:, 208:] = np.clip(brighter * mats + (60.0 if brighter > 1.0 else 0.0), 0, 255).astype(np.uint8)
    for off_px in (1.5, 15.0):
        found = aligner.align(image, ViewPlace(0.3 + 1.0 / FOCAL, TILT, FOCAL), off_px)
        assert np.rad2deg(found.at.pan_rad - 0.3) == pytest.approx(0.0, abs=0.01)
        assert found.agreement > 0.6
        assert found.report.converged


def test_the_wrong_place_does_not_agree(aligner: Aligner) -> None:
    image = synthetic.render(OPTICS, 0.3, FOCAL)
    for pan in (1.3, -2.0, 0.9):
        assert aligner.align(image, ViewPlace(pan, TILT, FOCAL), 15.0).agreement < 0.4


def test_a_fit_that_has_diverged_ends(aligner: Aligner) -> None:
    """On footage of somewhere else the focal length may go anywhere, and no frame is made finer without end."""
    image = synthetic.render(OPTICS, 0.3, FOCAL)
    for focal_px in (1.0, np.nan):
        assert aligner.align(image, ViewPlace(0.3, TILT, focal_px), 1.0).agreement == 0.0


def test_where_nothing_is_known_nothing_agrees(panorama: Panorama) -> None:
    nothing = Aligner(replace(panorama, valid=np.zeros_like(panorama.valid)), camera_of(OPTICS))
    found = nothing.align(synthetic.render(OPTICS, 0.3, FOCAL), ViewPlace(0.3, TILT, FOCAL), 15.0)
    assert found.agreement == 0.0
    assert found.at.pan_rad == 0.3
    assert len(found.frame_points_px) == 0
    assert np.isfinite(found.covariance).all()


def test_the_covariance_is_of_the_size_of_the_errors(aligner: Aligner) -> None:
    errors, sigmas = [], []
    for seed in range(8):
        image = synthetic.render(OPTICS, 0.3, FOCAL, noise_seed=seed)
        found = aligner.align(image, ViewPlace(0.3, TILT, FOCAL), 1.5)
        errors.append(found.at.pan_rad)
        sigmas.append(np.sqrt(found.covariance[0, 0]))
    assert 0.1 < np.std(errors) / np.mean(sigmas) < 10.0


def test_pixels_that_err_alike_are_told_from_those_that_do_not(aligner: Aligner) -> None:
    """By noise of a pixel each, and by noise that is the same over a few hundred: the clustered covariance says how far
    frames are off by either, what takes pixels for independent does not."""
    pans = np.linspace(-2.0, 2.0, 12)
    clean = [synthetic.render(OPTICS, pan, FOCAL).astype(np.float64) for pan in pans]
    rng, ratio = np.random.default_rng(0), {}
    for alike in (False, True):
        off, clustered, single = [], [], []
        for pan, picture in zip(pans.tolist(), clean, strict=True):
            noise = rng.normal(0.0, 1.0, picture.shape[:2])
            if alike:
                noise = cv2.GaussianBlur(noise, (0, 0), 6.0)
            image = np.clip(picture + (8.0 * noise / noise.std())[..., None], 0, 255).astype(np.uint8)
            found = aligner.align(image, ViewPlace(pan, TILT, FOCAL), 1.5)
            off.append([found.at.pan_rad - pan, np.log(found.at.focal_px / FOCAL)])
            clustered.append(found.clustered.diagonal())
            single.append(found.covariance.diagonal()[:2])
        spread = np.mean(np.square(off), axis=0)
        ratio[alike] = spread / np.mean(clustered, axis=0), spread / np.mean(single, axis=0)
    assert all(np.all((one[0] > 0.4) & (one[0] < 2.5)) for one in ratio.values()), ratio
    assert np.max(ratio[True][1]) > 3.0, ratio
