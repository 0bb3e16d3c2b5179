"""Perspective to cylinder and back, and the warped background."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.geometry import cylinder
from pzcap.geometry.camera import direction_to_pixel, head_T_cam, pixel_to_direction, view_at
from pzcap.localisation.panorama_sampler import ViewPlace, axis_directions, warp_background
from pzcap.types import InverseDepthMap
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of, whole_turn


@settings(deadline=None)  # the first call draws the hall
@given(st.floats(-4, 4), st.floats(-0.5, 0.5))
def test_panorama_pixels_and_directions_are_inverse(azimuth: float, slope: float) -> None:
    panorama = whole_turn(0)
    pixel = cylinder.to_panorama(panorama, np.array([azimuth]), np.array([slope]))
    assert 0 <= pixel[0, 0] <= panorama.image.shape[1]
    back_azimuth, back_slope = cylinder.from_panorama(panorama, pixel)
    np.testing.assert_allclose(np.exp(1j * back_azimuth), np.exp(1j * azimuth), atol=1e-12)
    np.testing.assert_allclose(back_slope, slope, atol=1e-12)


@settings(deadline=None)
@given(st.floats(-3, 3), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.sampled_from([0.005, 0.12]))
def test_parallax_is_what_three_dimensions_give(pan: float, alpha: float, slope: float, forward: float) -> None:
    """A point on a wall 3 m off or on the floor, seen from the axis and from some millimetres, or a hand, beside it."""
    hall = InverseDepthMap(1.7, np.full(8, 1 / 3.0), np.zeros((2, 8)), np.array([-0.4, 0.4]))
    panorama = replace(whole_turn(0), surroundings=hall)
    camera = replace(camera_of(synthetic.Optics()), offset_m=np.array([forward, -0.003]), travel_m=0.004)
    distance = min(3.0, 1.7 / max(-slope, 1e-9))
    azimuth = pan + alpha
    point = distance * np.array([np.cos(azimuth), np.sin(azimuth), slope])
    view = view_at(camera, pan, -0.07, 700.0)
    from_there = point - head_T_cam(pan, -0.07, 0.0, view.centre_m)[:3, 3]
    there = np.array([np.arctan2(from_there[1], from_there[0]), from_there[2] / np.hypot(*from_there[:2])])
    seen = cylinder.from_centre(panorama, view, np.array([azimuth]), np.array([slope]))
    off = np.array([np.angle(np.exp(1j * (seen[0][0] - there[0]))), seen[1][0] - there[1]])
    foot = cylinder.FOOT / 2 / 1.7 * (forward + 0.005)  # a wall's foot is rounded, and the centre is so far off
    assert np.abs(off).max() < 1e-9 + foot
    pixel, _ = direction_to_pixel(view, *seen)
    back = axis_directions(panorama, camera, pixel, ViewPlace(pan, -0.07, 700.0))[0]
    np.testing.assert_allclose([pan + back[0], back[1]], [azimuth, slope], atol=1e-5 + 2.0 * foot)


@given(st.floats(-3, 3), st.floats(-0.6, -0.2), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_a_floor_that_leans_is_where_its_plane_is(azimuth: float, slope: float, forward: float, left: float) -> None:
    hall = InverseDepthMap(
        1.7, np.full(8, 1e-3), np.zeros((2, 8)), np.array([-0.7, 0.4]), lean=np.array([forward, left])
    )
    near = cylinder.inverse_distance(hall, np.array([azimuth]), np.array([slope]))[0]
    point = np.array([np.cos(azimuth), np.sin(azimuth), slope]) / near
    rounded = cylinder.FOOT**2 / 1.7 / near**2 / 0.2
    assert point[2] == pytest.approx(-1.7 + forward * point[0] + left * point[1], abs=rounded)


def test_nearness_is_linear_between_its_nodes_and_wraps() -> None:
    around = np.array([0.0, 1.0, 2.0, 1.0])
    hall = InverseDepthMap(0.5, around, np.stack([0 * around, around + 1.0]), np.array([-0.5, 0.5]))
    quarter = np.pi / 2
    azimuth = np.array([0.0, quarter, -quarter / 2, 4 * quarter, 2.5 * quarter, quarter, quarter])
    slope = np.array([-0.5, -0.5, -0.5, -0.5, -0.5, 0.0, 3.0])
    found = cylinder.inverse_distance(hall, azimuth, slope)
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0, 1.0, 1.5, 2.0, 3.0], atol=cylinder.FOOT / 2 / 0.5 + 1e-12)


def test_the_floor_before_a_wall_tells_that_it_should_be_nearer() -> None:
    """Below its foot, too, nearness has the derivative by the wall that differences give."""
    slope, step, shares = -0.2 - cylinder.FOOT, 1e-6, np.zeros(cylinder.NODES)

    def near(wall: float) -> float:
        hall = cylinder.kernel_hall(InverseDepthMap(1.0, np.full(4, wall), np.zeros((2, 4)), np.array([-0.5, 0.5])))
        return cylinder.near_at(hall, 0.3, slope, np.zeros(cylinder.NODES, np.int64), shares)

    by_differences = (near(0.2 + step) - near(0.2 - step)) / (2 * step)
    near(0.2)
    assert by_differences > 0.1
    np.testing.assert_allclose(shares[0] + shares[1], by_differences, rtol=1e-4)


def test_interpolated_maps_are_exact_to_a_thousandth_of_a_pixel() -> None:
    """And do not err to one side: a panorama is stitched by them."""
    panorama, optics = whole_turn(0), synthetic.Optics()
    view = view_at(camera_of(optics), 0.4, optics.tilt_rad, 310.0)
    column, row = cylinder.smooth_map(
        lambda points: cylinder.to_unwrapped(panorama, *pixel_to_direction(view, points)), optics.width, optics.height
    )
    u, v = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
    exact = cylinder.to_unwrapped(panorama, *pixel_to_direction(view, np.stack([u, v], axis=-1).astype(float)))
    np.testing.assert_allclose(column, exact[..., 0], atol=1e-3)
    np.testing.assert_allclose(row, exact[..., 1], atol=1e-3)
    assert abs(np.polyfit(exact[..., 1].ravel(), row.ravel(), 1)[0] - 1.0) < 1e-7


def test_the_warped_background_is_what_the_camera_sees() -> None:
    """Across the seam of the full turn, too; the test's renderer shares no code with the library."""
    panorama = whole_turn(0)
    optics = synthetic.Optics(noise=0.0, vignetting=0.0)
    for pan, focal in ((0.3, 440.0), (np.pi - 0.1, 400.0), (-2.0, 900.0)):
        image, valid = warp_background(panorama, camera_of(optics), ViewPlace(pan, optics.tilt_rad, focal))
        seen = synthetic.render(optics, pan, focal)
        assert valid.mean() > 0.99
        difference = np.abs(image.astype(float) - seen)[valid]
        shifted = np.abs(np.roll(image, 1, axis=1).astype(float) - seen)[valid]
        assert difference.mean() < 0.5 * shifted.mean()
        assert difference.mean() < 4.0


def test_beyond_the_panorama_nothing_is_known() -> None:
    panorama, optics = whole_turn(0), synthetic.Optics()
    image, valid = warp_background(panorama, camera_of(optics), ViewPlace(0.0, 0.9, 440.0))
    assert not valid[:40].any()
    assert valid[-40:].any()
    assert (image[~valid] == 0).all()
