"""Kernels that draw the skin, against the plainest way to say the same."""

from __future__ import annotations

import numpy as np

from pzcap.tracking import visibility
from pzcap.types import Array


def test_a_face_is_drawn_where_its_pixels_lie_inside_and_nearest() -> None:
    """Small faces and large ones, hidden ones, those that look away, and those that stand over the edge."""
    rng = np.random.default_rng(0)
    middles = rng.uniform(-2.0, 22.0, (120, 1, 2))
    corners = (middles + rng.normal(0.0, rng.choice([0.6, 4.0], (120, 1, 1)), (120, 3, 2))).reshape(-1, 2)
    depth = rng.uniform(2.0, 9.0, 360)
    depth[30] = -1.0
    faces = np.arange(360).reshape(-1, 3)
    segment, group = np.arange(360) // 3 % 4, np.array([1, 2, 4, 8], np.uint8)
    z_buffer, cover = np.empty((20, 20), np.float32), np.empty((20, 20), np.uint8)
    visibility.rasterise(np.asfortranarray(corners), depth, faces, segment, group, 0, 0, 1.0, z_buffer, cover)
    expected, bits = np.full((20, 20), np.inf), np.zeros((20, 20), np.uint8)
    for face in faces:
        if (depth[face] < 0.0).any():
            continue
        a, b, c = corners[face]
        sides = np.column_stack([b - a, c - a])
        if np.linalg.det(sides) >= 0.0:  # seen from inside: rows point down
            continue
        for row, column in np.ndindex(20, 20):
            shares = np.linalg.solve(sides, np.array([column, row]) - a)
            if shares.min() >= 0.0 and shares.sum() <= 1.0:
                away = depth[face[0]] + shares @ (depth[face[1:]] - depth[face[0]])
                expected[row, column] = min(expected[row, column], away)
                bits[row, column] |= group[segment[face[0]]]
    np.testing.assert_allclose(z_buffer, expected, rtol=1e-6)
    np.testing.assert_array_equal(cover, bits)


def test_slope_is_that_of_the_values_beside() -> None:
    image = np.random.default_rng(1).integers(0, 256, (12, 14)).astype(np.uint8)

    def at(x: float, y: float) -> float:
        return float(visibility.bilinear(image, x, y))

    for x, y in np.random.default_rng(2).uniform(2.0, 8.0, (20, 2)):
        expected = at(x, y), 0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1))
        np.testing.assert_allclose(visibility.sloped(image, x, y), expected, atol=1e-9)


def test_gradient_of_a_pixel_is_its_derivative() -> None:
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    world_T_cam[:3, 3] = [0.3, -0.2, 0.5]
    point = world_T_cam[:3, :3] @ [0.4, -0.3, 5.0] + world_T_cam[:3, 3]

    def pixel(place: Array) -> Array:
        pixels, depth = np.empty((1, 2)), np.empty(1)
        visibility.project(place[None], world_T_cam, 900.0, np.array([320.0, 240.0]), -0.07, pixels, depth)
        return pixels[0]

    steps = 1e-5 * np.eye(3)
    numeric = np.array([(pixel(point + step) - pixel(point - step)) / 2e-5 for step in steps])
    camera = visibility.stand(world_T_cam)
    x, y, depth = visibility.ray(*point, camera)
    for k, (du, dv) in enumerate(np.eye(2)):
        analytic = visibility.pixel_gradient(x, y, depth, camera, 900.0, -0.07, du, dv)
        np.testing.assert_allclose(analytic, numeric[:, k], rtol=1e-5, atol=1e-4)
