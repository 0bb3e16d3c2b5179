"""Kernels that draw the skin, against the plainest way to say the same."""

from __future__ import annotations

import numpy as np

from pzcap.segmentation.others import BEFORE, BESIDE
from pzcap.tracking import visibility


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
    window = visibility.ZBuffer(z_buffer, cover, 0, 0, 1.0)
    visibility.rasterise(np.asfortranarray(corners), depth, faces, group[segment], window)
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


def test_who_stands_before_the_athlete_hides_what_is_behind() -> None:
    pixels = np.asfortranarray([[10.2, 21.0], [13.9, 21.0], [14.1, 21.0], [500.0, 21.0], [10.2, 24.5]])
    seen = visibility.ProjectedSkin(pixels, np.full(5, 4.0), np.ones(5))
    people = np.array([[BEFORE, BEFORE, BESIDE], [0, BESIDE, BEFORE]], np.uint8)  # of half pixels
    facing = np.full(5, 0.5, np.float32)
    visibility.hide_behind(people, seen, 10, 20, facing)
    assert facing.tolist() == [0.0, 0.0, 0.5, 0.5, 0.5]
