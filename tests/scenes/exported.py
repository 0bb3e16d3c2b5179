"""A take in which every convention shows: a person in wild poses, cameras that roll, an off-centre principal point, a
lens that bends, a rate that is no whole number, a frame without a body and one without a camera, odd names."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np

from pzcap.body import kinematics, skeleton
from pzcap.export.take import Take
from pzcap.geometry.camera import at
from pzcap.types import Array, Camera, Lens, Motion, PanZoomCamera, Reconstruction
from tests.scenes import fabricated
from tests.scenes.bodies import BODY, random_pose

FRAMES, GAP, LOST = 24, 4, 6
"""Frame sets; the one without a body; the one in which the first camera is lost."""
RATE = Fraction(30000, 1001)
NAMES = ("Süd 1", "b/c", "b c", "4")
K1 = -0.11


def lens(k1: float = K1) -> Lens:
    """Its principal point is 15 and 9 pixels off, and wanders with the zoom."""
    principal = np.array([[174.5, 128.5], [3.0, -2.0]])
    return Lens(fabricated.WIDTH, fabricated.HEIGHT, fabricated.FOCAL_PX, principal, np.array([k1, 0.02 * k1]))


@cache
def reconstruction(k1: float = K1) -> Reconstruction:
    whole = fabricated.reconstruction(frames=FRAMES)
    poses = [random_pose(frame, 0.8) for frame in range(FRAMES)]
    rng = np.random.default_rng(5)
    place = np.column_stack(
        [np.linspace(-1.0, 2.0, FRAMES), np.linspace(0.5, -0.7, FRAMES), rng.uniform(0.9, 1.3, FRAMES)]
    )
    poses = [replace(pose, root_position_m=root) for pose, root in zip(poses, place, strict=True)]
    motion = Motion(
        root_position_m=place,
        rotations=np.array([pose.rotations for pose in poses]),
        joints_m=np.array([kinematics.joints(BODY, pose) for pose in poses]),
        sigma_m=rng.uniform(0.002, 0.03, (FRAMES, 16)),
        keyframes=np.array([0]),
        valid=np.arange(FRAMES) != GAP,
        body=skeleton.moved(BODY),
    )
    heads = [
        PanZoomCamera(lens(k1), head.world_T_head, -0.07, 0.06, offset_m=np.array([0.02, -0.01]), travel_m=0.03)
        for head in whole.cameras
        if head is not None
    ]
    tracks = [track for track in whole.tracks if track is not None]
    tracks[0] = replace(tracks[0], valid=np.arange(FRAMES) != LOST)
    # refined is what is exported: it differs from the track by more than any tolerance
    refined = [replace(track, pan_rad=track.pan_rad + 0.01, focal_px=1.02 * track.focal_px) for track in tracks]
    return replace(
        whole,
        capture_name="Kür, Nr. 3",
        frame_rate=RATE,
        timecodes=tuple(f"01:00:00:{5 + frame:02d}" for frame in range(FRAMES)),
        camera_names=NAMES,
        cameras=tuple(heads),
        tracks=tuple(tracks),
        refined=tuple(refined),
        motion=motion,
    )


def take(k1: float = K1) -> Take:
    return Take(reconstruction(k1))


def true_camera(number: int, frame: int, k1: float = K1) -> Camera:
    """The camera as the reconstruction has it, by the library's own formula."""
    whole = reconstruction(k1)
    head, track = whole.cameras[number], whole.refined[number]
    assert head is not None
    assert track is not None
    return at(head, track.pan_rad[frame], track.tilt_rad[frame], track.focal_px[frame])


def joints(frame: int) -> Array:
    motion = reconstruction().motion
    assert motion is not None
    return np.asarray(motion.joints_m[frame])


def ends(frame: int) -> Array:
    """(7, 3) of the body, by the library's own kinematics."""
    motion = reconstruction().motion
    assert motion is not None
    assert motion.body is not None
    pose = replace(random_pose(frame, 0.8), root_position_m=motion.root_position_m[frame])
    frames = kinematics.forward(BODY, pose)
    carriers = np.array([3, 6, 9, 12, 15, 12, 15])
    return kinematics.world_points(frames, carriers, motion.body.ends_m)
