"""What a detector finds of `tests.scenes.body_scene.swing` in four views, without a picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.body import kinematics
from pzcap.body import skeleton as bodies
from pzcap.body.landmarks import Landmarks
from pzcap.body.skeleton import Body
from pzcap.geometry.camera import project
from pzcap.initialisation.people import Detections
from pzcap.io.detections import KEYPOINTS
from pzcap.tracking.keypoint_residuals import in_world
from pzcap.types import Array, Camera, Pose, Subject
from sim.people.anthropometry import draw_measurements
from tests.scenes.body_scene import POSITIONS, aim, swing

LEFT = [k for k, name in enumerate(KEYPOINTS) if name.startswith("left_")]
RIGHT = [KEYPOINTS.index(KEYPOINTS[k].replace("left_", "right_")) for k in LEFT]
RATE = 15.0


@dataclass(frozen=True)
class Faults:
    """Errors of the detector."""

    meaning_m: float = 0.014  # of each keypoint's place on the body, the same in all frames
    noise_px: float = 2.5
    backward: tuple[tuple[int, int], ...] = ()  # frames and views in which all sides are exchanged
    turned: tuple[tuple[int, int], ...] = ()  # frames and views that are turned over
    other: bool = False  # a second person stands nearby


@cache
def body() -> Body:
    return bodies.build(Subject(draw_measurements(np.random.default_rng(3)), 0.004))


def poses(count: int) -> list[Pose]:
    return [swing(frame / RATE) for frame in range(count)]


def cameras() -> list[Camera]:
    return [aim(position, np.array([-0.2, 0.2, 0.9])) for position in POSITIONS]


def meant(faults: Faults, seed: int) -> Array:
    """(26, 3) Places on the body that the detector takes for the keypoints."""
    rng = np.random.default_rng(seed)
    return np.asarray(body().landmarks.points_m + rng.normal(0.0, faults.meaning_m, (len(KEYPOINTS), 3)))


def detections(count: int, faults: Faults, seed: int = 0) -> list[Detections]:
    """The people in each view of successive frames."""
    marks = Landmarks(meant(faults, seed), body().landmarks.sigma_m)
    found = []
    for frame, pose in enumerate(poses(count)):
        views = []
        for number, camera in enumerate(cameras()):
            rng = np.random.default_rng([frame, number, seed])
            person = _seen(camera, in_world(marks, kinematics.forward(body(), pose)), faults.noise_px, rng)
            if (frame, number) in faults.backward:
                person[LEFT + RIGHT] = person[RIGHT + LEFT]
            if (frame, number) in faults.turned:
                person[:, :2] = 2.0 * np.median(person[:, :2], axis=0) - person[:, :2]
            people = [person]
            if faults.other:
                there = in_world(marks, kinematics.forward(body(), _bystander()))
                people.insert(frame % 2, _seen(camera, there, faults.noise_px, rng))
            views.append((camera, np.stack(people)))
        found.append(Detections(tuple(views)))
    return found


def _seen(camera: Camera, points_m: Array, noise_px: float, rng: np.random.Generator) -> Array:
    pixels = project(camera, points_m)[0] + rng.normal(0.0, noise_px, (len(points_m), 2))
    return np.column_stack([pixels, rng.uniform(0.6, 1.0, len(pixels))])


def _bystander() -> Pose:
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (16, 1))
    rotations[0] = Rotation.from_euler("z", 2.0).as_quat(scalar_first=True)
    return Pose(np.array([0.4, -0.9, 0.95]), rotations)
