"""The Cramer-Rao bound: an efficient estimator reaches it and no more, and it moves as it must."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from experiments.bound import AROUND_PX, Scene, Sensor, _field, blur_level, build_scene, information, least_covariance
from pzcap.geometry.camera import View, pixel_to_direction
from pzcap.geometry.cylinder import to_unwrapped
from pzcap.geometry.lens import at as lens_at
from pzcap.types import Array, Lens, Mask, Panorama

FINE = 3  # pixels of the scene to one of the panorama
PX_PER_RAD = 220.0
ROWS = 260
LENS = Lens(128, 96, PX_PER_RAD, np.array([[64.2, 47.1], [0.5, -0.3]]), np.array([-0.05, 0.06]))
SENSOR = Sensor(read_noise=2.0, shot_noise=0.02, vignetting=0.8)
NOTHING = np.zeros((LENS.height, LENS.width), bool)
GREY = np.array([0.114, 0.587, 0.299])


def view_at(zoom: float) -> View:
    focal = PX_PER_RAD * zoom
    principal, distortion = lens_at(LENS, focal)
    return View(0.3, -0.07, 0.01, focal, principal, distortion)


def draw_scene(smooth: float, contrast: float = 40.0) -> Array:
    """(H, W, 3) grey levels, ``FINE`` times as fine as the panorama, its texture ``smooth`` panorama pixels wide."""
    rng = np.random.default_rng(1)
    width = round(PX_PER_RAD * 2.0)  # of two radians about azimuth 0.3
    texture = rng.normal(size=(ROWS * FINE, width * FINE, 3)).astype(np.float32)
    texture = cv2.GaussianBlur(texture, (0, 0), smooth * FINE)
    texture = 0.7 * texture.mean(axis=2, keepdims=True) + 0.3 * texture
    return np.asarray(np.clip(120.0 + contrast * texture / texture.std(), 5, 250), np.float64)


def panorama_of(scene: Array, sweeps: int, noise_seed: int | None = 0) -> Panorama:
    """What a sweep would leave of ``scene``: every pixel the mean of so many noisy ones, rounded."""
    height, width = scene.shape[0] // FINE, scene.shape[1] // FINE
    level = scene.reshape(height, FINE, width, FINE, 3).mean(axis=(1, 3))
    if noise_seed is not None:
        variance = (SENSOR.read_noise**2 + 1 / 12 + SENSOR.shot_noise * level) / sweeps
        level = level + np.sqrt(variance) * np.random.default_rng(noise_seed).normal(size=level.shape)
    pan = np.linspace(-0.5, 0.5, 2000)  # as many as give `sweeps` frames a place
    field = 2 * np.arctan(LENS.width / 2 / PX_PER_RAD)
    return Panorama(
        image=np.clip(np.rint(level), 0, 255).astype(np.uint8),
        valid=np.ones((height, width), bool),
        px_per_rad=PX_PER_RAD,
        origin_px=np.array([(width - 1) / 2 + 0.3 * PX_PER_RAD, (height - 1) / 2]),
        full_turn=False,
        sweep_pan_rad=pan[np.linspace(0, len(pan) - 1, round(sweeps * (1.0 + field) / field)).astype(int)],
        sweep_inliers=np.zeros(0, np.int64),
        closure_rad=0.0,
        residual_px=0.0,
    )


def render(scene: Array, panorama: Panorama, pan_rad: float, zoom: float, around: View) -> Array:
    """(N, 3) what the pixels of a frame see of ``scene``, each averaged over its area; the lens follows the zoom."""
    samples = 4
    principal, distortion = lens_at(LENS, PX_PER_RAD * zoom)
    view = replace(around, pan_rad=pan_rad, focal_px=PX_PER_RAD * zoom, principal_px=principal, distortion=distortion)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    u = (np.arange(LENS.width)[:, None] + offsets).ravel()
    v = (np.arange(LENS.height)[:, None] + offsets).ravel()
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    place = to_unwrapped(panorama, *pixel_to_direction(view, pixels))
    fine = (place + 0.5) * FINE - 0.5
    shape = LENS.height, samples, LENS.width, samples
    channels = [map_coordinates(scene[..., c], [fine[..., 1], fine[..., 0]], order=1) for c in range(3)]
    flat = np.stack([c.reshape(shape).mean(axis=(1, 3)) for c in channels], axis=-1)
    u, v = np.meshgrid(np.arange(LENS.width), np.arange(LENS.height))
    squared = (u - around.principal_px[0]) ** 2 + (v - around.principal_px[1]) ** 2
    light = 1.0 - (1.0 - SENSOR.vignetting) * squared / ((LENS.width**2 + LENS.height**2) / 4)
    return np.asarray((flat * light[..., None]).reshape(-1, 3))


@pytest.mark.parametrize(("zoom", "smooth"), [(0.6, 0.9), (1.0, 1.2), (2.0, 1.3)])
def test_an_efficient_estimator_reaches_the_bound(zoom: float, smooth: float) -> None:
    """Gauss-Newton over pan, log focal and gain, which knows the scene perfectly, on noisy frames of its own making."""
    scene = draw_scene(smooth)
    panorama, view = panorama_of(scene, 20), view_at(zoom)
    truth = render(scene, panorama, view.pan_rad, zoom, view)
    variance = (SENSOR.read_noise**2 + SENSOR.shot_noise * truth + 1 / 12) @ GREY**2
    step = 1e-4
    jacobian = np.column_stack([
        (render(scene, panorama, view.pan_rad + step, zoom, view)
         - render(scene, panorama, view.pan_rad - step, zoom, view)) @ GREY / (2 * step),
        (render(scene, panorama, view.pan_rad, zoom * np.exp(step), view)
         - render(scene, panorama, view.pan_rad, zoom * np.exp(-step), view)) @ GREY / (2 * step),
        truth @ GREY,
    ])  # fmt: skip
    weighted = jacobian / variance[:, None]
    solver = np.linalg.solve(weighted.T @ jacobian, weighted.T)

    rng = np.random.default_rng(3)
    start = render(scene, panorama, view.pan_rad + 2e-4, zoom * np.exp(-2e-4), view) @ GREY
    errors = np.empty((1000, 2))
    for trial in range(len(errors)):
        noisy = truth + np.sqrt(SENSOR.read_noise**2 + SENSOR.shot_noise * truth) * rng.normal(size=truth.shape)
        observed = np.rint(noisy) @ GREY
        found = np.array([2e-4, -2e-4, 0.0]) + solver @ (observed - start)
        if trial < 50:  # one step is enough: a second one changes less than a tenth of a sigma
            again = render(scene, panorama, view.pan_rad + found[0], zoom * np.exp(found[1]), view) @ GREY
            change = solver @ (observed - np.exp(found[2]) * again)
            assert np.abs(change[0]) < 4e-7
            assert np.abs(change[1]) < 4e-6
        errors[trial] = found[:2]
    reached = np.sqrt(np.mean(errors**2, axis=0))
    np.testing.assert_allclose(reached, sigmas(scene_of(panorama, zoom), zoom), rtol=0.1)


def scene_of(panorama: Panorama, zoom: float) -> Scene:
    return build_scene(panorama, SENSOR, blur_level(panorama, PX_PER_RAD * zoom), LENS.width)


def sigmas(scene: Scene, zoom: float, hidden: Mask = NOTHING, stride: int = 1) -> Array:
    """(2,) the bound for pan and log focal."""
    covariance = least_covariance(information(scene, LENS, view_at(zoom), hidden, stride))
    assert covariance is not None
    return np.sqrt(np.diag(covariance))


def test_a_frame_that_shrinks_the_hall_knows_less_than_the_panorama_shows() -> None:
    """The test above would miss its margin without the blur of a zoomed-out pixel."""
    panorama = panorama_of(draw_scene(0.9), 20)
    unblurred = build_scene(panorama, SENSOR, 1.0, LENS.width)
    assert np.all(sigmas(unblurred, 0.6) < 0.9 * sigmas(scene_of(panorama, 0.6), 0.6))


def test_noise_of_the_panorama_does_not_pass_for_texture() -> None:
    """A faint hall, and a sweep of two frames a place: as much noise as texture."""
    scene = draw_scene(1.2, contrast=3.0)
    clean = sigmas(scene_of(panorama_of(scene, 1000, None), 1.0), 1.0)
    noisy = scene_of(panorama_of(scene, 2), 1.0)
    assert np.all(sigmas(replace(noisy, noise_gain=0.0), 1.0) < 0.85 * clean)
    np.testing.assert_allclose(sigmas(noisy, 1.0), clean, rtol=0.06)


def test_derivatives_by_log_focal_match_finite_differences() -> None:
    panorama, view, step = panorama_of(draw_scene(1.2), 20), view_at(1.3), 1e-4
    field = _field(panorama, LENS, view, 1)
    u, v = np.meshgrid(np.arange(LENS.width), np.arange(LENS.height))
    pixels = np.stack([u, v], axis=-1).astype(np.float64)
    places = []
    for sign in (-1, 1):
        focal = view.focal_px * np.exp(sign * step)
        principal, distortion = lens_at(LENS, focal)
        moved = replace(view, focal_px=focal, principal_px=principal, distortion=distortion)
        places.append(to_unwrapped(panorama, *pixel_to_direction(moved, pixels)))
    np.testing.assert_allclose(field[..., :2], (places[0] + places[1]) / 2, atol=0.01)
    np.testing.assert_allclose(field[..., 2:], (places[1] - places[0]) / (2 * step), atol=0.05)


@pytest.fixture(scope="module")
def hall() -> Scene:
    return scene_of(panorama_of(draw_scene(1.2), 20), 1.0)


def test_every_second_pixel_tells_enough(hall: Scene) -> None:
    """Here it is 3000 pixels; of a frame of 640 x 480, where it is 77 000, the difference is 0.2 %."""
    np.testing.assert_allclose(sigmas(hall, 1.0, stride=2), sigmas(hall, 1.0), rtol=0.04)


def test_sigma_grows_with_the_noise(hall: Scene) -> None:
    quiet, loud = Sensor(2.0, 0.0, 0.8), Sensor(8.0, 0.0, 0.8)
    # many frames averaged, so that what is taken off for the panorama's noise is nothing
    few = [replace(hall, sensor=sensor, averaged=1e6) for sensor in (quiet, loud)]
    ratio = np.sqrt((64 + 1 / 12) / (4 + 1 / 12))
    np.testing.assert_allclose(sigmas(few[1], 1.0), ratio * sigmas(few[0], 1.0), rtol=0.01)


boxes = st.tuples(st.integers(0, 100), st.integers(0, 70), st.integers(1, 60), st.integers(1, 60))


@settings(max_examples=25, deadline=None)
@given(boxes, boxes)
def test_who_sees_less_knows_less(hall: Scene, one: tuple[int, ...], two: tuple[int, ...]) -> None:
    less, least = NOTHING.copy(), NOTHING.copy()
    for mask, rectangles in ((less, [one]), (least, [one, two])):
        for x, y, width, height in rectangles:
            mask[y : y + height, x : x + width] = True
    assert np.all(sigmas(hall, 1.0) <= sigmas(hall, 1.0, less) * (1 + 1e-6))
    assert np.all(sigmas(hall, 1.0, less) <= sigmas(hall, 1.0, least) * (1 + 1e-6))


def test_a_gain_to_be_estimated_costs_something(hall: Scene) -> None:
    found = information(hall, LENS, view_at(1.0), NOTHING, 1)
    known = np.linalg.inv(found[:2, :2])
    least = least_covariance(found)
    assert least is not None
    assert np.all(np.diag(least) >= np.diag(known))


def test_pixels_that_the_panorama_does_not_know_tell_nothing(hall: Scene) -> None:
    panorama = hall.panorama
    half = panorama.valid.copy()
    half[:, : half.shape[1] // 2] = False
    cut = scene_of(replace(panorama, valid=half), 1.0)
    hidden = NOTHING.copy()
    hidden[:, : LENS.width // 2 - AROUND_PX] = True  # what is left of azimuth 0.3, where the view looks
    np.testing.assert_allclose(sigmas(cut, 1.0), sigmas(hall, 1.0, hidden), rtol=0.05)


def test_a_view_of_the_athlete_alone_is_not_bounded(hall: Scene) -> None:
    assert least_covariance(information(hall, LENS, view_at(1.0), ~NOTHING)) is None
