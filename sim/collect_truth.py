"""Collects the truth about a capture from the session that filmed it, as a `sim.truth.Truth`."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, Mask
from sim.cameras.operator import Trajectory, sweep_length
from sim.cameras.optics import Rig
from sim.motion import END_POINTS
from sim.scene import scene_points, stream
from sim.session import CAMERAS, Session
from sim.truth import Truth

_SCENE_POINTS: Final = 600  # rays cast for each camera


@dataclass(frozen=True, slots=True, eq=False)
class FilmedMotion:
    """The filmed motion; fields as in `sim.truth.Truth`."""

    times_s: Array
    timecodes: tuple[str, ...]
    joints_m: Array
    trajectories: list[Trajectory]
    recorded: Mask
    mask_bits: NDArray[np.uint8]
    shadow_frames: NDArray[np.int64]
    shadow_bits: NDArray[np.uint8]


def collect_truth(session: Session, hall: dict[str, list[Trajectory]], filmed: FilmedMotion) -> Truth:
    """Return the truth. ``hall`` holds the trajectories of the cameras' "sweep" and, if there was one, "zoom" runs."""
    config, rigs = session.config, session.rigs
    pan_rad, focal_px, raised_rad = _sampled(filmed.trajectories, filmed.times_s)
    frames = len(filmed.times_s)
    sweep_times_s = np.arange(sweep_length(config.sweep_deg, config.operator)) / config.sweep_frame_rate
    zoom_times_s = np.arange(config.zoom_frames) / config.sweep_frame_rate
    sweep_pan_rad = _sampled(hall["sweep"], sweep_times_s)[0]
    zoom_pan_rad, zoom_focal_px = np.zeros((CAMERAS, 1)), np.zeros((CAMERAS, 0))
    if config.zoom_frames:
        zoom_pan_rad, zoom_focal_px, _ = _sampled(hall["zoom"], zoom_times_s)
    reference_px = rigs[0].reference_focal_px
    points = [
        scene_points(session.stage, rig, sweep_pan_rad[c], _SCENE_POINTS, stream(config.seed, "points", c))
        for c, rig in enumerate(rigs)
    ]
    fewest = min(len(group) for group in points)
    poses = [session.clip.at(t) for t in filmed.times_s.tolist()]
    contact = [[session.clip.contacts(t)[end] for end in END_POINTS] for t in filmed.times_s.tolist()]
    return Truth(
        config=json.dumps(asdict(config)),
        frame_rate=Fraction(config.frame_rate),
        camera_names=tuple(files.name for files in session.files),
        timecodes=filmed.timecodes,
        width=config.width,
        height=config.height,
        pan_rad=pan_rad,
        tilt_rad=np.array([[rig.tilt_rad] for rig in rigs]) + raised_rad,
        roll_rad=np.array([rig.roll_rad for rig in rigs]),
        focal_px=focal_px,
        principal_px=np.repeat([[rig.principal_px] for rig in rigs], frames, axis=1),
        k1=np.array([[rig.k1(f) for f in row] for rig, row in zip(rigs, focal_px, strict=True)]),
        world_T_cam=_poses(rigs, pan_rad, focal_px, raised_rad),
        recorded=filmed.recorded,
        reference_focal_px=np.full(CAMERAS, reference_px),
        reference_principal_px=np.array([rig.principal_px for rig in rigs]),
        reference_k1=np.array([rig.k1(reference_px) for rig in rigs]),
        reference_world_T_cam=np.stack([rig.world_T_cam(0.0, reference_px) for rig in rigs]),
        sweep_pan_rad=sweep_pan_rad,
        sweep_world_T_cam=_poses(
            rigs, sweep_pan_rad, np.full_like(sweep_pan_rad, reference_px), np.zeros_like(sweep_pan_rad)
        ),
        zoom_focal_px=zoom_focal_px,
        zoom_pan_rad=zoom_pan_rad[:, 0],
        scene_points_m=np.stack([group[:fewest] for group in points]),
        measurements_m=session.measurements,
        root_position_m=np.stack([pose.root_position_m for pose in poses]),
        rotations=np.stack([pose.rotations for pose in poses]),
        joints_m=filmed.joints_m,
        contact=np.array(contact),
        airborne=np.array([not any(row) for row in contact]),
        mask_bits=filmed.mask_bits,
        shadow_frames=filmed.shadow_frames,
        shadow_bits=filmed.shadow_bits,
    )


def _sampled(trajectories: list[Trajectory], times_s: Array) -> tuple[Array, Array, Array]:
    """Pan, focal length and tilt above the locked one, (C, N) each, at these times."""
    values = np.array([[one.at(t) for t in times_s.tolist()] for one in trajectories])
    return values[..., 0], values[..., 1], values[..., 2]


def _poses(rigs: list[Rig], *aims: Array) -> Array:
    """(C, N, 4, 4) for pan, focal length and tilt (C, N) each."""
    return np.array(
        [[rig.world_T_cam(*aim) for aim in zip(*row, strict=True)] for rig, *row in zip(rigs, *aims, strict=True)]
    )
