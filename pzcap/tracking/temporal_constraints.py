"""Constraints between consecutive frames: contacts with the floor, and ballistic flight.

Contacts: images fix a foot to a millimetre or two in each frame by itself, so that a standing one trembles. In contact
are points near the floor that are all but at rest, as the estimate itself has them; the more a point moves, the less it
is believed to rest, so that a heel that rises is let go.

Flight: in the air the centre of mass follows a parabola, however the body bends and turns. In flight are frames in
which all of the skin is clear of the floor and the curve is that of a fall, as the estimate itself has it: a body that
stands on a box does not fall, and the less the curve is that of a fall, the less it is believed to be one. The mass is
taken to be as the volume under the skin is, of one density. Nobody's is, and published tables of the segments' masses
differ by as much: the curve is believed no better than that (`TrackingConfig.fall_sigma_m_s2`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pzcap.body.mesh import Surface
from pzcap.body.skeleton import DOF, Body, forward, mean_jacobian, place, point_jacobian
from pzcap.solver.robust import geman_mcclure
from pzcap.tracking.banded_solver import Tie
from pzcap.tracking.tuning import CONTACT, FLIGHT
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
    still = 1.0 / (1.0 + np.sum(moved**2, axis=-1) / CONTACT.rest_m**2) ** 2
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


def masses(surface: Surface) -> tuple[Array, Array]:
    """Each segment's share (16,) of the volume under the skin, and its centre (16, 3) in the segment's frame."""
    corners = surface.points_m[surface.faces]  # each face and the segment's origin make a tetrahedron
    volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    share, moment = np.zeros(len(SEGMENTS)), np.zeros((len(SEGMENTS), 3))
    segment = surface.segment[surface.faces[:, 0]]
    np.add.at(share, segment, volume)
    np.add.at(moment, segment, volume[:, None] * corners.sum(axis=1) / 4.0)
    return share / share.sum(), moment / share[:, None]


def ballistic(body: Body, poses: Sequence[Pose], frame_rate: float, sigma_m_s2: float) -> list[Tie]:
    """Ties of each three consecutive ``poses`` in flight: the centre of mass falls freely, to ``sigma_m_s2``."""
    share, inner = masses(body.surface)
    placed = [forward(body, pose) for pose in poses]
    clear = np.array([place(body, frames)[0][:, 2].min() > FLIGHT.clear_m for frames in placed])
    found = []
    for t in np.flatnonzero(clear[:-2] & clear[1:-1] & clear[2:]).tolist():
        three = placed[t : t + 3]
        points = [np.einsum("sij,sj->si", frames[:, :3, :3], inner) + frames[:, :3, 3] for frames in three]
        bend = np.array([1.0, -2.0, 1.0]) @ np.array([share @ each for each in points])
        bend[2] += FLIGHT.gravity_m_s2 / frame_rate**2
        off = np.linalg.norm(bend) * frame_rate**2
        alike = float(geman_mcclure(off, FLIGHT.robust_m_s2))
        if alike > FLIGHT.least_weight:
            jacobians = [mean_jacobian(frames, share, each) for frames, each in zip(three, points, strict=True)]
            weight = np.full(3, alike * (frame_rate**2 / sigma_m_s2) ** 2)
            found.append(Tie(t, bend, weight, np.array([[[1.0]], [[-2.0]], [[1.0]]]) * jacobians))
    return found
