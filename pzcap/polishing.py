"""The frames between two keyframes once more, all at once: the body corrected, the drift and the jitter taken out.

The passes from the keyframes have found the body in every frame, each from its own side. Now the contours of all these
frames correct the body's shape (`pzcap.shape`); then every pose is improved against the silhouettes and against what
each point of the skin looks like on average, with a motion that does not jerk (`pzcap.trajectory`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pzcap.body import DOF, Body, difference, forward, limit_residuals, retract
from pzcap.evidence import Appearance, Cut, Evidence, PlacedView
from pzcap.following import TrackingConfig
from pzcap.shape import ShapeEstimate
from pzcap.trajectory import smooth_step
from pzcap.types import Array, Keyframe, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Polished:
    """The poses of a stretch, and how well the images of each fix it."""

    poses: list[Pose]
    hessians: list[Array]  # (43, 43)


def correct(
    body: Body,
    shape: ShapeEstimate,
    poses: Sequence[Pose],
    views: Sequence[Sequence[Cut | None]],
    config: TrackingConfig,
) -> None:
    """Tell ``shape`` what the contours of some frames, tracked with ``body``, say."""
    anything = config.shape_weight / config.start_widening**2 * np.eye(DOF)
    for pose, cuts in zip(poses, views, strict=True):
        _add(body, shape, pose, cuts, config, anything, np.zeros(DOF))


def correct_by_hand(
    body: Body, shape: ShapeEstimate, pose: Pose, key: Keyframe, hand: Array, cuts: Sequence[Cut | None],
    config: TrackingConfig,
) -> None:  # fmt: skip
    """Tell ``shape`` what a keyframe says: a hand knows where the joints are, and not only where the skin is.

    ``pose`` is the one settled on, ``hand`` the information (43, 43) of the keyframe's.
    """
    _add(body, shape, pose, cuts, config, hand, hand @ difference(key.pose, pose))


def _add(
    body: Body, shape: ShapeEstimate, pose: Pose, cuts: Sequence[Cut | None], config: TrackingConfig, prior: Array,
    pull: Array,
) -> None:  # fmt: skip
    evidence = Evidence(body, cuts)
    rows = evidence.contour(pose, evidence.visibility(pose), config.schedule[-1].terms)
    if len(rows.segment):
        rows.weight[:] *= config.shape_weight
        shape.add(forward(body, pose), rows, prior, pull)


def polish(
    body: Body, poses: Sequence[Pose], views: Sequence[Sequence[Cut | None]], before: Pose | None, after: Pose | None,
    config: TrackingConfig,
) -> Polished:  # fmt: skip
    """Improve the ``poses`` of a stretch of frames; ``before`` and ``after`` it the body is held fast where known."""
    found, hessians = list(poses), [np.zeros((DOF, DOF)) for _ in poses]
    if not found:
        return Polished(found, hessians)
    terms = config.schedule[-1].terms
    evidence = [Evidence(body, cuts) for cuts in views]
    placed: list[list[PlacedView | None]] = [e.visibility(pose) for e, pose in zip(evidence, found, strict=True)]
    appearances = [Appearance.unseen(len(body.surface.points_m)) for _ in views[0]]
    for count, (each, where) in enumerate(zip(evidence, placed, strict=True), start=1):
        each.learn(where, appearances, 1.0 / count)
    sigma = np.full(DOF, config.acceleration_rotation_sigma_rad)
    sigma[:3] = config.acceleration_position_sigma_m
    for _ in range(config.polishing_sweeps):
        gradients = []
        for t, (each, where) in enumerate(zip(evidence, placed, strict=True)):
            normal = each.normal(found[t], where, appearances, terms)
            excess, violated = limit_residuals(found[t])
            stiffness = violated / config.limit_sigma_rad**2
            hessians[t] = normal.hessian + np.diag(stiffness)
            gradients.append(normal.gradient - stiffness * excess)
        steps = smooth_step(found, hessians, gradients, sigma, before, after)
        found = [retract(pose, np.clip(step, -0.2, 0.2)) for pose, step in zip(found, steps, strict=True)]
    return Polished(found, hessians)
