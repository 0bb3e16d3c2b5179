"""Collects the truth about a capture, as a `sim.truth.Truth`, from what the filming of each camera leaves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array
from sim.cameras.operator import Trajectory
from sim.cameras.optics import Rig
from sim.motion import END_POINTS
from sim.session import Run, Session
from sim.truth import Truth


@dataclass(frozen=True, slots=True, eq=False)
class FilmedCamera:
    """Way of one camera through the motion, and what it sees; arrays as in `sim.truth.Truth`, of this camera."""

    way: Trajectory
    scene_points_m: Array
    mask_bits: NDArray[np.uint8]
    shadow_bits: NDArray[np.uint8]


def collect_truth(
    session: Session, filmed: Sequence[FilmedCamera], joints_m: Array, shadow_frames: NDArray[np.int64]
) -> Truth:
    """The truth about a capture without a dropped frame, before it is developed. joints_m: (F, 16, 3)."""
    config, rigs, times_s = session.config, session.rigs, session.times_s
    own_s = np.array([session.own_s(c, times_s) for c in range(config.cameras)])
    pan_rad, focal_px, raised_rad, rolled_rad = _sampled([one.way for one in filmed], own_s)
    clock_offset_s, clock_drift = session.own_clocks()
    frames = len(times_s)
    sweeps, zooms = [[run(c) for c in range(config.cameras)] for run in (session.sweep, session.zoom)]
    sweep_pan_rad, sweep_focal_px, *_ = _sampled(sweeps, [run.times_s for run in sweeps])
    zoom_pan_rad, zoom_focal_px = np.zeros((config.cameras, 1)), np.zeros((config.cameras, 0))
    if config.zoom_frames:
        zoom_pan_rad, zoom_focal_px, *_ = _sampled(zooms, [run.times_s for run in zooms])
    reference_px = rigs[0].reference_focal_px
    fewest = min(len(one.scene_points_m) for one in filmed)
    poses = [session.clip.at(t) for t in times_s.tolist()]
    contact = [[session.clip.contacts(t)[end] for end in END_POINTS] for t in times_s.tolist()]
    return Truth(
        config=json.dumps(asdict(config)),
        frame_rate=Fraction(config.frame_rate),
        camera_names=config.camera_names,
        timecodes=session.timecodes(),
        width=config.width,
        height=config.height,
        pan_rad=pan_rad,
        tilt_rad=np.array([[rig.tilt_rad] for rig in rigs]) + raised_rad,
        roll_rad=np.array([[rig.roll_rad] for rig in rigs]) + rolled_rad,
        focal_px=focal_px,
        principal_px=np.repeat([[rig.principal_px] for rig in rigs], frames, axis=1),
        k1=np.array([[rig.k1(f) for f in row] for rig, row in zip(rigs, focal_px, strict=True)]),
        k2=np.full(config.cameras, config.optics.k2),
        p1=np.full(config.cameras, config.optics.p1),
        world_T_cam=_poses(rigs, pan_rad, focal_px, raised_rad, rolled_rad),
        recorded=np.ones((config.cameras, frames), bool),
        clock_offset_s=clock_offset_s,
        clock_drift=clock_drift,
        readout_s=np.full(config.cameras, config.sensor.readout_s),
        field_s=np.full(config.cameras, 0.0 if config.sensor.bob else config.sensor.field_s),
        gain=np.ones((config.cameras, frames, 3)),
        reference_focal_px=np.full(config.cameras, reference_px),
        reference_principal_px=np.array([rig.principal_px for rig in rigs]),
        reference_k1=np.array([rig.k1(reference_px) for rig in rigs]),
        reference_world_T_cam=np.stack([rig.world_T_cam(0.0, reference_px) for rig in rigs]),
        sweep_pan_rad=sweep_pan_rad,
        sweep_world_T_cam=_poses(rigs, sweep_pan_rad, sweep_focal_px),
        sweep_focal_px=sweep_focal_px,
        zoom_focal_px=zoom_focal_px,
        zoom_pan_rad=zoom_pan_rad[:, 0],
        scene_points_m=np.stack([one.scene_points_m[:fewest] for one in filmed]),
        measurements_m=session.measurements,
        root_position_m=np.stack([pose.root_position_m for pose in poses]),
        rotations=np.stack([pose.rotations for pose in poses]),
        joints_m=joints_m,
        contact=np.array(contact),
        airborne=np.array([not any(row) for row in contact]),
        mask_bits=np.stack([one.mask_bits for one in filmed]),
        shadow_frames=shadow_frames,
        shadow_bits=np.stack([one.shadow_bits for one in filmed]),
    )


def _sampled(
    trajectories: Sequence[Trajectory | Run], times_s: Array | Sequence[Array]
) -> tuple[Array, Array, Array, Array]:
    """Pan, focal length, and tilt and roll beyond the locked ones, (C, N) each, at these times (C, N)."""
    values = np.array([[one.at(t) for t in own_s.tolist()] for one, own_s in zip(trajectories, times_s, strict=True)])
    return values[..., 0], values[..., 1], values[..., 2], values[..., 3]


def _poses(rigs: list[Rig], *aims: Array) -> Array:
    """(C, N, 4, 4) for pan, focal length, tilt and roll (C, N) each; without the last they are as locked."""
    return np.array(
        [[rig.world_T_cam(*aim) for aim in zip(*row, strict=True)] for rig, *row in zip(rigs, *aims, strict=True)]
    )
