"""The crew measures the hall, where it has no calibration object: the sides of the carpet, whose corners somebody marks
in the sweeps."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import mujoco
import numpy as np

from pzcap.types import Array, KnownLength, Mark
from sim.cameras.sensor import by_rows
from sim.hall.gym import OBJECT_GROUP
from sim.hall.surfaces import CARPET_M
from sim.people.athlete import GEOM_GROUP
from sim.scene import stream
from sim.session import Session

_CORNERS_M: Final = 0.5 * CARPET_M * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
_SIDES: Final = ("south", "east", "north", "west")
_NEAR_M: Final = 0.1  # before a corner, what is hit is the carpet itself
_EDGE_PX: Final = 8.0  # nobody marks what is nearer to the border


def sides_of_carpet(session: Session) -> tuple[KnownLength, ...]:
    """The sides between corners that somebody could mark."""
    crew, rng = session.config.crew, stream(session.config.seed, "lengths")
    model = session.model_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    corners = [_marks(session, model, data, corner_m, rng) for corner_m in _CORNERS_M]
    errors_m = crew.length_sigma_m * rng.normal(size=len(_SIDES))
    return tuple(
        KnownLength(f"{name} side of the carpet", round(CARPET_M + error, 3), max(crew.length_sigma_m, 0.001), ends)
        for name, error, ends in zip(_SIDES, errors_m.tolist(), pairwise([*corners, corners[0]]), strict=True)
        if all(ends)
    )


def _marks(
    session: Session, model: mujoco.MjModel, data: mujoco.MjData, corner_m: Array, rng: np.random.Generator
) -> tuple[Mark, ...]:
    """A corner in the sweep of each camera that shows it, in the picture that has it nearest to the middle."""
    found = []
    for c, rig in enumerate(session.rigs):
        frame, px, eye_m = best_seen(session, c, corner_m)
        noise_px = session.config.crew.click_px * rng.normal(size=2)
        in_picture = np.all(px > _EDGE_PX) and np.all(px < np.array([rig.width, rig.height]) - _EDGE_PX)
        if in_picture and not _hidden(model, data, eye_m, corner_m):
            found.append(Mark(session.config.camera_names[c], "sweep", frame, np.round(px + noise_px, 2)))
    return tuple(found)


def best_seen(session: Session, c: int, point_m: Array) -> tuple[int, Array, Array]:
    """The frame of a sweep that has a point nearest to straight ahead, the pixel (2,) there, and the projection centre
    (3,)."""
    rig, run = session.rigs[c], session.sweep(c)

    def seen(at_s: float) -> Array:
        aim = run.at(at_s)
        return rig.project(rig.world_T_cam(*aim), aim.focal_px, point_m[None])[0]

    poses = [rig.world_T_cam(*run.at(at_s)) for at_s in run.times_s.tolist()]
    across = [np.arctan2(*((point_m - pose[:3, 3]) @ pose[:3, [0, 2]])) for pose in poses]
    frame = int(np.argmin(np.abs(across)))
    px = by_rows(seen, float(run.times_s[frame]), rig.height, session.config.sensor.readout_s)[0]
    return frame, px, poses[frame][:3, 3]


def _hidden(model: mujoco.MjModel, data: mujoco.MjData, eye_m: Array, point_m: Array) -> bool:
    """True if something of the hall stands in front of the point; athlete and calibration object are not there then."""
    groups = np.array([group not in (GEOM_GROUP, OBJECT_GROUP) for group in range(6)], np.uint8)
    distance_m = float(np.linalg.norm(point_m - eye_m))
    way = (point_m - eye_m) / distance_m
    hit_m = mujoco.mj_ray(model, data, eye_m, way, groups, 1, -1, np.zeros(1, np.int32), None)
    return bool(0.0 <= hit_m < distance_m - _NEAR_M)
