"""Drape of loose clothes: where each piece hangs beside the body, an unknown of every frame that is eliminated.

What the images show of a clothed segment is its skin, wide enough for the cloth (`pzcap.body.skeleton`), displaced by
``d`` (3,), the same in all views. A priori ``d`` is normal about a lag behind the segment's motion, as large as the
cloth leaves room for. All residuals see the body's motion and the drape alike: with the twist ``x = (v, w)`` of the
segment, a residual is ``r - A (x + E d)``, ``E d = (d, 0)``. The best drape of a twist,

    d = k - K x,   k = C (E'g + P m),   K = C E'H,   C = (E'H E + P)^-1,

(``H``, ``g`` the segment's normal equations in all views, ``m`` the prior mean of what is still to come, ``P`` the
prior's information) is put back into each view's equations, ``H <- M'H M`` and ``g <- M'(g - H E k)`` with
``M = I - E K``, and the prior of the drape is added once. So bare skin and shoes carry the pose, and where only cloth
could tell, the covariance of the pose says that it does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pzcap.body.segment_equations import SegmentSums
from pzcap.body.skeleton import MOVES
from pzcap.tracking.tuning import DRAPE
from pzcap.types import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class MarginalisedDrape:
    """Best drape of each loose segment as it follows from the segment's twist."""

    segments: Indices  # (L,)
    ahead: Array  # (L, 3) k
    follows: Array  # (L, 3, 6) K

    def step(self, twists: Array) -> Array:
        """(16, 3) change of the drape with the segments' ``twists`` (16, 6)."""
        change = np.zeros((len(twists), 3))
        change[self.segments] = self.ahead - np.einsum("lij,lj->li", self.follows, twists[self.segments])
        return change


class Eliminated(NamedTuple):
    """Normal equations without the drape."""

    views: list[SegmentSums]
    prior: SegmentSums  # of the drape, once for all views
    drape: MarginalisedDrape


def expected_drape(loose_m: Array, velocity: Array | None) -> Array:
    """(16, 3) the drape to be expected of pieces ``loose_m`` (16,) off the skin, with the segments' velocities (16, 6),
    a frame period, or rates that begin with these: behind their motion."""
    if velocity is None:
        return np.zeros((len(loose_m), 3))
    speed = np.linalg.norm(velocity[:, :3], axis=1, keepdims=True)
    return -DRAPE.lag * loose_m[:, None] * velocity[:, :3] / (speed + DRAPE.half_m)


def eliminate_drape(views: list[SegmentSums], loose_m: Array, drape: Array, expected: Array) -> Eliminated:
    """Take the drape out of the normal equations that ``views`` have made with it at ``drape`` (16, 3)."""
    segments = np.flatnonzero(loose_m)
    total, gradient = (np.sum([view[k][segments] for view in views], axis=0) for k in range(2))
    information = 1.0 / (DRAPE.sigma * loose_m[segments]) ** 2
    still = (expected - drape)[segments]
    own = np.linalg.inv(total[:, :3, :3] + information[:, None, None] * np.eye(3))
    ahead = np.einsum("lij,lj->li", own, gradient[:, :3] + information[:, None] * still)
    follows = own @ total[:, :3]
    mix = np.tile(np.eye(6), (len(segments), 1, 1))
    mix[:, :3] -= follows
    turned = mix.transpose(0, 2, 1)
    left = []
    for view in views:
        hessians, gradients = view.hessians.copy(), view.gradients.copy()
        moved = gradients[segments] - np.einsum("lij,lj->li", hessians[segments][:, :, :3], ahead)
        gradients[segments] = np.einsum("lij,lj->li", turned, moved)
        hessians[segments] = turned @ hessians[segments] @ mix
        left.append(SegmentSums(hessians, gradients, view.centre))
    prior = SegmentSums.zero(views[0].centre)
    prior.hessians[segments] = information[:, None, None] * (follows.transpose(0, 2, 1) @ follows)
    off = information[:, None] * (ahead - still)
    prior.gradients[segments] = np.einsum("lji,lj->li", follows, off)
    return Eliminated(left, prior, MarginalisedDrape(segments, ahead, follows))


def segments_twists(step: Array, twists: Array) -> Array:
    """(16, 6) twists of the segments by a ``step`` (43,) of the pose, whose screws are ``twists`` (43, 6)."""
    return np.asarray(MOVES.astype(np.float64).T @ (step[:, None] * twists))
