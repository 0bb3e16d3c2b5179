"""Constraints of the body by itself: limits of the joints, a spine that bends evenly, and no arm inside the trunk.

How a trunk bends between hips and shoulders shows little, least on a body whose lengths are guessed: a trunk taken for
too long fits as well arched. Lumbar and thoracic joint are expected to bend little, and alike.

Hidden by contour and texture, a forearm that is held before the chest could as well be inside it. The trunk is taken
for three ellipsoids and each forearm with its hand for balls along it; how deep a ball is in an ellipsoid is one
residual.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from pzcap.body.kinematics import forward, joint_angles, limit_residuals, point_jacobians, world_points
from pzcap.body.skeleton import DOF_SEGMENT, Body
from pzcap.tracking.tuning import CONTACT, SPINE
from pzcap.types import DOF, SEGMENTS, Array, Indices, Pose

_TRUNK: Final = tuple(SEGMENTS.index(name) for name in ("pelvis", "lumbar", "thorax"))
_BALLS: Final = (("forearm", 0.5), ("forearm", 1.0), ("hand", 0.5))
"""Segments of an arm, and how far along each a ball stands, as a share of its length."""


@dataclass(frozen=True, slots=True, eq=False)
class CollisionShapes:
    """The trunk as ellipsoids (E), both arms as balls (B)."""

    centres_m: Array  # (E, 3) in the frames of the trunk's segments
    axes_m: Array  # (E, 3) half axes
    segment: Indices  # (B,) that each ball is fixed to
    points_m: Array  # (B, 3) in the frame of that
    radii_m: Array  # (B,)


@lru_cache(maxsize=4)
def collision_shapes(body: Body) -> CollisionShapes:
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
            radii.append(np.ptp(near, axis=0)[:2].min() / 2 - CONTACT.skin_gives_m)
    return CollisionShapes(0.5 * (low + high), 0.5 * (high - low), np.array(segment), np.array(points), np.array(radii))


def collision_residuals(shapes: CollisionShapes, world_T_segment: Array) -> tuple[Array, Array]:
    """Depth (N,), in sigmas, of each ball that is inside the trunk, and its derivative (N, 43) by the pose."""
    trunk = world_T_segment[list(_TRUNK)]
    balls = world_points(world_T_segment, shapes.segment, shapes.points_m)
    local = np.einsum("eij,ebi->ebj", trunk[:, :3, :3], balls - trunk[:, None, :3, 3]) - shapes.centres_m[:, None]
    axes = shapes.axes_m[:, None] + shapes.radii_m[:, None]  # (E, B, 3)
    level = np.sqrt(np.sum((local / axes) ** 2, axis=-1))  # 0 in the middle .. 1 on the skin
    inside = np.argwhere(level < 1.0)
    rows, depth = np.zeros((len(inside), DOF)), np.zeros(len(inside))
    for n, (e, b) in enumerate(inside):
        scale = axes[e, b].min() / CONTACT.inside_sigma_m
        outward = trunk[e, :3, :3] @ (local[e, b] / axes[e, b] ** 2) / max(level[e, b], 1e-3)
        both = np.array([shapes.segment[b], _TRUNK[e]])
        arm, under = point_jacobians(world_T_segment, both, balls[[b, b]])
        rows[n], depth[n] = -scale * outward @ (arm - under), scale * (1.0 - level[e, b])
    return rows, depth


def spine(angles: Array, sigma_rad: float) -> tuple[Array, Array, float]:
    """Normal equations (43, 43) and (43,) of a spine bent by joint ``angles`` (43,), and their cost: Student's
    distribution, so that a spine which is seen to bend far is let alone."""
    information = _spine_information(sigma_rad)
    pull = information @ angles
    far = float(angles @ pull) / SPINE.freedom
    return information / (1.0 + far), -pull / (1.0 + far), SPINE.freedom * float(np.log1p(far))


@lru_cache(maxsize=4)
def _spine_information(sigma_rad: float) -> Array:
    """Information (43, 43) on the joint angles of the spine, about rest: about each axis lumbar and thoracic joint bend
    by ``sigma_rad``, correlated."""
    information = np.zeros((DOF, DOF))
    joints = [np.flatnonzero(SEGMENTS.index(name) == DOF_SEGMENT) for name in ("lumbar", "thorax")]
    own = np.linalg.inv(np.array([[1.0, SPINE.evenness], [SPINE.evenness, 1.0]])) / sigma_rad**2
    for pair in zip(*joints, strict=True):
        information[np.ix_(pair, pair)] = own
    information.flags.writeable = False
    return information


def constraints(
    body: Body, pose: Pose, limit_sigma_rad: float, *, self_collision: bool, spine_sigma_rad: float
) -> tuple[Array, Array]:
    """Normal equations (43, 43) and (43,) of joints beyond their limits, of a bent spine and, with ``self_collision``,
    of arms in the trunk."""
    excess, violated = limit_residuals(pose)
    stiffness = violated / limit_sigma_rad**2
    bent, straighten, _ = spine(joint_angles(pose), spine_sigma_rad)
    hessian, gradient = np.diag(stiffness) + bent, -stiffness * excess + straighten
    if self_collision:
        rows, depth = collision_residuals(collision_shapes(body), forward(body, pose))
        hessian, gradient = hessian + rows.T @ rows, gradient - rows.T @ depth
    return hessian, gradient
