"""The covariance that all frames share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.calibration.settings import PanZoomConfig
from pzcap.localisation.covariance import systematic
from pzcap.types import Array, PanZoomCamera
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of

FOCAL = synthetic.Optics().reference_focal_px
BARE = PanZoomConfig(floor_px=0.0, floor_edge_px=0.0)
ZOOMS = np.array([1.0, 2.0, 4.0])


@pytest.fixture
def camera() -> PanZoomCamera:
    """Its covariance is another one at each of eight pans and three zooms."""
    root = np.random.default_rng(0).normal(0.0, 1e-4, (8, 3, 2, 2))
    found = camera_of(synthetic.Optics())
    lens = replace(found.lens, k1=np.array([0.0, 0.0]))
    return replace(found, lens=lens, shared_zooms=ZOOMS, shared_covariance=root @ root.swapaxes(-1, -2))


def at(camera: PanZoomCamera, pan_rad: float, zoom: float) -> Array:
    return systematic(BARE, camera, np.array(pan_rad), np.array(camera.lens.reference_focal_px * zoom))


def test_it_is_what_calibration_leaves_there(camera: PanZoomCamera) -> None:
    for pan in range(-4, 8):
        for number, zoom in enumerate(ZOOMS.tolist()):
            wanted = camera.shared_covariance[pan % 8, number]
            np.testing.assert_allclose(at(camera, pan * np.pi / 4, zoom), wanted, rtol=1e-9, atol=1e-16)


def test_between_it_is_interpolated_round_the_turn(camera: PanZoomCamera) -> None:
    known = camera.shared_covariance
    for pan, left, right in ((0.5, 0, 1), (-0.5, 7, 0), (3.5, 3, 4)):
        wanted = (known[left, 0] + known[right, 0] + known[left, 1] + known[right, 1]) / 4
        np.testing.assert_allclose(at(camera, pan * np.pi / 4, np.sqrt(2.0)), wanted, rtol=1e-9)


def test_beyond_the_zooms_it_is_that_of_the_last(camera: PanZoomCamera) -> None:
    for zoom, number in ((0.5, 0), (9.0, 2)):
        np.testing.assert_allclose(at(camera, 0.0, zoom), camera.shared_covariance[0, number], rtol=1e-9)


def test_many_frames_at_once_are_each_by_itself(camera: PanZoomCamera) -> None:
    pan, focal = np.linspace(-3.0, 3.0, 7), np.linspace(0.8, 5.0, 7) * camera.lens.reference_focal_px
    every = systematic(BARE, camera, pan, focal)
    for number in range(7):
        np.testing.assert_allclose(every[number], systematic(BARE, camera, pan[number], focal[number]), rtol=1e-12)


def test_without_it_the_scale_of_the_sweep_stands_for_it(camera: PanZoomCamera) -> None:
    bare = replace(camera, shared_zooms=np.zeros(0), shared_covariance=np.zeros((0, 0, 2, 2)), focal_sigma=1e-3)
    stretch = np.array([-0.5, 1.0]) * 1e-3
    np.testing.assert_allclose(at(bare, 0.5, 1.5), np.outer(stretch, stretch), rtol=1e-9)
