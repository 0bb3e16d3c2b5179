"""A small hall with the athlete, four cameras that pan and zoom, and the truth: for body, segmentation, tracking.

MuJoCo's own camera projects; of `pzcap` only the types are used.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import SEGMENTS, Array, Camera, Image, Mask, Pose
from sim.cameras.render import Stage
from sim.people import athlete
from sim.people.anthropometry import draw_measurements

WIDTH, HEIGHT = 480, 360
POSITIONS = np.array([[-6.0, -5.0, 1.7], [6.0, -5.0, 1.8], [6.0, 5.0, 1.6], [-6.0, 5.0, 1.75]])


@dataclass(frozen=True, eq=False)
class Shot:
    """One view of one instant, and the truth about it."""

    image: Image
    empty: Image  # the same view without the athlete or the shadow
    mask: Mask
    camera: Camera


@dataclass(frozen=True, eq=False)
class Clip:
    measurements_m: dict[str, float]
    shots: list[list[Shot]]  # per frame, per camera
    poses: list[Pose]
    joints_m: Array  # (F, 16, 3)


def swing(time_s: float) -> Pose:
    """Walk, lean and swing arms and legs: every joint moves, up to some 250 degrees a second."""
    phase = 2 * np.pi * 0.8 * time_s
    turn = {name: np.zeros(3) for name in SEGMENTS}
    turn["pelvis"] = np.array([0.1 * np.sin(phase), 0.15, 0.6 + 0.5 * time_s])
    turn["thorax"] = np.array([0.0, 0.1 * np.cos(phase), 0.3 * np.sin(phase)])
    for side, sign in (("left_", 1.0), ("right_", -1.0)):
        turn[side + "upper_arm"] = np.array([sign * 0.5, -0.8 * sign * np.sin(phase), 0.0])
        turn[side + "forearm"] = np.array([0.0, -0.6 - 0.3 * np.cos(phase), 0.0])
        turn[side + "thigh"] = np.array([sign * 0.1, -0.2 + 0.6 * sign * np.sin(phase), 0.0])
        turn[side + "shank"] = np.array([0.0, 0.5 - 0.4 * sign * np.cos(phase), 0.0])
    rotations = Rotation.from_rotvec([turn[name] for name in SEGMENTS]).as_quat(scalar_first=True)
    return Pose(np.array([-0.5 + 1.5 * time_s, 0.2, 0.95]), rotations)


def _hall(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    for k, (pos, size, axes) in enumerate(
        [
            ((0, 0, 0), (12, 12), (1, 0, 0, 0)),
            ((0, 12, 3), (12, 3), (0.7071068, 0.7071068, 0, 0)),
            ((0, -12, 3), (12, 3), (0.7071068, -0.7071068, 0, 0)),
            ((12, 0, 3), (3, 12), (0.7071068, 0, -0.7071068, 0)),
            ((-12, 0, 3), (3, 12), (0.7071068, 0, 0.7071068, 0)),
        ]
    ):
        octaves = [cv2.resize(rng.random((n, n, 3)), (1024, 1024), interpolation=cv2.INTER_CUBIC) for n in (8, 40, 200)]
        colour = np.clip(0.25 + 0.5 * rng.random(3) + 0.35 * (np.mean(octaves, axis=0) - 0.5), 0, 1)
        texture = spec.add_texture(
            name=f"hall{k}", type=mujoco.mjtTexture.mjTEXTURE_2D, width=1024, height=1024, nchannel=3
        )
        texture.data = (255 * colour).astype(np.uint8).tobytes()
        material = spec.add_material(name=f"hall{k}")
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = f"hall{k}"
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, pos=pos, quat=axes, size=[*size, 1], material=f"hall{k}", group=0
        )
    spec.worldbody.add_light(
        pos=[2, -3, 7], dir=[-0.2, 0.3, -1], diffuse=[0.5] * 3, specular=[0] * 3, castshadow=True,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    )  # fmt: skip
    spec.visual.headlight.ambient[:] = 0.5
    spec.visual.headlight.diffuse[:] = 0.0
    spec.visual.headlight.specular[:] = 0.0


AT_ONCE = (0.0, 0.0, 0.0, 0.0)


def shoot(
    frames: int, seed: int = 0, frame_rate: float = 30.0, noise: float = 2.0, clocks: tuple[float, ...] = AT_ONCE
) -> Clip:
    """Render ``frames`` instants of `swing`; noise is in grey levels.

    Cameras expose ``clocks`` (4,) frame periods after the instants of poses and joints.
    """
    rng = np.random.default_rng(seed)
    config = athlete.AthleteConfig()
    measurements = draw_measurements(rng)
    spec = mujoco.MjSpec()
    _hall(spec, rng)
    athlete.add_athlete(spec, measurements, config, rng)
    stage = Stage(spec, 2 * WIDTH, 2 * HEIGHT, athlete.GEOM_GROUP, object_group=5)
    poses = [swing(k / frame_rate) for k in range(frames)]
    shots, joints = [], []
    for frame, pose in enumerate(poses):
        athlete.set_pose(stage.model, stage.data, pose)
        mujoco.mj_kinematics(stage.model, stage.data)
        centres = np.array([stage.data.body(name).xpos.copy() for name in SEGMENTS])
        joints.append(centres)
        row = []
        for position, clock in zip(POSITIONS, clocks, strict=True):
            athlete.set_pose(stage.model, stage.data, swing((frame + clock) / frame_rate))
            camera = aim(position, centres.mean(axis=0))
            stage.aim(camera.world_T_cam, float(np.rad2deg(2 * np.arctan(HEIGHT / 2 / camera.focal_px))))
            pictures = []
            for present in (True, False):
                fine = stage.picture((2 * WIDTH, 2 * HEIGHT), athlete=present)[::-1, :, ::-1]
                picture = cv2.resize(np.ascontiguousarray(fine), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
                noisy = picture + rng.normal(0, noise, picture.shape)
                pictures.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
            body = stage.mask((WIDTH, HEIGHT))[::-1] > 0
            row.append(Shot(pictures[0], pictures[1], body, camera))
        shots.append(row)
    stage.close()
    return Clip(measurements, shots, poses, np.array(joints))


def aim(position: Array, target: Array) -> Camera:
    """Look at the target, zoomed so that a person is 230 pixels tall."""
    ahead = target - position
    pan, distance = np.arctan2(ahead[1], ahead[0]), np.hypot(ahead[0], ahead[1])
    tilt = np.arctan2(ahead[2], distance)
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = Rotation.from_euler("ZY", [pan, -tilt]).as_matrix() @ level
    world_T_cam[:3, 3] = position
    principal = np.array([WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5])
    return Camera(WIDTH, HEIGHT, world_T_cam, float(230 * distance / 1.75), principal, 0.0)
