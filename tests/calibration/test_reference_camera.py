"""Tsai's calibration: against synthetic cameras, against `cv2.calibrateCamera`, and on drawn markers."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pzcap.calibration import reference_camera
from pzcap.calibration.reference_camera import ReferenceConfig
from pzcap.calibration.tuning import REFERENCE
from pzcap.geometry.camera import project
from pzcap.types import Array, CalibrationObject, Camera, PzcapError
from tests.scenes import synthetic

CENTRE = np.array([319.5, 239.5])
LOOSE = ReferenceConfig(k1_sigma=10.0)


def cube_points() -> Array:
    return np.concatenate([marker.corners_m for marker in synthetic.calibration_object().markers])


def camera_at(position: Array, turn: Array, focal: float, k1: float) -> Camera:
    """A camera near ``position`` that looks about along the world's x axis."""
    world_T_cam = np.eye(4)
    forward = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])
    world_T_cam[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ forward
    world_T_cam[:3, 3] = position
    return Camera(640, 480, world_T_cam, focal, CENTRE, k1)


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.08, 0.08), st.floats(-0.1, 0.1), st.floats(500, 1500), st.floats(-1, 1))
def test_the_linear_stages_are_exact_without_distortion(
    roll: float, yaw: float, pitch: float, focal: float, y: float
) -> None:
    truth = camera_at(np.array([0.0, y, 0.3]), np.array([roll, pitch, yaw]), focal, 0.0)
    points = cube_points()
    found = reference_camera.tsai(points, project(truth, points)[0], 640, 480)
    assert found.focal_px == pytest.approx(focal, rel=1e-6)
    np.testing.assert_allclose(found.world_T_cam, truth.world_T_cam, atol=1e-5)


def test_the_radial_alignment_constraint_does_not_see_radial_distortion() -> None:
    truth = camera_at(np.zeros(3), np.array([0.02, -0.05, 0.03]), 880.0, -0.1)
    points = cube_points()
    found = reference_camera.tsai(points, project(truth, points)[0], 640, 480)
    turn = Rotation.from_matrix(found.world_T_cam[:3, :3].T @ truth.world_T_cam[:3, :3]).magnitude()
    assert turn < 1e-6


def test_refinement_finds_focal_length_and_distortion_exactly() -> None:
    truth = camera_at(np.array([0.2, 0.4, 0.1]), np.array([0.02, -0.05, 0.03]), 880.0, -0.07)
    points = cube_points()
    pixels = project(truth, points)[0]
    start = reference_camera.tsai(points, pixels, 640, 480)
    found = reference_camera.fit(start, points, pixels, ReferenceConfig(k1_sigma=1e6), free_lens=True).camera
    assert found.focal_px == pytest.approx(880.0, rel=1e-7)
    assert found.k1 == pytest.approx(-0.07, abs=1e-6)
    np.testing.assert_allclose(found.world_T_cam, truth.world_T_cam, atol=1e-6)


def test_agrees_with_opencv(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same points, the same model: `cv2.calibrateCamera` with its other coefficients held at 0, and least squares,
    which forget no corner."""
    monkeypatch.setattr(reference_camera, "REFERENCE", REFERENCE._replace(outlier_sigmas=1e6))
    rng = np.random.default_rng(3)
    truth = camera_at(np.array([0.2, 0.4, 0.1]), np.array([0.02, -0.05, 0.03]), 880.0, -0.07)
    points = cube_points()
    pixels = project(truth, points)[0] + rng.normal(0, 0.1, (len(points), 2))
    start = reference_camera.tsai(points, pixels, 640, 480)
    ours = reference_camera.fit(
        start, points, pixels, replace(LOOSE, outlier_px=100.0, k1_sigma=1e6), free_lens=True
    ).camera
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    )  # fmt: skip
    guess = np.array([[900.0, 0, CENTRE[0]], [0, 900.0, CENTRE[1]], [0, 0, 1]])
    _, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(
        [points.astype(np.float32)], [pixels.astype(np.float32)], (640, 480), guess, np.zeros(5), flags=flags
    )
    rotation = Rotation.from_rotvec(rvecs[0].ravel()).as_matrix()
    assert ours.focal_px == pytest.approx(matrix[0, 0], rel=1e-4)
    assert ours.k1 == pytest.approx(distortion.ravel()[0], abs=1e-3)
    np.testing.assert_allclose(ours.world_T_cam[:3, 3], -rotation.T @ tvecs[0].ravel(), atol=1e-3)


def test_a_wrong_corner_hardly_matters() -> None:
    truth = camera_at(np.zeros(3), np.zeros(3), 880.0, 0.0)
    points = cube_points()
    pixels = project(truth, points)[0]
    pixels[7] += (9.0, -6.0)
    found = reference_camera.fit(
        reference_camera.tsai(points, pixels, 640, 480), points, pixels, ReferenceConfig(), free_lens=True
    )
    assert found.camera.focal_px == pytest.approx(880.0, rel=2e-3)
    assert np.hypot(*found.residuals_px[7]) > 8


def test_corners_that_are_off_by_much_more_than_the_others_are_forgotten() -> None:
    """As on markers of a dozen pixels: corners of an oblique face are off by one or two pixels, the others by 0.05."""
    rng = np.random.default_rng(4)
    truth = camera_at(np.array([-2.5, 0.4, 0.5]), np.array([0.01, -0.02, 0.03]), 500.0, 0.0)
    points = cube_points()
    exact = project(truth, points)[0]

    def centre_off(wrong: int) -> float:
        pixels = exact + rng.normal(0, 0.05, exact.shape)
        pixels[:wrong] += (1.2, -1.6)
        found = reference_camera.fit(truth, points, pixels, ReferenceConfig(), free_lens=False).camera
        return float(np.linalg.norm(found.world_T_cam[:3, 3] - truth.world_T_cam[:3, 3]))

    right, wrong = (np.median([centre_off(count) for _ in range(20)]) for count in (0, 3))
    assert wrong < 1.5 * right


def test_drawn_markers_are_found_to_a_tenth_of_a_pixel() -> None:
    optics = replace(synthetic.clean(synthetic.Optics()), width=640, height=480, reference_focal_px=880.0)
    optics = replace(optics, principal_px=(319.5, 239.5), noise=2.0)
    calibration_object = synthetic.calibration_object()
    image = synthetic.render(optics, 0.0, 880.0, with_object=True)
    found = reference_camera.calibrate(image, calibration_object, ReferenceConfig())
    truth = camera_at(np.zeros(3), np.zeros(3), 880.0, 0.0)
    error = found.points_px - project(truth, found.points_m)[0]
    assert len(found.points_px) == 72
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.sqrt(np.mean(error**2)) < 0.06
    quads = error.reshape(-1, 4, 2)  # corners that are drawn in or out together shrink or grow the marker
    outward = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    assert abs(np.mean(quads * outward)) < 0.02
    assert np.sqrt(np.mean(np.sum(found.residuals_px**2, axis=1))) < 0.1
    assert found.camera.focal_px == pytest.approx(880.0, rel=5e-3)


def test_what_is_missing_is_said_in_one_line() -> None:
    calibration_object = synthetic.calibration_object()
    empty = np.full((480, 640, 3), 128, np.uint8)
    with pytest.raises(PzcapError, match="0 of the calibration object's 18 markers") as caught:
        reference_camera.calibrate(empty, calibration_object, ReferenceConfig())
    assert "\n" not in str(caught.value)
    strange = CalibrationObject("DICT_9X9", calibration_object.markers, calibration_object.wireframe_m)
    with pytest.raises(PzcapError, match="DICT_9X9"):
        reference_camera.calibrate(empty, strange, ReferenceConfig())
    optics = synthetic.Optics(width=640, height=480, principal_px=(323.0, 236.0), reference_focal_px=880.0)
    image = synthetic.render(optics, 0.0, 880.0, with_object=True)
    one_face = CalibrationObject("DICT_4X4_50", calibration_object.markers[:9], calibration_object.wireframe_m)
    with pytest.raises(PzcapError, match="one plane"):
        reference_camera.calibrate(image, one_face, ReferenceConfig())


@pytest.mark.parametrize(
    ("axes", "order", "said"),
    [
        ((1, 1, 1), (3, 2, 1, 0), "all corners are listed anticlockwise"),
        ((1, 1, 1), (1, 2, 3, 0), "all corners are listed from another one than the upper left"),
        ((1, -1, 1), (0, 1, 2, 3), "its axes are left-handed"),
        ((1, 1, 1), (0, 2, 1, 3), r"check its dimensions \(object.json\)"),
    ],
)
def test_corners_in_another_order_than_meant_are_told(axes: tuple[int, ...], order: tuple[int, ...], said: str) -> None:
    known = synthetic.calibration_object()
    optics = synthetic.Optics(width=640, height=480, principal_px=(319.5, 239.5), reference_focal_px=880.0)
    image = synthetic.render(optics, 0.0, 880.0, with_object=True)
    markers = tuple(replace(each, corners_m=each.corners_m[list(order)] * axes) for each in known.markers)
    with pytest.raises(PzcapError, match=f"do not fit one camera; {said}"):
        reference_camera.calibrate(image, replace(known, markers=markers), ReferenceConfig())
