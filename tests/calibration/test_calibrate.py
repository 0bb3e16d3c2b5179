"""One camera made ready: what the adjustment found is what the camera has, and pan 0 is the reference image's."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.footage import SMALL
from pzcap.calibration import in_metres, reference_camera
from pzcap.calibration.agreement import require_whole
from pzcap.calibration.beliefs import BeliefConfig
from pzcap.calibration.bundle_adjustment import Adjusted, Link, adjust
from pzcap.calibration.calibrate import Footage
from pzcap.calibration.correspondences import Matched, match, sigmas_of
from pzcap.calibration.fitting import CameraFit, fit_camera, with_lean
from pzcap.calibration.minima import likeliest, starts
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.photometric_bundle_adjustment import Fitted
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.stitching import Brightness
from pzcap.calibration.sweep import Chain
from pzcap.calibration.tuning import PHOTOMETRIC
from pzcap.camera_set import calibrate_camera
from pzcap.geometry.camera import at, head_T_cam
from pzcap.io.video import VideoReader
from pzcap.localisation.localise import count_from_reference
from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.localisation.photometric_alignment import Aligner
from pzcap.progress import no_report
from pzcap.solver.gauss_newton import SolveReport
from pzcap.types import Camera, InverseDepthMap, Panorama, PzcapError
from sim.cameras.film import FilmCamera
from sim.cameras.operator import sweep, through
from sim.cameras.optics import vignette
from sim.cameras.sensor import Sensor
from sim.capture_writer import write_video
from sim.hall import gym
from sim.session import assemble
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of, whole_turn

OPTICS = synthetic.Optics()
FOCAL = OPTICS.reference_focal_px
THREE_M = np.full(72, 0.3)  # about: inverse camera heights
HALL = InverseDepthMap(1.0, np.linspace(0.1, 0.5, 6), np.zeros((2, 6)), np.array([-0.3, 0.3]))


def taken(height_m: float) -> Camera:
    camera = at(camera_of(OPTICS), 0.0, OPTICS.tilt_rad, FOCAL)
    stood = camera.world_T_cam.copy()
    stood[2, 3] = height_m
    return replace(camera, world_T_cam=stood)


def test_a_sweep_that_is_torn_is_said_so() -> None:
    kept, ends = np.arange(10, 22), [(k, k + 1) for k in range(11)] + [(k, k + 3) for k in range(9)] + [(0, 11)]
    links = [Link(*each, np.zeros((50, 2)), np.zeros((50, 2)), np.zeros(50)) for each in ends]

    def adjusted(torn: int) -> Adjusted:
        inliers = [5 if first <= torn < second and second - first < 6 else 48 for first, second in ends]
        return Adjusted(model_at(FOCAL, 0.003), 0.3, np.array([*inliers, 50]), SolveReport(True, 3, 1.0), 0.0)

    require_whole(adjusted(-1), links, kept)
    with pytest.raises(PzcapError, match="of 200 matches across frames 16 and 17 20 agree"):
        require_whole(adjusted(6), links, kept)


def model_at(focal_px: float, offset: float) -> CalibrationParameters:
    return CalibrationParameters(
        np.zeros(1), np.log([focal_px]), np.zeros(1, int), np.zeros(1, int), -0.07, 0.01, np.array([[160.0, 121.0]]),
        np.array([-0.05, 0.07]), np.zeros(3), np.array([offset, 0.0]), 0.0, HALL,
    )  # fmt: skip


def fit_of(focal_px: float, overlap_misfit: float = 0.0, prior_misfit: float = 0.0, sigma: float = 2.0) -> CameraFit:
    model = replace(model_at(focal_px, 0.003), log_focal=np.log([focal_px, focal_px]))
    fitted = Fitted(model, np.eye(1), sigma, overlap_misfit, prior_misfit, np.zeros((1, 0)), SolveReport(True, 4, 0.0))
    return CameraFit(cast(Adjusted, None), cast(Brightness, None), fitted)


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_minima_the_likelier_is_taken_and_the_other_is_doubt(turned: bool) -> None:
    worth = PHOTOMETRIC.doubt * 2.0**2
    right, equal = fit_of(FOCAL, 5e3 * worth), fit_of(1.01 * FOCAL, 5e3 * worth)
    torn, unusual = fit_of(1.01 * FOCAL, 5.03e3 * worth), fit_of(1.01 * FOCAL, 4.997e3 * worth, 16.0, sigma=2.1)
    nothing = Matched(
        cast(Chain, SimpleNamespace(images=[np.zeros((240, 320))])), [], [], [], [], right.fitted.parameters,
        sigmas_of(taken(1.6), BeliefConfig(), True, True),
    )  # fmt: skip

    def of(*fits: CameraFit, object_px: float | None = None) -> tuple[CameraFit, float]:
        return likeliest(fits[::-1] if turned else fits, replace(nothing, object_px=object_px))

    assert likeliest([right], nothing) == (right, 0.0)
    assert of(right, equal)[1] == pytest.approx(np.log(1.01) / np.sqrt(2.0))
    best, doubt = of(right, torn)
    assert best is right
    assert doubt == pytest.approx(np.log(1.01) * np.exp(-30 / 4), rel=0.1)
    best, doubt = of(right, unusual)  # overlaps that agree better by three do not make up for what nobody expects
    assert best is right
    assert doubt == pytest.approx(np.log(1.01) * np.exp(-13 / 4), rel=0.1)
    best, doubt = of(right, equal, object_px=1.01 * FOCAL)
    assert best is equal
    assert doubt < 0.98 * np.log(1.01) / np.sqrt(2.0)


def test_what_was_adjusted_is_what_the_camera_has() -> None:
    model = CalibrationParameters(
        np.zeros(1), np.log([FOCAL]), np.zeros(1, int), np.zeros(1, int), -0.07, 0.01, np.array([[160.0, 121.0]]),
        np.array([-0.05, 0.07]), np.array([0.04, 0.001, 0.0]), np.array([0.003, -0.002]), 0.0017, HALL,
    )  # fmt: skip
    camera, hall = in_metres.in_metres(model, 0.0, taken(1.6))
    assert (camera.tilt_rad, camera.roll_rad) == (-0.07, 0.01)
    np.testing.assert_allclose(camera.offset_m, 1.6 * model.offset)
    assert camera.travel_m == pytest.approx(1.6 * 0.0017)
    np.testing.assert_allclose(camera.lens.k1, model.k1)
    np.testing.assert_allclose([camera.lens.k2, camera.lens.p1, camera.lens.p2], model.higher[:, None])
    np.testing.assert_allclose(hall.walls, HALL.walls / 1.6)
    there = at(camera, 0.0, camera.tilt_rad, FOCAL)
    np.testing.assert_allclose(there.world_T_cam, taken(1.6).world_T_cam, atol=1e-12)


@pytest.mark.parametrize("lean", [(0.0, 0.0, 0.0), (0.02, -0.03, 0.0)])
def test_the_floor_leans_as_the_axis_does(lean: tuple[float, float, float]) -> None:
    """The way up in the reference image tells it; where the axis is upright it is level, whatever the tilt."""
    world_R_head = Rotation.from_rotvec(lean).as_matrix()
    up = (world_R_head @ head_T_cam(0.4, -0.07, 0.01)[:3, :3])[2]
    model = CalibrationParameters(
        np.array([0.0, 0.4]), np.log([FOCAL]), np.array([0, 1]), np.zeros(2, int), -0.07, 0.01,
        np.array([[160.0, 121.0]]), np.zeros(1), np.zeros(3), np.zeros(2), 0.0, HALL,
    )  # fmt: skip
    matched = SimpleNamespace(up=lambda _: up, chained=SimpleNamespace(pan_rad=np.zeros(1)))
    found = with_lean(model, cast(Matched, matched))
    normal = world_R_head.T[:, 2]
    np.testing.assert_allclose(found.surroundings.lean, -normal[:2] / normal[2], atol=1e-12)
    matched.up = None
    assert with_lean(model, cast(Matched, matched)) is model
    # counted from another pan, it leans the same way
    turned = in_metres._rotated(found.surroundings, 0.4, 1.6)
    for azimuth in (0.0, 1.0, 2.5):
        before, after = (
            float(hall.lean @ (np.cos(at_rad), np.sin(at_rad)))
            for hall, at_rad in ((found.surroundings, azimuth + 0.4), (turned, azimuth))
        )
        assert after == pytest.approx(before, abs=1e-12)


def test_beliefs_are_in_metres_and_the_adjustment_in_camera_heights() -> None:
    sigmas = sigmas_of(taken(2.0), BeliefConfig(offset_m=0.01, travel_m=0.004), full_turn=True, zoom=True)
    assert (sigmas.offset, sigmas.travel) == (pytest.approx(0.005), pytest.approx(0.002))
    # a camera that stands nowhere has no height to measure by
    assert sigmas_of(taken(0.0), BeliefConfig(offset_m=0.01), full_turn=True, zoom=False).offset == 0.01


def shrunk() -> Panorama:
    """The hall at the resolution of a frame."""
    whole = whole_turn(0)
    width = round(2 * np.pi * FOCAL)
    scale = width / whole.image.shape[1]
    image = cv2.resize(whole.image, (width, round(whole.image.shape[0] * scale)), interpolation=cv2.INTER_AREA)
    return replace(
        whole, image=image, valid=np.ones(image.shape[:2], bool), px_per_rad=width / (2 * np.pi),
        origin_px=(whole.origin_px + 0.5) * scale - 0.5,
    )  # fmt: skip


def test_pan_0_is_where_the_reference_image_lies_on_the_panorama() -> None:
    panorama, camera = shrunk(), camera_of(OPTICS)
    image = synthetic.render(OPTICS, 0.8 / FOCAL, FOCAL)
    counted = count_from_reference(panorama, camera, image, FOCAL)
    again = Aligner(counted, camera).align(image, ViewPlace(0.0, camera.tilt_rad, FOCAL), 1.5)
    assert again.at.pan_rad == pytest.approx(0.0, abs=0.01 / FOCAL)
    np.testing.assert_allclose(counted.sweep_pan_rad, panorama.sweep_pan_rad - 0.8 / FOCAL, atol=0.05 / FOCAL)


def test_a_reference_image_of_something_else_moves_nothing() -> None:
    panorama = shrunk()
    nonsense = np.random.default_rng(0).integers(0, 255, (OPTICS.height, OPTICS.width, 3)).astype(np.uint8)
    assert count_from_reference(panorama, camera_of(OPTICS), nonsense, FOCAL) is panorama


@pytest.mark.slow
def test_what_is_believed_of_walls_does_not_push_the_projection_centre_out(tmp_path: Path) -> None:
    # ten times as far from the axis as a crew leaves it, so that small pictures show it: what is seen is the offset
    # times how near things are, and walls that were held back to what is believed of them pushed it out by a sixth
    optics = replace(SMALL.optics, axis_behind_m=0.05, axis_beside_m=0.03)
    config = replace(SMALL, sweep_deg=360.0, optics=optics, operator=replace(SMALL.operator, sweep_step_deg=4.0))
    session = assemble(config)
    stage, rig, file, rng = session.stage(), session.rigs[3], tmp_path / "sweep.mp4", np.random.default_rng(0)
    pan_rad = sweep(config.sweep_deg, config.operator, rng)
    times_s = np.arange(len(pan_rad)) / config.sweep_frame_rate
    trajectory = through(times_s, pan_rad, np.full(len(pan_rad), rig.reference_focal_px))
    filming, sensor = FilmCamera(stage, rig, config.sensor), Sensor(config.sensor, vignette(rig), rng)
    pictures = (sensor.develop(filming.instant(trajectory.at, t, None), 1.0, rng) for t in times_s.tolist())
    write_video(file, pictures, Fraction(config.sweep_frame_rate), crf=config.sensor.crf_still)
    image = sensor.develop(filming.still(), 1.0, rng)
    stage.close()
    footage = Footage(image, gym.calibration_object(), VideoReader(file), None, True)
    found = calibrate_camera(footage, PanZoomConfig()).camera
    np.testing.assert_allclose(found.offset_m, [optics.axis_behind_m, -rig.beside_m], rtol=0.09)
    first = reference_camera.calibrate(image, gym.calibration_object(), PanZoomConfig().reference)
    matched = match(first.camera, image, footage.sweep, None, True, PanZoomConfig(), no_report)
    # a start on the other side of the axis ends there, with a focal length that is 3 % too long, unless both are tried
    beside = replace(
        matched.start, offset=np.array([-0.03, 0.0]), surroundings=replace(matched.start.surroundings, walls=THREE_M)
    )
    lost = adjust(beside, matched.links, matched.sigmas, scale_px=4.0, iterations=12).parameters
    assert np.exp(lost.log_focal[0]) > 1.02 * rig.reference_focal_px
    (start,) = starts(replace(matched, start=beside), PanZoomConfig())
    fitted = fit_camera(matched, start, PanZoomConfig(), no_report).fitted.parameters
    assert np.exp(fitted.log_focal[0]) == pytest.approx(rig.reference_focal_px, rel=3e-4)
    assert start.offset[0] > 0.0
