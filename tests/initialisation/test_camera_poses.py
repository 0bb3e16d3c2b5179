"""Cameras placed by what moves before them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.initialisation.camera_poses import HeadRays, Heads, place_heads
from pzcap.types import Array, PzcapError

_PLACES_M = np.array([[-10.5, -8.0, 1.7], [10.5, -8.0, 1.6], [10.5, 8.0, 1.9], [-10.5, 8.0, 1.8]])


def _rotations(lean_rad: float) -> Array:
    """World from heads that look at the middle, their pan axes leaning by some angle, each another way."""
    towards = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    lean = Rotation.from_rotvec(lean_rad * np.column_stack([towards, np.zeros(4)]))
    heading = Rotation.from_euler("z", np.arctan2(-_PLACES_M[:, 1], -_PLACES_M[:, 0])[:, None])
    return np.asarray((lean * heading).as_matrix())


def _seen(noise_m: float, wrong: float, lean_rad: float = 0.003, frames: int = 15) -> HeadRays:
    """Rays to somebody who crosses the hall, some of them to another point."""
    rng = np.random.default_rng(0)
    root = np.column_stack(
        [np.linspace(-2.0, 2.0, frames), np.sin(np.linspace(0.0, 3.0, frames)), np.full(frames, 1.0)]
    )
    points = (root[:, None] + rng.normal(0.0, 0.35, (1, 26, 3))).reshape(-1, 3)
    way = np.einsum("cji,cnj->cni", _rotations(lean_rad), points[None] - _PLACES_M[:, None])
    length = np.linalg.norm(way, axis=2, keepdims=True)
    directions = way / length + rng.normal(0.0, noise_m, way.shape) / length
    bad = rng.uniform(size=way.shape[:2]) < wrong
    directions[bad] = np.roll(directions, 1, axis=1)[bad]
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return HeadRays(np.zeros_like(way), directions, np.full(way.shape[:2], 0.9))


def _aligned(found: Heads) -> Heads:
    """The heads after the similarity that brings their places nearest to the true ones."""
    a, b = found.place - found.place.mean(axis=0), _PLACES_M - _PLACES_M.mean(axis=0)
    u, values, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation, scale = (u * signs) @ vt, float(values @ signs) / float(np.sum(a * a))
    return found.moved(rotation, scale, _PLACES_M.mean(axis=0) - scale * rotation @ found.place.mean(axis=0))


def test_exact_rays_place_the_cameras_exactly_but_for_a_similarity() -> None:
    found = _aligned(place_heads(_seen(0.0, 0.0, lean_rad=0.0)))
    np.testing.assert_allclose(found.place, _PLACES_M, atol=1e-4)
    np.testing.assert_allclose(found.rotation, _rotations(0.0), atol=1e-5)


def test_noisy_rays_place_them_to_what_they_say_though_some_are_wrong() -> None:
    found = _aligned(place_heads(_seen(0.015, 0.1, frames=40)))
    off_m = np.linalg.norm(found.place - _PLACES_M, axis=1)
    sigma_m = np.array([np.sqrt(np.trace(found.covariance[k : k + 3, k : k + 3])) for k in (3, 9, 15, 21)])
    assert off_m.max() < 0.06
    assert np.all(off_m < 2.0 * sigma_m)
    assert sigma_m.max() < 0.2
    assert found.sigma_rad == pytest.approx(0.015 / 13.2, rel=0.15)


def test_a_camera_that_sees_too_little_is_left_out() -> None:
    rays = _seen(0.01, 0.0)
    rays.confidence[2, 20:] = 0.0
    assert place_heads(rays).placed.tolist() == [True, True, False, True]


def test_cameras_that_do_not_see_the_athlete_together_are_refused() -> None:
    rays = _seen(0.01, 0.0)
    for camera in range(4):
        rays.confidence[camera, np.arange(rays.confidence.shape[1]) % 4 != camera] = 0.0
    with pytest.raises(PzcapError, match="together"):
        place_heads(rays)


def test_rays_that_do_not_meet_are_refused() -> None:
    rays, rng = _seen(0.01, 0.0), np.random.default_rng(1)
    anywhere = rng.normal(size=rays.directions.shape)
    anywhere /= np.linalg.norm(anywhere, axis=2, keepdims=True)
    with pytest.raises(PzcapError, match="agree"):
        place_heads(rays._replace(directions=anywhere))
