"""A small reconstruction made up from a seed, for tests of what is done with one."""

from __future__ import annotations

import dataclasses
from fractions import Fraction

import numpy as np

from pzcap.types import (
    PARENTS,
    Array,
    Camera,
    Lens,
    Motion,
    MovedBody,
    Panorama,
    PanZoomCamera,
    PanZoomTrack,
    Reconstruction,
    ReferenceCamera,
)

WIDTH, HEIGHT = 320, 240
FOCAL_PX = 440.0
CORNERS = ((-10.5, -8.0), (10.5, -8.0), (10.5, 8.0), (-10.5, 8.0))
HEAD_R_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

OFFSETS = np.array(
    [[0, 0, 0], [0, 0, 0.12], [0, 0, 0.15], [0, 0, 0.22], [0, 0.18, 0.17], [0, 0, -0.28], [0, 0, -0.25],
     [0, -0.18, 0.17], [0, 0, -0.28], [0, 0, -0.25], [0, 0.09, 0], [0, 0, -0.42], [0, 0, -0.4],
     [0, -0.09, 0], [0, 0, -0.42], [0, 0, -0.4]]
)  # fmt: skip


def rotation_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def world_T_head(camera: int) -> Array:
    x, y = CORNERS[camera]
    transform = np.eye(4)
    transform[:3, :3] = rotation_z(np.arctan2(-y, -x))
    transform[:3, 3] = x, y, 1.7
    return transform


def world_T_cam(camera: PanZoomCamera, pan: float, tilt: float) -> Array:
    """The head chain written out, independent of pzcap.geometry.camera."""
    cam = np.eye(4)
    cam[:3, :3] = rotation_z(pan) @ rotation_y(-tilt) @ HEAD_R_CAM @ rotation_z(camera.roll_rad)
    return camera.world_T_head @ cam


def standing_joints(position: Array) -> Array:
    """(16, 3) joints of somebody who stands with hanging arms, pelvis at ``position``."""
    joints = np.zeros((16, 3))
    for index, parent in enumerate(PARENTS):
        joints[index] = position if parent < 0 else joints[parent] + OFFSETS[index]
    return joints


def moved_body() -> MovedBody:
    """The body of `standing_joints`; its skin is a tetrahedron in each segment."""
    corners = 0.05 * np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    ends = np.array([[0, 0, 0.2], *[[0, 0, -0.18]] * 2, *[[0.18, 0, -0.07]] * 2, *[[-0.06, 0, -0.07]] * 2])
    segment = np.repeat(np.arange(16), 4)
    return MovedBody(OFFSETS, ends, np.tile(corners, (16, 1)), segment, np.vstack([faces + 4 * s for s in range(16)]))


def reconstruction(seed: int = 0, cameras: int = 4, frames: int = 12) -> Reconstruction:
    """Cameras at the corners of the carpet that follow somebody who crosses it upright."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 1.0, frames)
    root = np.column_stack([-2.0 + 4.0 * time, 0.5 * np.sin(3.0 * time), np.full(frames, 0.95)])
    pan_zoom, references, panoramas, tracks = [], [], [], []
    for index in range(cameras):
        lens = Lens(WIDTH, HEIGHT, FOCAL_PX, np.array([[159.2, 120.3], [0.4, -0.2]]), np.array([-0.04, 0.05, -0.01]))
        camera = PanZoomCamera(
            lens, world_T_head(index), tilt_rad=-0.07, roll_rad=0.008, shared_zooms=np.array([1.0, 2.0]),
            shared_covariance=1e-8 * np.tile(np.eye(2), (4, 2, 1, 1)),
        )  # fmt: skip
        pan_zoom.append(camera)
        aim = root - camera.world_T_head[:3, 3]
        heading = np.arctan2(aim[:, 1], aim[:, 0]) - np.arctan2(*camera.world_T_head[1::-1, 0])
        tracks.append(
            PanZoomTrack(
                pan_rad=(heading + np.pi) % (2 * np.pi) - np.pi,
                tilt_rad=np.full(frames, -0.07),
                roll_rad=np.zeros(frames),
                focal_px=FOCAL_PX * (1.0 + 0.5 * time),
                covariance=np.tile(np.diag([1e-4, 1e-3]) ** 2, (frames, 1, 1)),
                inliers=rng.integers(50, 200, frames),
                valid=np.ones(frames, bool),
            )
        )
        points = rng.uniform(-1.0, 1.0, (24, 3)) + np.array([0.0, 0.0, 1.0])
        references.append(
            ReferenceCamera(
                camera=Camera(
                    WIDTH, HEIGHT, world_T_cam(camera, 0.0, -0.07), FOCAL_PX, lens.principal_px[0], float(lens.k1[0])
                ),
                points_m=points,
                points_px=rng.uniform(100.0, 200.0, (24, 2)),
                residuals_px=rng.normal(0.0, 0.1, (24, 2)),
            )
        )
        width, height = 1256, 180
        panoramas.append(
            Panorama(
                image=rng.integers(0, 256, (height, width, 3), dtype=np.uint8),
                valid=rng.random((height, width)) < 0.9,
                px_per_rad=width / (2 * np.pi),
                origin_px=np.array([width / 2, height / 2]),
                full_turn=True,
                sweep_pan_rad=np.linspace(0.0, 6.0, 30),
                sweep_inliers=rng.integers(80, 300, 30),
                closure_rad=0.001,
                residual_px=0.3,
            )
        )
    return Reconstruction(
        capture_name="fabricated",
        method="exact",
        frame_rate=Fraction(30),
        timecodes=tuple(f"01:00:00:{frame:02d}" for frame in range(frames)),
        camera_names=tuple(str(index + 1) for index in range(cameras)),
        references=tuple(references),
        cameras=tuple(pan_zoom),
        panoramas=tuple(panoramas),
        tracks=tuple(tracks),
        refined=tuple(tracks),
        motion=Motion(
            root_position_m=root,
            rotations=np.tile([1.0, 0.0, 0.0, 0.0], (frames, 16, 1)),
            joints_m=np.stack([standing_joints(position) for position in root]),
            sigma_m=np.full((frames, 16), 0.01),
            keyframes=np.array([0, frames - 1]),
            valid=np.ones(frames, bool),
            body=moved_body(),
        ),
        notes=(),
    )


def without_a_camera(whole: Reconstruction) -> Reconstruction:
    """The same, but the second camera brought home nothing and there was no subject to track."""
    fields = {
        name: (getattr(whole, name)[0], None, *getattr(whole, name)[2:])
        for name in ("references", "cameras", "panoramas", "tracks")
    }
    return dataclasses.replace(whole, motion=None, notes=("camera 2: no motion video",), **fields)
