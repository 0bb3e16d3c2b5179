"""The paper's own method: unfolding (eq. 6), chain, similarity (eq. 15), and the whole on the camera that it
assumes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pzcap.calibration.calibrate import Footage
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import SweepConfig
from pzcap.extras.paper import stitching
from pzcap.extras.paper.method import PaperLocaliser, calibrate
from pzcap.extras.paper.similarity import ransac_eq15, solve_eq15
from pzcap.extras.paper.unfolding import points_from_cylinder, points_to_cylinder, to_cylinder
from pzcap.geometry.camera import head_T_cam, pixel_to_direction, view_at
from pzcap.types import Lens, PanZoomCamera
from tests.scenes import synthetic

OPTICS = synthetic.Optics()
FOCAL = OPTICS.reference_focal_px


@given(st.floats(0, 639), st.floats(0, 479), st.floats(400, 2000))
def test_equation_6_and_its_inverse(u: float, v: float, focal: float) -> None:
    point = np.array([[u, v]])
    unfolded = points_to_cylinder(point, focal, 640, 480)
    np.testing.assert_allclose(points_from_cylinder(unfolded, focal, 640, 480), point, atol=1e-8)


def test_equation_6_is_the_camera_on_an_upright_head() -> None:
    """Without distortion, tilt and roll, the paper's cylinder is the cylinder about the pan axis."""
    lens = Lens(640, 480, 880.0, np.array([[319.5, 239.5]]), np.zeros(1))
    camera = PanZoomCamera(lens, head_T_cam(0, 0, 0), 0.0, 0.0)
    points = np.random.default_rng(0).uniform((0, 0), (640, 480), (50, 2))
    azimuth, slope = pixel_to_direction(view_at(camera, 0.0, 0.0, 880.0), points)
    expected = -880.0 * np.column_stack([azimuth, slope])
    np.testing.assert_allclose(points_to_cylinder(points, 880.0, 640, 480), expected, atol=1e-9)


def test_unfolded_images_hold_what_equation_6_says() -> None:
    v, u = np.mgrid[0:480, 0:640]
    ramp = np.stack([u / 4, v / 4, 0 * u], axis=-1).astype(np.uint8)
    unfolded, covered, origin = to_cylinder(ramp, 500.0)
    points = np.array([[100.0, 100.0], [500.0, 400.0], [319.5, 239.5]])
    for point, place in zip(points, points_to_cylinder(points, 500.0, 640, 480) + origin, strict=True):
        column, row = np.round(place).astype(int)
        assert covered[row, column]
        np.testing.assert_allclose(unfolded[row, column, :2] * 4.0, point, atol=6)


def test_the_papers_chain_on_a_camera_as_the_paper_assumes_it() -> None:
    optics = synthetic.clean(OPTICS)
    pans = np.deg2rad(np.arange(0.0, 40.0, 4.0))
    found = stitching.stitch(synthetic.frames(optics, pans), FOCAL, SweepConfig(), lambda _done: None)
    np.testing.assert_allclose(np.rad2deg(found.sweep_pan_rad), np.rad2deg(pans), atol=0.03)
    azimuth = (found.origin_px[0] - np.arange(found.image.shape[1])) / found.px_per_rad
    middle = round(found.origin_px[1])
    here = np.abs(found.image[middle] - synthetic.hall_at(azimuth, 0 * azimuth)).mean()
    assert here < 0.7 * np.abs(found.image[middle] - synthetic.hall_at(azimuth + 2 / FOCAL, 0 * azimuth)).mean()


def test_equation_15_is_exact_for_a_similarity() -> None:
    rng = np.random.default_rng(0)
    relative = rng.uniform(-150, 150, (60, 2))
    places = relative / 1.7 + (812.0, 95.0)
    places[:20] = rng.uniform(0, 2000, (20, 2))
    agree = ransac_eq15(relative, places)
    assert not agree[:20].any()
    assert agree[20:].all()
    solution, _ = solve_eq15(relative[agree], places[agree])
    np.testing.assert_allclose(solution, [1 / 1.7, 812.0, 95.0], atol=1e-9)


def test_the_papers_method_on_the_papers_camera() -> None:
    """No distortion, tilt or roll: what is left is the error of eq. 15."""
    optics = synthetic.clean(OPTICS)
    pans = np.deg2rad(np.arange(-24.0, 25.0, 4.0))
    swept = [(i, synthetic.render(optics, pan, FOCAL, noise_seed=i)) for i, pan in enumerate(pans)]
    reference = synthetic.render(optics, 0.0, FOCAL, with_object=True)
    config = PanZoomConfig(method="paper")
    made = calibrate(Footage(reference, synthetic.calibration_object(), swept, None, False), config)
    np.testing.assert_allclose(
        np.rad2deg(made.panorama.sweep_pan_rad), np.rad2deg(pans), atol=0.3
    )  # the focal length is the object's
    localiser = PaperLocaliser(made.panorama, made.camera, config)
    for pan_deg, zoom in ((5.0, 1.0), (-10.0, 1.2), (0.0, 0.8)):
        found = localiser.localise(synthetic.render(optics, np.deg2rad(pan_deg), FOCAL * zoom), None)
        assert found.valid
        assert np.rad2deg(found.pan_rad) == pytest.approx(pan_deg, abs=0.3)
        assert found.focal_px == pytest.approx(FOCAL * zoom, rel=0.03)
