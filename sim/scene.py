"""The MuJoCo scene of hall, athlete and calibration object; joints and points measured in it; random streams."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import mujoco
import numpy as np

from pzcap.types import SEGMENTS, Array
from sim.cameras.optics import Rig
from sim.cameras.render import OTHERS_GROUP, Stage
from sim.hall import gym
from sim.hall.gym import GymConfig
from sim.motion import MotionClip
from sim.people import athlete
from sim.people.athlete import AthleteConfig
from sim.people.company import Companion


def stream(seed: int, *purpose: str | int) -> np.random.Generator:
    """Random generator for one purpose, independent of what is drawn for others."""
    return np.random.default_rng([seed, *(zlib.crc32(str(part).encode()) for part in purpose)])


def describe_scene(
    seed: int,
    gym_config: GymConfig,
    athlete_config: AthleteConfig,
    measurements: dict[str, float],
    others: Sequence[Companion] = (),
) -> mujoco.MjSpec:
    """Hall, calibration object, athlete and ``others``, who are dressed alike, to be compiled."""
    spec = mujoco.MjSpec()
    gym.build_gym(spec, gym_config, stream(seed, "gym"))
    gym.add_calibration_object(spec)
    athlete.add_athlete(spec, measurements, athlete_config, stream(seed, "athlete"))
    for other in others:
        tight = AthleteConfig(athlete_config.clothing, athlete_config.sleeves)
        looks = stream(seed, "athlete")  # those of the athlete
        athlete.add_athlete(spec, other.measurements, tight, looks, other.name, OTHERS_GROUP)
    return spec


def skeleton(
    model: mujoco.MjModel, clip: MotionClip, times_s: Array, measurements: dict[str, float]
) -> tuple[Array, Array]:
    """Joint centres (T, 16, 3), and the same with vertex, finger tips and toes (T, 21, 3), which span the body."""
    tips = {
        "head": (0.0, 0.0, measurements["head"]),
        **{f"{side}_hand": (0.0, 0.0, -measurements["hand"]) for side in ("left", "right")},
        **{
            f"{side}_foot": (0.75 * measurements["foot"], 0.0, -measurements["ankle_height"])
            for side in ("left", "right")
        },
    }
    data = mujoco.MjData(model)
    bodies = [model.body(name).id for name in SEGMENTS]
    ends = [model.body(name).id for name in tips]
    offsets = np.array(list(tips.values()))
    joints_m, outline_m = np.empty((len(times_s), 16, 3)), np.empty((len(times_s), 21, 3))
    for k, time_s in enumerate(times_s.tolist()):
        athlete.set_pose(model, data, clip.at(time_s))
        mujoco.mj_kinematics(model, data)
        joints_m[k] = data.xpos[bodies]
        turns = data.xmat[ends].reshape(-1, 3, 3)
        outline_m[k] = np.concatenate([joints_m[k], data.xpos[ends] + np.einsum("nij,nj->ni", turns, offsets)])
    return joints_m, outline_m


def scene_points(stage: Stage, rig: Rig, sweep_rad: Array, count: int, rng: np.random.Generator) -> Array:
    """(N, 3) points of the hall that the camera sees while it sweeps, from ``count`` rays."""
    half_u, half_v = (side / 2 / rig.reference_focal_px for side in (rig.width, rig.height))
    reach = min((float(np.ptp(sweep_rad)) / 2) + float(np.arctan(half_u)), np.pi)
    azimuth = rng.uniform(-reach, reach, count)
    slope = np.tan(rig.tilt_rad + rng.uniform(-1, 1, count) * np.arctan(half_v))
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=1)
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True) @ rig.world_T_head[:3, :3].T
    points, hit = stage.cast_rays(rig.world_T_head[:3, 3], directions)
    return points[hit]
