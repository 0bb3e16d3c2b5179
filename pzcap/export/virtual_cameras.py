"""Virtual fixed cameras: what a camera that pans and zooms would have seen, had it stood still with a wide, ideal lens.

For tools that know fixed cameras alone. A virtual camera stands at the mean of the places of the projection centre,
looks in the middle of the directions, has the median focal length and no distortion; its picture is as large as all
that the real one showed. A keypoint is undistorted and carried along its ray to the athlete's distance, and projected:
as exact as the real camera is known, since the projection centre moves by millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.export.take import LocatedCamera, Take, held
from pzcap.geometry.camera import project, rays
from pzcap.io.capture import frame_sets
from pzcap.io.detections import KEYPOINTS
from pzcap.types import Array, Camera

WIDEST_DEG: Final = 75.0
"""Angle from the virtual axis beyond which nothing is kept: a plane picture grows without end towards 90 degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class VirtualCamera:
    """A virtual camera, and the real one that it stands for."""

    camera: Camera
    located: LocatedCamera

    @property
    def matrix(self) -> list[list[float]]:
        """(3, 3) pixels from directions, as OpenCV has it."""
        focal, (x, y) = self.camera.focal_px, self.camera.principal_px.tolist()
        return [[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]]

    def opencv(self, name: str) -> dict[str, Any]:
        """The camera as OpenCV's tools write it: rotation vector and translation from the world to the camera."""
        rotation = self.camera.world_T_cam[:3, :3].T
        return {
            "name": name,
            "size": [self.camera.width, self.camera.height],
            "matrix": self.matrix,
            "distortions": [0.0, 0.0, 0.0, 0.0],
            "rotation": Rotation.from_matrix(rotation).as_rotvec().tolist(),
            "translation": (-rotation @ self.camera.world_T_cam[:3, 3]).tolist(),
            "fisheye": False,
        }


def virtual_cameras(take: Take) -> tuple[VirtualCamera, ...]:
    """The virtual cameras of a take, a located camera each."""
    return tuple(VirtualCamera(_fixed(located), located) for located in take.cameras())


def _fixed(located: LocatedCamera) -> Camera:
    real = [camera for _, camera in located.frames()]
    poses = np.array([camera.world_T_cam for camera in real])
    forward = _unit(poses[:, :3, 2].mean(axis=0))
    right = _unit(np.cross(poses[:, :3, 1].mean(axis=0), forward))
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = poses[:, :3, 3].mean(axis=0)
    focal = float(np.median([camera.focal_px for camera in real]))
    pinhole = Camera(1, 1, pose, focal, np.zeros(2), 0.0)
    limit = focal * np.tan(np.deg2rad(WIDEST_DEG))
    seen = np.vstack([_border(camera, pinhole) for camera in real])
    low, high = np.floor(seen.min(axis=0).clip(-limit)), np.ceil(seen.max(axis=0).clip(max=limit))
    width, height = (high - low + 1).astype(int).tolist()
    return Camera(width, height, pose, focal, -low, 0.0)


def _border(camera: Camera, pinhole: Camera) -> Array:
    """Pixels (N, 2) of ``pinhole`` that show the border of the picture of ``camera``; of directions beside or behind
    it, places far out on that side."""
    across, down = np.linspace(0, camera.width - 1, 9), np.linspace(0, camera.height - 1, 9)
    edges = [np.column_stack([across, np.full(9, row)]) for row in (0.0, camera.height - 1.0)]
    edges += [np.column_stack([np.full(9, column), down]) for column in (0.0, camera.width - 1.0)]
    ways = rays(camera, np.vstack(edges)) @ pinhole.world_T_cam[:3, :3]
    return pinhole.focal_px * ways[:, :2] / ways[:, 2:].clip(1e-6)


def carried(real: Camera, virtual: Camera, points_px: Array, athlete_m: Array) -> Array:
    """Pixels (N, 2) of ``real`` where ``virtual`` sees them, at the distance of the athlete, a place (3,)."""
    centre = real.world_T_cam[:3, 3]
    places = centre + np.linalg.norm(athlete_m - centre) * rays(real, points_px)
    return project(virtual, places)[0]


def athlete(take: Take) -> Array:
    """(F, 3) where the athlete is: the pelvis, in frames without a body that of the frame before; where no body was
    tracked, where the cameras' axes come nearest to each other, on the mean of all frames."""
    motion = take.reconstruction.motion
    if motion is not None and motion.valid.any():
        return np.asarray(motion.root_position_m[held(motion.valid)])
    square, right = np.zeros((3, 3)), np.zeros(3)
    for located in take.cameras():
        for _, camera in located.frames():
            axis = camera.world_T_cam[:3, 2]
            across = np.eye(3) - np.outer(axis, axis)
            square += across
            right += across @ camera.world_T_cam[:3, 3]
    return np.tile(np.linalg.lstsq(square, right, rcond=None)[0], (len(take.reconstruction.timecodes), 1))


def carried_keypoints(take: Take, virtual: tuple[VirtualCamera, ...]) -> list[list[Array]]:
    """The people (P, 26, 3) of each virtual camera in each frame set, as its detector found them and carried over; none
    where the take has no capture, the capture no keypoints, or the camera was not located."""
    if take.capture is None:
        return []
    sets, places = frame_sets(take.capture), athlete(take)
    found: list[list[Array]] = []
    for each in virtual:
        rows = []
        for frame, place in enumerate(places):
            people, real = sets.people(frame), each.located.at(frame)
            here = people[each.located.number] if people and real is not None else np.zeros((0, len(KEYPOINTS), 3))
            if len(here) and real is not None:
                pixels = carried(real, each.camera, here[..., :2].reshape(-1, 2), place)
                here = np.concatenate([pixels.reshape(*here.shape[:2], 2), here[..., 2:]], axis=2)
                here[here[..., 2] <= 0.0] = 0.0
            rows.append(here)
        found.append(rows)
    return found if any(len(people) for rows in found for people in rows) else []


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
