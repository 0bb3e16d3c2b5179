"""The athlete: an MJCF tree of sixteen segments, dressed. Kinematics and rendering only; nothing collides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from pzcap.types import HINGE_AXES, PARENTS, SEGMENTS, Pose
from sim import anthropometry

GEOM_GROUP = 1
"""The athlete's geoms, so that segmentation and hiding can tell them from the hall."""


@dataclass(frozen=True, slots=True)
class AthleteConfig:
    """How the athlete looks."""

    clothing: Literal["rich", "plain"] = "rich"  # printed shirt and seams, or plain cloth of weak texture


def draw_measurements(config: AthleteConfig, rng: np.random.Generator) -> dict[str, float]:
    """Draw a person: metres for every name of `types.MEASUREMENTS`. The clothing changes nothing of the body."""
    del config
    return anthropometry.draw_measurements(rng)


def add_athlete(
    spec: mujoco.MjSpec, measurements: dict[str, float], config: AthleteConfig, rng: np.random.Generator
) -> None:
    """Add the athlete to the world: bodies and joints named as `types.SEGMENTS`, geoms in `GEOM_GROUP`."""
    del config, rng
    tree = anthropometry.body_tree(measurements)
    bodies: list[mujoco.MjsBody] = []
    for s, name in enumerate(SEGMENTS):
        parent = spec.worldbody if PARENTS[s] < 0 else bodies[PARENTS[s]]
        body = parent.add_body(name=name, pos=tree.offsets_m[s])
        bodies.append(body)
        if PARENTS[s] < 0:
            body.add_joint(name="root", type=mujoco.mjtJoint.mjJNT_FREE)
        elif name in HINGE_AXES:
            body.add_joint(
                name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=HINGE_AXES[name], limited=1,
                range=anthropometry.joint_limit_rad(name),
            )  # fmt: skip
        else:
            body.add_joint(
                name=name, type=mujoco.mjtJoint.mjJNT_BALL, limited=1, range=anthropometry.joint_limit_rad(name)
            )
    m = measurements
    shapes = {
        "pelvis": ((0, 0, -0.02), (0, 0, 0.09), 0.14), "lumbar": ((0, 0, 0), (0, 0, 0.1), 0.12),
        "thorax": ((0, 0, 0.05), (0, 0, 0.15), 0.15), "head": ((0, 0, 0.10), (0, 0, 0.14), 0.09),
        "upper_arm": ((0, 0, 0), (0, 0, -m["upper_arm"]), 0.045), "forearm": ((0, 0, 0), (0, 0, -m["forearm"]), 0.037),
        "hand": ((0, 0, -0.02), (0, 0, -m["hand"] + 0.02), 0.03),
        "thigh": ((0, 0, 0), (0, 0, -m["thigh"]), 0.075), "shank": ((0, 0, 0), (0, 0, -m["shank"]), 0.05),
        "foot": ((-0.03, 0, -0.035), (0.14, 0, -0.035), 0.035),
    }  # fmt: skip
    colours = {"pelvis": (0.1, 0.1, 0.3, 1), "thigh": (0.1, 0.1, 0.3, 1), "shank": (0.1, 0.1, 0.3, 1),
               "thorax": (0.7, 0.1, 0.1, 1), "lumbar": (0.7, 0.1, 0.1, 1)}  # fmt: skip
    for body, name in zip(bodies, SEGMENTS, strict=True):
        kind = name.removeprefix("left_").removeprefix("right_")
        start, end, radius = shapes[kind]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*start, *end], size=[radius, 0, 0], group=GEOM_GROUP,
            contype=0, conaffinity=0, rgba=colours.get(kind, (0.8, 0.6, 0.5, 1)),
        )  # fmt: skip


def set_pose(model: mujoco.MjModel, data: mujoco.MjData, pose: Pose) -> None:
    """Write a pose to ``data.qpos``. A hinge takes the angle about its axis; call ``mj_kinematics`` afterwards."""
    for s, name in enumerate(SEGMENTS):
        joint = model.joint("root" if PARENTS[s] < 0 else name)
        at = int(joint.qposadr[0])
        w, xyz = float(pose.rotations[s, 0]), pose.rotations[s, 1:]
        if PARENTS[s] < 0:
            data.qpos[at : at + 3] = pose.root_position_m
            data.qpos[at + 3 : at + 7] = pose.rotations[s]
        elif name in HINGE_AXES:
            angle = 2.0 * np.arctan2(float(np.dot(HINGE_AXES[name], xyz)), w)
            data.qpos[at] = (angle + np.pi) % (2 * np.pi) - np.pi
        else:
            data.qpos[at : at + 4] = pose.rotations[s]
