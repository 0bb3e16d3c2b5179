"""A capture of grey pictures whose cameras are known, and the true poses of somebody who crosses it: to be edited."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.body.skeleton import build
from pzcap.editor.inverse_kinematics import HANDLES, Click, Problem
from pzcap.editor.workspace import Workspace
from pzcap.geometry.camera import of_track
from pzcap.io.capture import read_capture
from pzcap.types import SEGMENTS, Array, Camera, Pose, Reconstruction
from sim.capture_writer import write_subject, write_video
from tests.scenes import bodies, fabricated
from tests.scenes.captures import project

FRAMES = 12
BODY = build(bodies.subject())


@cache
def found(*, tracked: bool = False) -> Reconstruction:
    """Four cameras that follow the walker; the body is ``tracked`` nowhere, or standing everywhere."""
    whole = fabricated.reconstruction(frames=FRAMES)
    return whole if tracked else replace(whole, motion=None)


def cameras(frame: int) -> tuple[Camera, ...]:
    parts = zip(found().cameras, found().tracks, strict=True)
    return tuple(of_track(head, track, frame) for head, track in parts if head is not None and track is not None)


def problem(frame: int = 0) -> Problem:
    return Problem(BODY, cameras(frame))


def true_pose(frame: int) -> Pose:
    """Striding, an arm raised, turned to the left."""
    turn = {name: np.zeros(3) for name in SEGMENTS}
    phase = 0.5 * frame
    turn["pelvis"] = np.array([0.0, 0.1, 1.2])
    turn["thorax"] = np.array([0.0, 0.1, 0.2 * np.sin(phase)])
    turn["left_upper_arm"] = np.array([0.9, -0.4, 0.0])
    turn["left_forearm"] = np.array([0.0, -1.1, 0.0])
    turn["right_upper_arm"] = np.array([-0.3, 0.5 * np.cos(phase), 0.0])
    turn["right_forearm"] = np.array([0.0, -0.4, 0.0])
    turn["left_thigh"] = np.array([0.1, -0.5, 0.0])
    turn["left_shank"] = np.array([0.0, 0.7, 0.0])
    turn["right_thigh"] = np.array([-0.1, 0.3, 0.0])
    turn["right_shank"] = np.array([0.0, 0.3, 0.0])
    root = fabricated.reconstruction(frames=FRAMES).motion
    assert root is not None
    rotations = Rotation.from_rotvec([turn[name] for name in SEGMENTS]).as_quat(scalar_first=True)
    return Pose(root.root_position_m[frame] + np.array([0.05, -0.1, 0.0]), rotations)


def true_pixels(frame: int, camera: int) -> Array:
    """(23, 2) where the handles are seen."""
    return project(cameras(frame)[camera], problem(frame).handles(true_pose(frame)))


def clicks(frame: int, views: Sequence[int], noise_px: float = 0.0, seed: int = 0) -> list[Click]:
    """Every handle clicked in these views."""
    rng = np.random.default_rng(seed)
    return [
        Click(handle, camera, *(true_pixels(frame, camera)[handle] + rng.normal(0.0, noise_px, 2)).tolist(), 1.0)
        for handle in range(len(HANDLES))
        for camera in views
    ]


def capture(folder: Path) -> Path:
    """A capture folder without keyframes."""
    names = found().camera_names
    for name in names:
        (folder / name).mkdir(parents=True)
        grey = np.full((fabricated.HEIGHT, fabricated.WIDTH, 3), 90, np.uint8)
        shades = (np.asarray(grey + 4 * n, np.uint8) for n in range(FRAMES))
        write_video(folder / name / "motion.mp4", shades, Fraction(30), crf=20, timecode="01:00:00:00")
    write_subject(folder / "subject.json", bodies.subject())
    content = {
        "format": "pzcap-capture", "version": 1, "name": "fabricated", "frame_rate": "30/1", "full_turn": True,
        "cameras": [{"name": name, "motion": f"{name}/motion.mp4"} for name in names],
        "object": None, "subject": "subject.json", "keyframes": None,
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(content, indent=1) + "\n")
    return folder


_OPEN: dict[Path, Workspace] = {}


def workspace(folder: Path, *, tracked: bool = False) -> Workspace:
    """The capture in ``folder``, opened to be edited. One that was open on it is left as a process that is killed
    leaves it: the system lets go of its lock, and nothing else happens."""
    if folder in _OPEN:
        _OPEN.pop(folder).close()
    return _OPEN.setdefault(folder, Workspace(read_capture(folder), found(tracked=tracked)))
