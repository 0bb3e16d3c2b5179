"""Triangulation of keypoints that some views may have wrong: of all pairs of views the one most others agree with."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.types import Array, Camera, Mask


class Rays(NamedTuple):
    """Rays of K keypoints in V views."""

    origins: Array  # (V, 3) projection centres
    directions: Array  # (V, K, 3) unit vectors
    confidence: Array  # (V, K) 0 where a view has none


class Triangulated(NamedTuple):
    """Points where rays meet."""

    points_m: Array  # (K, 3)
    agreeing: Mask  # (V, K) views whose rays meet there
    misses_m: Array  # (V, K) distances of all rays from the points

    @property
    def found(self) -> Mask:
        """(K,) of which two views or more agree."""
        return np.asarray(self.agreeing.sum(axis=0) >= 2)


def rays_of(views: Sequence[tuple[Camera, Array]], least_confidence: float) -> Rays:
    """The rays of one person's keypoints, (K, 3) a view; those found with less than ``least_confidence`` do not
    count."""
    confidence = np.array([person[:, 2] for _, person in views])
    return Rays(
        np.array([camera.world_T_cam[:3, 3] for camera, _ in views]),
        np.array([geometry.rays(camera, person[:, :2]) for camera, person in views]),
        np.where(confidence < least_confidence, 0.0, confidence),
    )


def triangulate(rays: Rays, agree_m: float) -> Triangulated:
    """Intersect ``rays``. Of all pairs of views the one is taken whose point most confidence agrees with, to within
    ``agree_m``; then all views that agree with it are used."""
    origins, directions, confidence = rays
    across = np.eye(3) - directions[..., :, None] * directions[..., None, :]  # (V, K, 3, 3) what is beside a ray
    beside = np.einsum("vkij,vj->vki", across, origins)

    def solve(weight: Array) -> Array:
        """The points nearest to all rays of some ``weight`` (V, K)."""
        weighted = np.einsum("vk,vkij->kij", weight, across) + 1e-12 * np.eye(3)
        return np.asarray(np.linalg.solve(weighted, np.einsum("vk,vki->ki", weight, beside)[..., None])[..., 0])

    def miss(at: Array) -> Array:
        """Distances (V, K) between the rays and points (K, 3)."""
        return np.asarray(np.linalg.norm(np.einsum("vkij,kj->vki", across, at) - beside, axis=-1))

    count = confidence.shape[1]
    best, agreeing = np.zeros(count), np.zeros(confidence.shape, bool)
    for pair in combinations(range(len(origins)), 2):
        both = np.zeros(confidence.shape)
        both[list(pair)] = np.all(confidence[list(pair)] > 0.0, axis=0)
        agree = (miss(solve(both)) < agree_m) & (confidence > 0.0) & both.any(axis=0)
        worth = np.where(agree[list(pair)].all(axis=0), np.sum(confidence * agree, axis=0), 0.0)
        agreeing = np.where(worth > best, agree, agreeing)
        best = np.maximum(worth, best)
    points = solve(confidence**2 * agreeing)
    return Triangulated(points, agreeing, miss(points))
