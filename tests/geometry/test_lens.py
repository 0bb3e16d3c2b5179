"""The lens: against OpenCV's, its inverse, its Jacobians, kernels against arrays, and what lies far outside."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.geometry import lens
from pzcap.geometry.camera import project, rays
from pzcap.geometry.lens import NONE, Distortion
from pzcap.types import Array, Camera, Lens

distortions = st.builds(
    Distortion, st.floats(-0.1, 0.1), st.floats(-0.05, 0.05), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)
)
POINTS = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 5), np.linspace(-0.3, 0.3, 4)), axis=-1).reshape(-1, 2)


def opencv(d: Distortion) -> Array:
    return np.array([d.k1, d.k2, d.p1, d.p2])


@given(distortions)
def test_points_are_seen_where_opencv_sees_them(d: Distortion) -> None:
    camera = Camera(640, 480, np.eye(4), 880.0, np.array([322.0, 236.0]), *d)
    points = np.column_stack([5.0 * POINTS, np.full(len(POINTS), 5.0)])
    matrix = np.array([[880.0, 0.0, 322.0], [0.0, 880.0, 236.0], [0.0, 0.0, 1.0]])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, opencv(d))
    np.testing.assert_allclose(project(camera, points)[0], expected[:, 0], atol=1e-9)


@given(distortions)
def test_opencv_undistorts_alike(d: Distortion) -> None:
    bent = lens.distort(POINTS, d)
    many = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    expected = cv2.undistortPointsIter(bent[:, None], np.eye(3), opencv(d), np.eye(3), np.eye(3), many)
    np.testing.assert_allclose(lens.undistort(bent, d), expected[:, 0], atol=1e-9)


@given(distortions, st.floats(0.0, 0.7), st.floats(-3.2, 3.2))
def test_distortion_is_undone(d: Distortion, radius: float, angle: float) -> None:
    xy = radius * np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(lens.undistort(lens.distort(xy, d), d), xy, atol=1e-11)


@given(distortions)
def test_a_ray_leads_to_its_pixel(d: Distortion) -> None:
    camera = Camera(640, 480, np.eye(4), 880.0, np.array([322.0, 236.0]), *d)
    pixels = 320.0 + 600.0 * POINTS
    np.testing.assert_allclose(project(camera, 3.0 * rays(camera, pixels))[0], pixels, atol=1e-8)


@given(distortions)
def test_jacobians_are_the_finite_differences(d: Distortion) -> None:
    step = 1e-6
    by_point, by_coefficient = lens.jacobian(POINTS, d), lens.jacobian_by_coefficients(POINTS)
    for k, axis in enumerate(np.eye(2)):
        ahead, back = (lens.distort(POINTS + s * step * axis, d) for s in (1, -1))
        np.testing.assert_allclose(by_point[..., k], (ahead - back) / (2 * step), atol=1e-8)
    for k, axis in enumerate(np.eye(4)):
        ahead, back = (lens.distort(POINTS, Distortion(*(np.array(d) + s * step * axis))) for s in (1, -1))
        np.testing.assert_allclose(by_coefficient[..., k], (ahead - back) / (2 * step), atol=1e-8)


@settings(deadline=None)  # the first call compiles
@given(distortions)
def test_kernels_do_what_the_arrays_do(d: Distortion) -> None:
    for x, y in POINTS:
        point = np.array([x, y])
        bent = lens.distort(point, d)
        np.testing.assert_allclose(lens.distort_point(x, y, d), bent, atol=1e-15)
        xx, xy, yy = lens.jacobian_at(x, y, d)
        np.testing.assert_allclose([[xx, xy], [xy, yy]], lens.jacobian(point, d), atol=1e-15)
        np.testing.assert_allclose(lens.undistort_point(*bent, d, 5), point, atol=1e-11)
        k1_x, k1_y, _, p1_x, p1_y, p2_x = lens.by_coefficients(x, y)
        expected = lens.jacobian_by_coefficients(point)
        np.testing.assert_allclose([k1_x, k1_y], expected[:, 0], atol=1e-15)
        np.testing.assert_allclose(
            [[p1_x, p1_x], [p1_y, p2_x]], [expected[:, 2][[0, 0]], [expected[1, 2], expected[0, 3]]]
        )


def test_what_lies_far_outside_does_not_fold_back_into_the_image() -> None:
    radii = np.linspace(0, 50, 2000)
    for d in (Distortion(-0.08), Distortion(-0.08, 0.001), Distortion(0.05, -0.02)):
        bent = lens.distort(np.column_stack([radii, 0 * radii]), d)[:, 0]
        assert (np.diff(bent) > 0).all()


@given(st.floats(-0.4, 1.2))
def test_coefficients_follow_the_zoom(log_zoom: float) -> None:
    zooming = Lens(
        640, 480, 880.0, np.array([[322.0, 236.0], [1.5, -0.7]]), np.array([-0.03, 0.05, 0.01]),
        k2=np.array([0.01, -0.02]), p1=np.array([0.001]), p2=np.array([0.002, 0.001, 0.0005]),
    )  # fmt: skip
    focal, step = 880.0 * np.exp(log_zoom), 1e-6
    ahead, back = (lens.at(zooming, focal * np.exp(s * step)) for s in (1, -1))
    principal, coefficients = lens.slope(zooming, focal)
    np.testing.assert_allclose(principal, (ahead[0] - back[0]) / (2 * step), atol=1e-6)
    np.testing.assert_allclose(coefficients, (np.array(ahead[1]) - np.array(back[1])) / (2 * step), atol=1e-8)


def test_a_lens_has_no_distortion_but_what_it_is_told() -> None:
    plain = Lens(640, 480, 880.0, np.array([[319.5, 239.5]]), np.zeros(1))
    assert lens.at(plain, 1000.0)[1] == NONE
    np.testing.assert_array_equal(lens.distort(POINTS, NONE), POINTS)
