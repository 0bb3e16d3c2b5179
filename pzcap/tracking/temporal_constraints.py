"""Contacts with the floor: constraints between consecutive frames.

Images fix a foot to a millimetre or two in each frame by itself, so that a standing one trembles. In contact are points
near the floor that are all but at rest, as the estimate itself has them; the more a point moves, the less it is
believed to rest, so that a heel that rises is let go.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pzcap.body.kinematics import forward, point_jacobian
from pzcap.body.skeleton import DOF, Body
from pzcap.solver.robust import geman_mcclure
from pzcap.tracking.banded_solver import Tie
from pzcap.tracking.tuning import CONTACT
from pzcap.types import SEGMENTS, Array, Pose


def soles(body: Body) -> tuple[tuple[int, Array], ...]:
    """Points that may bear the body: segment, and point (3,) in its frame; heels, balls of the feet and fingers."""
    found: list[tuple[int, Array]] = []
    for segment, name in enumerate(SEGMENTS):
        skin = body.surface.points_m[body.surface.segment == segment]
        low, high = skin.min(axis=0), skin.max(axis=0)
        if name.endswith("foot"):
            for share in (0.15, 0.75):
                along = low[0] + share * (high[0] - low[0])
                found.append((segment, np.array([along, 0.0, skin[np.abs(skin[:, 0] - along) < 0.02, 2].min()])))
        elif name.endswith("hand"):
            found.append((segment, np.array([0.0, 0.0, 0.5 * low[2]])))
    return tuple(found)


def contacts(body: Body, poses: Sequence[Pose]) -> list[Tie]:
    """Ties of consecutive ``poses``: points at rest on the floor stay where they were."""
    rests_on, placed = soles(body), [forward(body, pose) for pose in poses]
    points = np.array([[frames[s, :3, :3] @ point + frames[s, :3, 3] for s, point in rests_on] for frames in placed])
    moved = np.diff(points, axis=0)  # (T - 1, N, 3)
    near = np.maximum(points[1:, :, 2], points[:-1, :, 2]) < CONTACT.near_m
    still = geman_mcclure(np.linalg.norm(moved, axis=-1), CONTACT.rest_m)
    weight = np.where(near & (still > CONTACT.least_weight), still / CONTACT.sigma_m**2, 0.0)
    found = []
    for t in np.flatnonzero(weight.any(axis=1)).tolist():
        held = np.flatnonzero(weight[t])
        jacobians = np.zeros((2, len(held), 3, DOF))
        for k, sign in enumerate((-1.0, 1.0)):
            for row, n in enumerate(held):
                jacobians[k, row] = sign * point_jacobian(placed[t + k], rests_on[n][0], points[t + k, n])
        rows = 3 * len(held)
        found.append(Tie(t, moved[t, held].ravel(), np.repeat(weight[t, held], 3), jacobians.reshape(2, rows, DOF)))
    return found
