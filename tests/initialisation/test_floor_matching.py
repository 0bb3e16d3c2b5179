"""Heads placed by the floor that their panoramas show, which is painted here."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from pzcap.geometry.cylinder import from_panorama
from pzcap.initialisation.camera_poses import Heads
from pzcap.initialisation.floor_matching import displacement, levelled, place_by_floor
from pzcap.initialisation.tuning import FLOOR
from pzcap.scoring.body_errors import similarity_of
from pzcap.types import Array, Image, Panorama

_PLACES_M = np.array([[-9.0, -7.0, 1.7], [9.0, -7.0, 1.6], [9.0, 7.0, 2.0]])
_PX_PER_RAD = 400.0
_LEAN_RAD = 0.004
"""Of all heads together, which no ray tells."""


def _rotations() -> Array:
    """World from heads that look at the middle and lean."""
    heading = Rotation.from_euler("z", np.arctan2(-_PLACES_M[:, 1], -_PLACES_M[:, 0])[:, None])
    return np.asarray((Rotation.from_rotvec([_LEAN_RAD, 0.0, 0.0]) * heading).as_matrix())


def _texture(side_m: float, repeated_m: float | None = None) -> Image:
    """A floor with spots of all sizes, 50 pixels a metre; the same again after ``repeated_m``."""
    rng, size = np.random.default_rng(3), round(50 * (repeated_m or side_m))
    noise = rng.normal(size=(size, size))
    spots = sum(gaussian_filter(noise, width, mode="wrap") * width for width in (3.0, 8.0, 20.0))
    image = np.clip(128.0 + 45.0 * spots / np.std(spots), 0, 255).astype(np.uint8)
    times = int(np.ceil(side_m * 50 / size))
    return np.tile(image, (times, times))


def _panorama(rotation: Array, place_m: Array, floor: Image) -> Panorama:
    """The ``floor`` as a head there sees it, in the upright world; the wall is bare."""
    width, height, origin = round(2 * np.pi * _PX_PER_RAD), 420, np.array([np.pi * _PX_PER_RAD, 40.0])
    blank = Panorama(
        np.zeros((height, width, 3), np.uint8), np.ones((height, width), bool), width / (2 * np.pi), origin, True,
        np.zeros(0), np.zeros(0, np.int64), 0.0, 0.0,
    )  # fmt: skip
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    azimuth, slope = from_panorama(blank, np.stack([column, row], axis=-1).astype(float))
    way = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=-1) @ rotation.T
    reach = np.where(way[..., 2] < -0.02, -place_m[2] / np.minimum(way[..., 2], -0.02), 0.0)
    points = place_m + reach[..., None] * way
    middle = len(floor) / 2.0
    at_px = (middle + 50.0 * points[..., :2]).astype(np.float32)
    seen = cv2.remap(floor, at_px[..., 0], at_px[..., 1], cv2.INTER_AREA)
    grey = np.where(reach > 0.0, seen, 90).astype(np.uint8)
    return Panorama(
        cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), blank.valid, blank.px_per_rad, origin, True, np.zeros(0),
        np.zeros(0, np.int64), 0.0, 0.0,
    )  # fmt: skip


@cache
def _panoramas(repeated_m: float | None = None, bare: bool = False) -> tuple[Panorama, ...]:
    floor = _texture(44.0, repeated_m)
    floor = np.full_like(floor, 120) if bare else floor
    return tuple(_panorama(r, p, floor) for r, p in zip(_rotations(), _PLACES_M, strict=True))


def _rough(seed: int, sigma_m: float) -> Heads:
    """Heads as keypoints may have placed them, in a world that leans with them."""
    rng = np.random.default_rng(seed)
    upright = Rotation.from_rotvec([-_LEAN_RAD, 0.0, 0.0]).as_matrix()
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.003, (3, 3)))
    place = _PLACES_M @ upright.T + rng.normal(0.0, sigma_m, (3, 3))
    rotation = np.asarray((Rotation.from_matrix(upright @ _rotations()) * turned).as_matrix())
    covariance = np.diag(np.tile([0.003**2] * 3 + [sigma_m**2] * 3, 3))
    return Heads(rotation, place, np.ones(3, bool), np.zeros((0, 3)), np.zeros(0, bool), 0.0, covariance)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_floor_places_heads_to_millimetres_and_tells_the_vertical(seed: int) -> None:
    found = place_by_floor(_panoramas(), _rough(seed, 0.05))
    assert found is not None
    similarity = similarity_of(found.place, _PLACES_M)
    assert similarity is not None
    off_m = np.linalg.norm(similarity.apply(found.place) - _PLACES_M, axis=1)
    sigma_m = np.sqrt(np.diag(found.covariance).reshape(3, 6)[:, 3:].sum(axis=1))
    assert off_m.max() < 0.008
    assert np.all(off_m < 3.0 * sigma_m)
    assert sigma_m.max() < 0.01
    assert np.degrees(np.arccos(similarity.rotation[2, 2])) < 0.05  # both worlds have the floor level
    np.testing.assert_allclose(found.place[:, 2] * similarity.scale, _PLACES_M[:, 2], atol=0.01)
    turned = Rotation.from_matrix(_rotations().transpose(0, 2, 1) @ similarity.rotation @ found.rotation)
    assert np.degrees(turned.magnitude()).max() < 0.05


def test_a_bare_floor_tells_nothing() -> None:
    assert place_by_floor(_panoramas(bare=True), _rough(0, 0.05)) is None


def test_a_camera_that_shares_no_floor_with_the_others_leaves_keypoints_their_word() -> None:
    alone = _panoramas(bare=True)[0]
    assert place_by_floor((alone, *_panoramas()[1:]), _rough(0, 0.05)) is None


def test_a_pattern_that_repeats_is_not_believed() -> None:
    assert place_by_floor(_panoramas(repeated_m=1.0), _rough(0, 0.05)) is None


def test_a_floor_that_contradicts_what_is_known_is_not_believed() -> None:
    rough = _rough(0, 0.05)
    assert place_by_floor(_panoramas(), replace(rough, covariance=1e-4 * rough.covariance)) is None


@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_a_patch_is_found_where_it_is_to_a_sixth_of_a_pixel(down: float, across: float) -> None:
    picture = cv2.GaussianBlur(_texture(4.0), (0, 0), 1.5)
    moved = cv2.warpAffine(picture, np.array([[1.0, 0.0, across], [0.0, 1.0, down]]), picture.shape[::-1])
    patch, window = picture[80:121, 80:121], moved[72:129, 72:129]
    found = displacement(np.asarray(patch, np.uint8), np.asarray(window, np.uint8), 12)
    assert found is not None
    np.testing.assert_allclose(found, [down, across], atol=1 / 6)


def test_a_patch_at_the_rim_or_of_something_else_is_not_found() -> None:
    picture = _texture(4.0)
    patch: NDArray[np.uint8] = picture[80:121, 80:121]
    assert displacement(patch, picture[70:121, 60:111], 12) is None  # it lies beyond
    other = np.random.default_rng(5).integers(0, 255, (61, 61)).astype(np.uint8)
    assert displacement(patch, other, 12) is None


def test_heads_are_levelled_by_most_points_whatever_the_others_do() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-6.0, 6.0, (300, 2)), rng.normal(0.0, 0.002, 300)])
    points[:60, 2] += rng.uniform(0.1, 0.5, 60)
    lean = Rotation.from_rotvec([0.01, -0.02, 0.0]).as_matrix()
    heads = Heads(
        lean @ _rotations(), _PLACES_M @ lean.T + [0.0, 0.0, 0.3], np.ones(3, bool), points @ lean.T + [0.0, 0.0, 0.3],
        np.ones(300, bool), 0.0, np.zeros((18, 18)),
    )  # fmt: skip
    found = levelled(heads)
    assert abs(np.median(found.points[60:, 2])) < FLOOR.flat_m
    np.testing.assert_allclose(found.place[:, 2], _PLACES_M[:, 2], atol=0.01)
