"""The compiled pinhole camera against the plain one, and its derivative."""

from __future__ import annotations

import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.geometry.pinhole import pinhole, pixel_gradient, projected, ray, relative_to
from pzcap.types import Camera

WORLD_T_CAM = np.eye(4)
WORLD_T_CAM[:3, :3] = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
WORLD_T_CAM[:3, 3] = [0.3, -0.2, 0.5]
CAMERA = Camera(640, 480, WORLD_T_CAM, 900.0, np.array([320.0, 240.0]), -0.07, 0.02, 0.003, -0.002)


def test_points_are_projected_as_by_the_plain_camera() -> None:
    ahead = np.random.default_rng(1).uniform([-1.0, -0.8, 2.0], [1.0, 0.8, 9.0], (50, 3))
    pixels, depth = projected(ahead @ WORLD_T_CAM[:3, :3].T + WORLD_T_CAM[:3, 3], CAMERA)
    expected, away = geometry.project(CAMERA, ahead @ WORLD_T_CAM[:3, :3].T + WORLD_T_CAM[:3, 3])
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    np.testing.assert_allclose(depth, away, atol=1e-12)
    assert projected(-ahead @ WORLD_T_CAM[:3, :3].T + WORLD_T_CAM[:3, 3], CAMERA)[1].tolist() == [-1.0] * 50


def test_a_camera_in_a_frame_sees_its_points_where_the_world_s_camera_does() -> None:
    rng = np.random.default_rng(5)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = np.linalg.qr(rng.normal(size=(3, 3)))[0], [-0.4, 0.1, 0.7]
    inside = relative_to(frame, pinhole(CAMERA))
    np.testing.assert_allclose(frame[:3, :3] @ inside.centre + frame[:3, 3], WORLD_T_CAM[:3, 3], atol=1e-12)
    for point in rng.uniform(-2.0, 2.0, (20, 3)):
        world = frame[:3, :3] @ point + frame[:3, 3]
        np.testing.assert_allclose(ray(*point, inside), ray(*world, pinhole(CAMERA)), rtol=1e-9, atol=1e-12)
        assert inside[2:] == pinhole(CAMERA)[2:]


def test_gradient_of_a_pixel_is_its_derivative() -> None:
    point = WORLD_T_CAM[:3, :3] @ [0.4, -0.3, 5.0] + WORLD_T_CAM[:3, 3]
    steps = 1e-5 * np.eye(3)
    numeric = (projected(point + steps, CAMERA)[0] - projected(point - steps, CAMERA)[0]) / 2e-5
    across, down, depth = ray(*point, pinhole(CAMERA))
    for k, (du, dv) in enumerate(np.eye(2)):
        analytic = pixel_gradient(across, down, depth, pinhole(CAMERA), du, dv)
        np.testing.assert_allclose(analytic, numeric[:, k], rtol=1e-5, atol=1e-4)
