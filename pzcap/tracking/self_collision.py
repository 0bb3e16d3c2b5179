"""No arm enters the trunk: what holds a forearm that no contour and no texture holds.

Seen by nothing, a forearm that is held before the chest could as well be inside it. The trunk is taken for three
ellipsoids and each forearm with its hand for balls along it; how deep a ball is in an ellipsoid is one residual.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.body.skeleton import DOF, Body, point_jacobian
from pzcap.types import SEGMENTS, Array

_TRUNK: Final = tuple(SEGMENTS.index(name) for name in ("pelvis", "lumbar", "thorax"))
_BALLS: Final = (("forearm", 0.5), ("forearm", 1.0), ("hand", 0.5))
"""Segments of an arm, and how far along each a ball stands, as a share of its length."""
_GIVES_M: Final = 0.015  # so far skin gives way, or is not where the body has it
_SIGMA_M: Final = 0.02  # and hardly further


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """The trunk as ellipsoids (E), both arms as balls (B)."""

    centres_m: Array  # (E, 3) in the frames of the trunk's segments
    axes_m: Array  # (E, 3) half axes
    segment: NDArray[np.int64]  # (B,) that each ball is fixed to
    points_m: Array  # (B, 3) in the frame of that
    radii_m: Array  # (B,)


@lru_cache(maxsize=4)
def shapes(body: Body) -> Shapes:
    """Fit ellipsoids and balls to the skin."""
    skin = body.surface
    low, high = (np.array([f(skin.points_m[skin.segment == s], axis=0) for s in _TRUNK]) for f in (np.min, np.max))
    segment, points, radii = [], [], []
    for side in ("left_", "right_"):
        for name, share in _BALLS:
            s = SEGMENTS.index(side + name)
            own = skin.points_m[skin.segment == s]
            end = body.offsets_m[s + 1] if name == "forearm" else np.array([0.0, 0.0, own[:, 2].min()])
            near = own[np.abs(own[:, 2] - share * end[2]) < 0.03]
            segment.append(s)
            points.append(share * end)
            radii.append(np.ptp(near, axis=0)[:2].min() / 2 - _GIVES_M)
    return Shapes(0.5 * (low + high), 0.5 * (high - low), np.array(segment), np.array(points), np.array(radii))


def residuals(solid: Shapes, world_T_segment: Array) -> tuple[Array, Array]:
    """How deep each ball is that is inside the trunk, in sigmas (N,), and the derivative of that (N, 43)."""
    arms, trunk = world_T_segment[solid.segment], world_T_segment[list(_TRUNK)]
    balls = np.einsum("bij,bj->bi", arms[:, :3, :3], solid.points_m) + arms[:, :3, 3]
    local = np.einsum("eij,ebi->ebj", trunk[:, :3, :3], balls - trunk[:, None, :3, 3]) - solid.centres_m[:, None]
    axes = solid.axes_m[:, None] + solid.radii_m[:, None]  # (E, B, 3)
    level = np.sqrt(np.sum((local / axes) ** 2, axis=-1))  # 0 in the middle .. 1 on the skin
    inside = np.argwhere(level < 1.0)
    rows, depth = np.zeros((len(inside), DOF)), np.zeros(len(inside))
    for n, (e, b) in enumerate(inside):
        scale = axes[e, b].min() / _SIGMA_M
        outward = trunk[e, :3, :3] @ (local[e, b] / axes[e, b] ** 2) / max(level[e, b], 1e-3)
        arm, under = (point_jacobian(world_T_segment, int(s), balls[b]) for s in (solid.segment[b], _TRUNK[e]))
        rows[n], depth[n] = -scale * outward @ (arm - under), scale * (1.0 - level[e, b])
    return rows, depth
