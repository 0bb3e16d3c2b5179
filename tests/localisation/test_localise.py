"""Pan and zoom of frames: the solvers on made matches, and both methods from pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from pzcap.calibration.calibrate import CalibratedCamera, Footage
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import consensus
from pzcap.camera_set import calibrate_camera
from pzcap.extras.paper import method as paper
from pzcap.geometry.camera import direction_to_pixel, view_at, wrapped
from pzcap.localisation.coarse_search import Correlator
from pzcap.localisation.covariance import systematic
from pzcap.localisation.feature_search import FeatureSearch, panorama_features, solve_eq11
from pzcap.localisation.localise import Localiser
from pzcap.localisation.panorama_sampler import ViewPlace, warp_background
from pzcap.localisation.photometric_alignment import Aligner
from pzcap.localisation.tuning import READOUT
from pzcap.types import Array, Image, PzcapError
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of, whole_turn

OPTICS = synthetic.Optics()
FOCAL = OPTICS.reference_focal_px
pytestmark = pytest.mark.xdist_group("panzoom")  # the prepared camera is made once


@dataclass(frozen=True)
class Material:
    """A reference image, a sweep and a zoom run, and the truth of the latter two."""

    reference: Image
    sweep: list[tuple[int, Image]]
    zoom: list[tuple[int, Image]]
    sweep_pan: Array


@pytest.fixture(scope="module")
def material() -> Material:
    rng = np.random.default_rng(5)
    pans = np.deg2rad(np.arange(-25.0, 345.0, 6.0)) + rng.normal(0, 0.005, 62)
    focals = FOCAL * np.exp(np.linspace(np.log(0.7), np.log(3.0), 14))
    return Material(
        synthetic.render(OPTICS, 0.0, FOCAL, noise_seed=1, with_object=True),
        [(i, synthetic.render(OPTICS, pan, FOCAL, noise_seed=100 + i)) for i, pan in enumerate(pans)],
        [(i, synthetic.render(OPTICS, 0.04, focal, noise_seed=300 + i)) for i, focal in enumerate(focals)],
        pans,
    )


@pytest.fixture(scope="module")
def exact(material: Material) -> CalibratedCamera:
    return calibrate_camera(
        Footage(material.reference, synthetic.calibration_object(), material.sweep, material.zoom, True),
        PanZoomConfig(),
    )


def test_zooms_are_less_sure_where_rows_are_made_of_those_beside_them(
    material: Material, exact: CalibratedCamera
) -> None:
    footage = Footage(material.reference, synthetic.calibration_object(), material.sweep, material.zoom, True)
    fields = calibrate_camera(footage._replace(by_fields=True), PanZoomConfig()).camera
    np.testing.assert_array_equal(fields.lens.k1, exact.camera.lens.k1)
    wider = fields.shared_covariance[:, :, 1, 1] - exact.camera.shared_covariance[:, :, 1, 1]
    assert wider.min() >= 0.0
    sweep, long = (np.argmin(np.abs(fields.shared_zooms - zoom)) for zoom in (1.0, 2.5))
    assert np.sqrt(wider[:, long].mean()) > 3.0 * np.sqrt(wider[:, sweep].mean())  # the travel grows with the zoom
    assert 5e-5 < np.sqrt(wider[:, long].mean()) < 1e-3  # 3 mm of some metres


def test_preparation_finds_the_camera(material: Material, exact: CalibratedCamera) -> None:
    camera, background = exact.camera, exact.panorama
    error = np.rad2deg(background.sweep_pan_rad - material.sweep_pan)
    assert np.sqrt(np.mean(error**2)) < 0.01  # pan 0 is the reference image's
    assert camera.lens.reference_focal_px == pytest.approx(FOCAL, rel=5e-4)
    assert np.rad2deg(camera.tilt_rad) == pytest.approx(-4.0, abs=0.02)
    assert np.rad2deg(camera.roll_rad) == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(camera.lens.principal_px[0], OPTICS.principal_px, atol=0.15)
    np.testing.assert_allclose(camera.world_T_head[:3, 3], 0.0, atol=0.02)
    assert abs(np.rad2deg(background.closure_rad)) < 3.0
    assert background.residual_px < 0.5
    assert (background.sweep_inliers > 50).all()


@pytest.mark.parametrize(("pan_deg", "zoom"), [(3.0, 1.0), (-9.0, 0.72), (140.0, 1.5), (-179.9, 2.0), (60.0, 2.6)])
def test_a_frame_is_found_from_nothing(exact: CalibratedCamera, pan_deg: float, zoom: float) -> None:
    image = synthetic.render(OPTICS, np.deg2rad(pan_deg), FOCAL * zoom, noise_seed=9, gain=0.97)
    found = Localiser(exact.panorama, exact.camera, PanZoomConfig()).localise(image, None)
    assert found.valid
    off = np.rad2deg(wrapped(found.pan_rad - np.deg2rad(pan_deg)))
    assert abs(off) < 0.02
    assert found.focal_px == pytest.approx(FOCAL * zoom, rel=2e-3)
    assert abs(off) < 5 * np.rad2deg(np.sqrt(found.covariance[0, 0]))


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_a_partial_panorama_has_a_view_however_its_azimuths_are_counted(exact: CalibratedCamera, turns: int) -> None:
    """A sweep that has come from behind the camera counts on beyond half a turn; what is predicted does not."""
    whole, camera = exact.panorama, exact.camera
    width = whole.image.shape[1] * 4 // 5
    part = replace(
        whole, image=whole.image[:, :width].copy(), valid=whole.valid[:, :width].copy(), full_turn=False,
        origin_px=whole.origin_px + np.array([turns * whole.image.shape[1], 0.0]),
    )  # fmt: skip
    pan = float(wrapped((whole.origin_px[0] - width / 2) / whole.px_per_rad))
    image = synthetic.render(OPTICS, pan, FOCAL, noise_seed=9)
    at = ViewPlace(pan, camera.tilt_rad, camera.lens.reference_focal_px)
    found = Aligner(part, camera, pixels=2000).align(image, at, 4.0)
    assert found.agreement > 0.8
    assert np.rad2deg(found.at.pan_rad) == pytest.approx(np.rad2deg(pan), abs=0.02)
    seen, known = warp_background(part, camera, at)
    assert known.mean() > 0.9
    np.testing.assert_array_equal(seen, warp_background(whole, camera, at)[0])


def test_a_partial_sweep_to_the_right_counts_from_the_reference_image_too(material: Material) -> None:
    frames = [(number, image) for number, (_, image) in enumerate(material.sweep[12::-1])]
    footage = Footage(material.reference, synthetic.calibration_object(), frames, None, False)
    found = calibrate_camera(footage, PanZoomConfig())
    at = ViewPlace(0.0, found.camera.tilt_rad, found.camera.lens.reference_focal_px)
    aligned = Aligner(found.panorama, found.camera, pixels=2000).align(material.reference, at, 1.5)
    assert np.rad2deg(aligned.at.pan_rad) == pytest.approx(0.0, abs=0.002)
    # no circle tells the focal length better
    error = np.rad2deg(wrapped(found.panorama.sweep_pan_rad - material.sweep_pan[12::-1]))
    np.testing.assert_allclose(error, 0.0, atol=0.1)


@pytest.mark.parametrize("zoom", [0.6, 4.0, 4.8])
def test_frames_far_from_the_sweeps_zoom_are_found_from_nothing(exact: CalibratedCamera, zoom: float) -> None:
    """At four times the sweep's zoom a frame is but eighty pixels of the panorama wide, too few for features."""
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    for pan_deg in np.arange(-150.0, 180.0, 30.0):
        found = localiser.localise(synthetic.render(OPTICS, np.deg2rad(pan_deg), zoom * FOCAL), None)
        assert found.valid, pan_deg
        assert abs(np.rad2deg(wrapped(found.pan_rad - np.deg2rad(pan_deg)))) < 0.02
        assert found.focal_px == pytest.approx(zoom * FOCAL, rel=5e-3)
        assert len(found.frame_points_px) > 0


@pytest.mark.parametrize(("zoom", "covered", "least"), [(3.2, 0.3, 10), (1.0, 0.5, 10)])
def test_someone_in_the_way_does_not_keep_frames_from_being_found(
    exact: CalibratedCamera, zoom: float, covered: float, least: int
) -> None:
    """Of eleven places; the few others must be lost, not wrong."""
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    width = round(OPTICS.width * covered)
    person = np.random.default_rng(2).integers(0, 255, (OPTICS.height, width, 3)).astype(np.uint8)
    located = []
    for k, pan_deg in enumerate(np.arange(-150.0, 180.0, 30.0)):
        image = synthetic.render(OPTICS, np.deg2rad(pan_deg), zoom * FOCAL, noise_seed=1)
        left = 37 * k % (OPTICS.width - width)
        image[:, left : left + width] = person
        found = localiser.localise(image, None)
        located.append(found.valid)
        if found.valid:
            assert abs(np.rad2deg(wrapped(found.pan_rad - np.deg2rad(pan_deg)))) < 0.02
    assert sum(located) >= least


def test_a_first_frame_that_agrees_less_is_found_where_fits_from_near_and_far_meet(
    exact: CalibratedCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As under mains light, or at a zoom that shows what the panorama is too coarse for."""
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    noise = np.random.default_rng(8).normal(0.0, 24.0, (OPTICS.height, OPTICS.width, 3))
    monkeypatch.setattr(FeatureSearch, "candidates", lambda *_: [])
    for pan_rad in (-2.0, 0.5, 1.5):
        image = np.clip(synthetic.render(OPTICS, pan_rad, 1.5 * FOCAL) + noise, 0, 255).astype(np.uint8)
        strict = Localiser(exact.panorama, exact.camera, PanZoomConfig(same_agreement=1.0))
        assert not strict.localise(image, None).valid  # it does not agree well enough to be sure at once
        found = localiser.localise(image, None)
        assert found.valid
        assert abs(np.rad2deg(wrapped(found.pan_rad - pan_rad))) < 0.02


def test_matches_that_the_pixels_do_not_bear_out_do_not_count(exact: CalibratedCamera) -> None:
    """As when a camera is taken for another one that sees the same wall: a third of the picture is where it belongs."""
    image = synthetic.render(OPTICS, 0.5, FOCAL, seed=1)
    third = OPTICS.width // 3
    image[:, :third] = synthetic.render(OPTICS, 0.5, FOCAL)[:, :third]
    assert not Localiser(exact.panorama, exact.camera, PanZoomConfig()).localise(image, None).valid


def test_someone_in_the_picture_is_left_out(exact: CalibratedCamera) -> None:
    """A person with a texture of their own, who stands still in the frame while the camera pans."""
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    person = np.random.default_rng(2).integers(0, 255, (160, 70, 3)).astype(np.uint8)
    prior = None
    for step in range(4):
        pan, focal = np.deg2rad(2.0 * step), FOCAL * 1.1**step
        image = synthetic.render(OPTICS, pan, focal, noise_seed=20 + step)
        image[60:220, 130:200] = person
        prior = localiser.localise(image, prior)
        assert prior.valid
        assert abs(np.rad2deg(prior.pan_rad - pan)) < 0.02
        assert prior.focal_px == pytest.approx(focal, rel=2e-3)
        inside = (np.abs(prior.frame_points_px - (165, 140)) < (30, 75)).all(axis=1)
        assert inside.mean() < 0.05


def test_someone_who_covers_most_of_the_picture_is_left_out_where_they_are_expected(
    exact: CalibratedCamera,
) -> None:
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    before = localiser.localise(synthetic.render(OPTICS, 0.3, 1.5 * FOCAL), None)
    image = synthetic.render(OPTICS, 0.3 + 3.0 / FOCAL, 1.5 * FOCAL, noise_seed=7)
    body = np.zeros(image.shape[:2], bool)
    body[:, image.shape[1] // 4 : -image.shape[1] // 8] = True
    image[body] = np.random.default_rng(3).integers(0, 255, (int(body.sum()), 3))
    found = localiser.localise(image, before, lambda _: body)
    assert found.valid
    assert found.pan_rad == pytest.approx(0.3 + 3.0 / FOCAL, abs=0.3 / FOCAL)
    assert not localiser.localise(image, before).valid
    assert not localiser.localise(image, before, lambda _: ~body).valid


def test_nothing_is_found_in_what_is_all_covered(exact: CalibratedCamera) -> None:
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    before = localiser.localise(synthetic.render(OPTICS, 0.3, FOCAL), None)
    image = np.zeros((OPTICS.height, OPTICS.width, 3), np.uint8)
    assert not localiser.localise(image, before, lambda _: np.ones(image.shape[:2], bool)).valid


def test_a_tilted_frame_is_found_and_followed(exact: CalibratedCamera) -> None:
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig(free_tilt=True))
    prior = None
    for step in range(4):
        pan, tilt = np.deg2rad(1.0 * step), OPTICS.tilt_rad + np.deg2rad(2.0 + 0.3 * step)
        image = synthetic.render(replace(OPTICS, tilt_rad=tilt), pan, 1.5 * FOCAL, noise_seed=40 + step)
        prior = localiser.localise(image, prior)
        assert prior.valid
        assert abs(np.rad2deg(prior.pan_rad - pan)) < 0.02
        assert abs(np.rad2deg(prior.tilt_rad - tilt)) < 0.03
        assert prior.focal_px == pytest.approx(1.5 * FOCAL, rel=2e-3)


def test_a_tilted_frame_is_no_frame_of_a_camera_that_does_not_tilt(exact: CalibratedCamera) -> None:
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    tilted = synthetic.render(replace(OPTICS, tilt_rad=OPTICS.tilt_rad + np.deg2rad(3.0)), 0.1, 1.5 * FOCAL)
    assert not localiser.localise(tilted, None).valid


@pytest.mark.parametrize(("tilt_deg", "roll_deg"), [(0.15, 0.1), (-0.6, 0.5), (1.0, -1.0)])
def test_a_tripod_that_is_kicked_is_followed(exact: CalibratedCamera, tilt_deg: float, roll_deg: float) -> None:
    """Though it stood still until then, so that hardly any sway is believed."""
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    still = localiser.localise(synthetic.render(OPTICS, 0.3, 1.5 * FOCAL, noise_seed=3), None)
    tilt, roll = np.deg2rad((tilt_deg, roll_deg))
    optics = replace(OPTICS, tilt_rad=OPTICS.tilt_rad + tilt, roll_rad=OPTICS.roll_rad + roll)
    kicked = synthetic.render(optics, 0.31, 1.5 * FOCAL, noise_seed=4)
    for before in (None, replace(still, sway_sigma=np.full(2, READOUT.least_sway_rad))):
        found = localiser.localise(kicked, before)
        assert found.valid
        off = found.pan_rad - 0.31, np.log(found.focal_px / (1.5 * FOCAL))
        assert off @ np.linalg.solve(found.covariance, off) < 2 * 9.0
        np.testing.assert_allclose([found.tilt_rad - exact.camera.tilt_rad, found.roll_rad], [tilt, roll], atol=6e-4)


def test_a_fast_pan_is_followed(exact: CalibratedCamera) -> None:
    """Its frames are smeared, and not where they were expected."""
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    sharp = localiser.localise(synthetic.render(OPTICS, 0.3, 2 * FOCAL), None)
    smeared = np.asarray(cv2.blur(synthetic.render(OPTICS, 0.3, 2 * FOCAL), (9, 1)), np.uint8)
    for off_px in (-9.0, -6.0, 6.0, 9.0):
        expected = replace(sharp, pan_rad=0.3 + off_px / FOCAL)
        assert localiser.localise(smeared, expected).pan_rad == pytest.approx(sharp.pan_rad, abs=0.1 / FOCAL)


@pytest.mark.parametrize(("zoom", "noise"), [(0.8, 9.0), (1.0, 13.0), (1.5, 26.0)])
def test_a_noisy_frame_is_followed_without_a_search(
    exact: CalibratedCamera, monkeypatch: pytest.MonkeyPatch, zoom: float, noise: float
) -> None:
    """Noise agrees with nothing, and a search, which takes long, would find the frame where it was expected."""
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    before = localiser.localise(synthetic.render(OPTICS, 0.3, zoom * FOCAL), None)
    image = synthetic.render(OPTICS, 0.3 + 2.0 / FOCAL, zoom * FOCAL)
    image = np.clip(image + np.random.default_rng(8).normal(0.0, noise, image.shape), 0, 255).astype(np.uint8)
    monkeypatch.setattr(Correlator, "places", no_search)
    with pytest.raises(AssertionError, match="searched"):  # it does not agree well enough to be sure at once
        Localiser(exact.panorama, exact.camera, PanZoomConfig(same_agreement=1.0)).localise(image, before)
    found = localiser.localise(image, before)
    assert found.valid
    assert found.pan_rad == pytest.approx(0.3 + 2.0 / FOCAL, abs=0.05 / FOCAL)
    with pytest.raises(AssertionError, match="searched"):  # nor is it taken for where another one was expected
        localiser.localise(image, replace(before, pan_rad=1.0))


def no_search(*_: object) -> None:
    raise AssertionError("it was searched for")


def test_a_jump_is_found_again(exact: CalibratedCamera) -> None:
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    first = localiser.localise(synthetic.render(OPTICS, 0.0, FOCAL), None)
    second = localiser.localise(synthetic.render(OPTICS, 1.5, 1.4 * FOCAL), first)
    assert second.valid
    assert second.pan_rad == pytest.approx(1.5, abs=5e-4)


def test_what_cannot_be_found_is_not_valid_and_not_nan(exact: CalibratedCamera) -> None:
    localiser = Localiser(exact.panorama, exact.camera, PanZoomConfig())
    grey = np.full((OPTICS.height, OPTICS.width, 3), 90, np.uint8)
    noise = np.random.default_rng(0).integers(0, 255, grey.shape).astype(np.uint8)
    elsewhere = synthetic.render(OPTICS, 0.0, FOCAL, seed=1)
    half = synthetic.render(OPTICS, 0.0, FOCAL)
    half[: 2 * OPTICS.height // 3] = 0
    known = localiser.localise(synthetic.render(OPTICS, 0.0, FOCAL), None)
    for image in (grey, noise, elsewhere, 0 * grey, 0 * grey + 255, half):
        for before in (None, known):
            found = localiser.localise(image, before)
            assert not found.valid
            assert np.isfinite([found.pan_rad, found.focal_px, *found.covariance.ravel()]).all()


def test_localising_twice_is_the_same_to_the_bit(exact: CalibratedCamera) -> None:
    image = synthetic.render(OPTICS, 0.2, 1.3 * FOCAL)
    one, two = (Localiser(exact.panorama, exact.camera, PanZoomConfig()).localise(image, None) for _ in range(2))
    assert one.pan_rad == two.pan_rad
    assert one.focal_px == two.focal_px


def matches(pan: float, focal: float, noise: float) -> tuple[Array, Array, Array]:
    """Points in a frame (N, 2), and azimuths and slopes on the panorama."""
    rng = np.random.default_rng(0)
    camera = camera_of(OPTICS)
    azimuth = pan + rng.uniform(-0.5, 0.5, 400)
    slope = np.tan(OPTICS.tilt_rad) + rng.uniform(-0.4, 0.4, 400)
    seen, front = direction_to_pixel(view_at(camera, pan, camera.tilt_rad, focal), azimuth, slope)
    inside = front & (seen >= 0).all(axis=1) & (seen < (OPTICS.width, OPTICS.height)).all(axis=1)
    return seen[inside] + rng.normal(0, noise, (inside.sum(), 2)), azimuth[inside], slope[inside]


def test_the_solution_of_equation_11_is_exact() -> None:
    points, azimuth, slope = matches(0.7, 700.0, 0.0)
    found = solve_eq11(whole_turn(0), camera_of(OPTICS), 0.69, 650.0, points, azimuth, slope)
    assert found.pan_rad == pytest.approx(0.7, abs=1e-9)
    assert found.focal_px == pytest.approx(700.0, rel=1e-9)
    off = replace(camera_of(OPTICS), tilt_rad=OPTICS.tilt_rad + 0.03)
    found = solve_eq11(whole_turn(0), off, 0.69, 650.0, points, azimuth, slope, free_tilt=True)
    assert found.pan_rad == pytest.approx(0.7, abs=1e-9)
    assert found.tilt_rad == pytest.approx(OPTICS.tilt_rad, abs=1e-9)
    assert found.focal_px == pytest.approx(700.0, rel=1e-9)


def test_the_covariance_is_what_the_errors_are() -> None:
    """Normalised squared errors over many noisy frames average one a degree of freedom."""
    camera, rng = camera_of(OPTICS), np.random.default_rng(1)
    clean, azimuth, slope = matches(0.7, 700.0, 0.0)
    total = 0.0
    for _ in range(100):
        found = solve_eq11(whole_turn(0), camera, 0.7, 700.0, clean + rng.normal(0, 0.4, clean.shape), azimuth, slope)
        error = np.array([found.pan_rad - 0.7, np.log(found.focal_px / 700.0)])
        total += error @ np.linalg.solve(found.covariance, error) / 2
    assert 0.6 < total / 100 < 1.6


def test_without_a_zoom_run_distortion_leaves_the_focal_length_in_doubt() -> None:
    """By as much as a scale that is fitted to what the distortion moves; at the sweep's own zoom by nothing."""
    camera, config, zoom = camera_of(OPTICS), PanZoomConfig(), 2.0
    focal = np.array([FOCAL, zoom * FOCAL])
    across, down = np.meshgrid(np.arange(OPTICS.width), np.arange(OPTICS.height))
    ray = np.hypot(across - (OPTICS.width - 1) / 2, down - (OPTICS.height - 1) / 2) / focal[1]
    passes_for = config.beliefs.k1 * np.log(zoom) * np.sum(ray**4) / np.sum(ray**2)

    def sigma_squared(k1: list[float]) -> Array:
        lens = replace(camera.lens, k1=np.array(k1))
        return systematic(config, replace(camera, lens=lens), np.zeros(2), focal)[:, 1, 1]

    more = sigma_squared([-0.05]) - sigma_squared([-0.05, 0.06, 0.0])
    np.testing.assert_allclose(np.sqrt(more), [0.0, passes_for], rtol=1e-3)


def test_consensus_survives_three_wrong_matches_in_four() -> None:
    camera, rng = camera_of(OPTICS), np.random.default_rng(1)
    points, azimuth, slope = matches(-3.1, 500.0, 0.3)
    wrong = rng.random(len(points)) < 0.75
    azimuth[wrong] = rng.uniform(-np.pi, np.pi, wrong.sum())
    slope[wrong] += rng.uniform(-0.2, 0.2, wrong.sum())
    focals = FOCAL * np.exp(np.arange(-0.7, 1.2, 0.02))
    pan, focal, agree = consensus(lambda f: view_at(camera, 0.0, camera.tilt_rad, f), points, azimuth, slope, focals)
    assert wrapped(pan + 3.1) == pytest.approx(0.0, abs=0.02)
    assert focal == pytest.approx(500.0, rel=0.05)
    assert agree[~wrong].mean() > 0.8
    assert agree[wrong].mean() < 0.1


def test_an_unknown_method_names_the_known_ones() -> None:
    with pytest.raises(PzcapError, match="exact, paper"):
        PanZoomConfig(method="papper")


def test_without_a_sweep_of_the_reference_pose_one_line_says_so() -> None:
    pans = np.deg2rad(np.arange(100.0, 130.0, 6.0))
    frames = [(i, synthetic.render(OPTICS, pan, FOCAL, noise_seed=i)) for i, pan in enumerate(pans)]
    reference = synthetic.render(OPTICS, 0.0, FOCAL, with_object=True)
    for calibrate in (calibrate_camera, paper.calibrate):
        with pytest.raises(PzcapError, match="sweep past the reference pose"):
            calibrate(Footage(reference, synthetic.calibration_object(), frames, None, False), PanZoomConfig())


def test_the_panorama_of_a_full_turn_has_features_on_its_seam() -> None:
    whole = whole_turn(0)
    found = panorama_features(whole, 1e-4)
    width = whole.image.shape[1]
    assert ((found.points_px[:, 0] >= -0.5) & (found.points_px[:, 0] < width - 0.5)).all()
    near = (found.points_px[:, 0] < 6) | (found.points_px[:, 0] > width - 6)
    assert near.mean() > 0.5 * 12 / width
