"""Appearance of the skin: the brightness of each of its points in each view, learned from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from pzcap.body.skeleton import Body
from pzcap.imaging.interpolation import bilinear
from pzcap.tracking.observation import PYRAMID_LEVELS, Placed, Views
from pzcap.tracking.tuning import APPEARANCE, BRIGHTNESS
from pzcap.types import Array, Float32, Image


@dataclass(slots=True, eq=False)
class Appearance:
    """Brightness of each point of the skin in one view, per pyramid level, and how far that is to be trusted."""

    value: Float32  # (PYRAMID_LEVELS, V)
    trust: Float32  # (V,) 0 unseen .. 1

    def copy(self) -> Appearance:
        return Appearance(self.value.copy(), self.trust.copy())

    def with_other(self, other: Appearance) -> Appearance:
        """The mean of both, each weighted by its trust."""
        trust = self.trust + other.trust
        share = np.divide(other.trust, trust, out=np.zeros_like(trust), where=trust > 0.0)
        value = self.value + share * (other.value - self.value)
        return Appearance(value, np.maximum(self.trust, other.trust))

    @staticmethod
    def unseen(body: Body) -> Appearance:
        points = len(body.surface.points_m)
        return Appearance(np.zeros((PYRAMID_LEVELS, points), np.float32), np.zeros(points, np.float32))


Appearances = Sequence[Appearance]  # one a view
SomeAppearances = Sequence[Appearance | None]  # one a view; None: the brightness of the view does not count


def learn(views: Views, placed: Placed, appearances: Appearances, rate: float, kept: float = 1.0) -> None:
    """Let the ``appearances`` of what is visible, a view each, adapt by ``rate`` to a frame in which the body is where
    it was ``placed``; new points are taken as they are. Trust in what is not visible falls to the share ``kept``."""
    for view, where, appearance in zip(views, placed, appearances, strict=True):
        if view is not None and where is not None:
            corner = float(view.left), float(view.top)
            looks = appearance.value, appearance.trust
            _adapt(view.pyramid, corner, where.skin.pixels, where.facing, (rate, kept), *looks)


def mean_appearances(body: Body, views: Sequence[Views], placed: Sequence[Placed]) -> list[Appearance]:
    """Mean appearance of each point of the skin over some frames, a view each."""
    means = [Appearance.unseen(body) for _ in placed[0]]
    for count, (here, where) in enumerate(zip(views, placed, strict=True), start=1):
        learn(here, where, means, 1.0 / count, BRIGHTNESS.kept)
    return means


def shared(appearances: Appearances) -> list[Appearance]:
    """Appearances, a view each, in which what a view has not seen is as the others have it: a limb that turns shows one
    camera what others have seen, and but for a gain it looks the same."""
    trust, value = np.array([look.trust for look in appearances]), np.array([look.value for look in appearances])
    mean = np.einsum("cv,clv->lv", trust, value) / np.maximum(trust.sum(axis=0), np.float32(1e-6))
    elsewhere = np.float32(APPEARANCE.trust_elsewhere) * trust.max(axis=0)
    return [
        Appearance(np.where(look.trust > 0.0, look.value, mean), np.maximum(look.trust, elsewhere))
        for look in appearances
    ]


@njit(cache=True, nogil=True)
def _adapt(
    pyramid: tuple[Image, ...], corner: tuple[float, float], pixels: Array, facing: Float32, rates: tuple[float, float],
    value: Float32, trust: Float32,
) -> None:  # fmt: skip
    """Move the appearance of all points that face the camera to what the pyramid has there by the first of the
    ``rates``; trust in others falls to the second, a share of itself."""
    rate, kept = rates
    height, width = pyramid[-1].shape
    coarsest = 2.0 ** (len(pyramid) - 1)
    for n in range(len(pixels)):
        x, y = pixels[n, 0] - corner[0], pixels[n, 1] - corner[1]
        within = 1.0 <= x / coarsest < width - 2.0 and 1.0 <= y / coarsest < height - 2.0
        if facing[n] <= BRIGHTNESS.learned_facing or not within:
            trust[n] *= np.float32(kept)
            continue
        fresh = trust[n] <= 0.0
        scale = 1.0
        for level in range(len(pyramid)):
            here = bilinear(pyramid[level], x * scale, y * scale)
            value[level, n] += (1.0 if fresh else rate) * (here - value[level, n])
            scale *= 0.5
        trust[n] = 0.3 if fresh else min(trust[n] + 0.2, 1.0)
