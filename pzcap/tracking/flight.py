"""In the air the centre of mass falls freely.

Whoever touches nothing can bend and turn as she likes; the centre of her mass goes its parabola. In flight are frames
in which all of the skin is clear of the floor and the curve is that of a fall, as the estimate itself has it: a body
that stands on a box does not fall, and the less the curve is that of a fall, the less it is believed to be one. The
mass is taken to be as the volume under the skin is, of one density. Nobody's is, and published tables of the segments'
masses differ by as much: the curve is believed no better than that (`TrackingConfig.fall_sigma_m_s2`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pzcap.body.mesh import Surface
from pzcap.body.skeleton import Body, forward, mean_jacobian, place
from pzcap.tracking.banded_solver import Tie
from pzcap.types import SEGMENTS, Array, Pose

GRAVITY_M_S2: Final = 9.81
_CLEAR_M: Final = 0.04  # above the floor: what a tape and a tracker are wrong by together
_CURVED_M_S2: Final = 4.0  # what is off by more is hardly a fall
_LEAST: Final = 0.05  # weight of what falls at all


def masses(surface: Surface) -> tuple[Array, Array]:
    """Each segment's share (16,) of the volume under the skin, and the centre (16, 3) of it in the segment's frame."""
    corners = surface.points_m[surface.faces]  # each face and the segment's origin make a tetrahedron
    volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    share, moment = np.zeros(len(SEGMENTS)), np.zeros((len(SEGMENTS), 3))
    segment = surface.segment[surface.faces[:, 0]]
    np.add.at(share, segment, volume)
    np.add.at(moment, segment, volume[:, None] * corners.sum(axis=1) / 4.0)
    return share / share.sum(), moment / share[:, None]


def falls(body: Body, poses: Sequence[Pose], frame_rate: float, sigma_m_s2: float) -> list[Tie]:
    """What keeps each three of ``poses`` that follow one another in flight on one parabola, to ``sigma_m_s2``."""
    share, inner = masses(body.surface)
    placed = [forward(body, pose) for pose in poses]
    clear = np.array([place(body, frames)[0][:, 2].min() > _CLEAR_M for frames in placed])
    found = []
    for t in np.flatnonzero(clear[:-2] & clear[1:-1] & clear[2:]).tolist():
        three = placed[t : t + 3]
        points = [np.einsum("sij,sj->si", frames[:, :3, :3], inner) + frames[:, :3, 3] for frames in three]
        bend = np.array([1.0, -2.0, 1.0]) @ np.array([share @ each for each in points])
        bend[2] += GRAVITY_M_S2 / frame_rate**2
        off = np.linalg.norm(bend) * frame_rate**2
        alike = 1.0 / (1.0 + (off / _CURVED_M_S2) ** 2) ** 2
        if alike > _LEAST:
            jacobians = [mean_jacobian(frames, share, each) for frames, each in zip(three, points, strict=True)]
            weight = np.full(3, alike * (frame_rate**2 / sigma_m_s2) ** 2)
            found.append(Tie(t, bend, weight, np.array([[[1.0]], [[-2.0]], [[1.0]]]) * jacobians))
    return found
