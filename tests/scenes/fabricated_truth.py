"""The truth beside a reconstruction of `tests.scenes.fabricated`: one that makes it perfect."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.types import Mask, Reconstruction
from sim.truth import Truth

HEIGHT, WIDTH = 260, 320


def truth_of(whole: Reconstruction) -> Truth:
    """The truth that makes ``whole`` perfect."""
    frames = len(whole.timecodes)
    cameras = [c for c in whole.cameras if c is not None]
    tracks = [t for t in whole.tracks if t is not None]
    instants = [[geometry.of_track(c, t, f) for f in range(frames)] for c, t in zip(cameras, tracks, strict=True)]
    references = [r.camera for r in whole.references if r is not None]
    panoramas = [p for p in whole.panoramas if p is not None]
    assert whole.motion is not None
    rng = np.random.default_rng(5)
    solid = np.zeros((frames, HEIGHT * WIDTH // 8), np.uint8)
    shadow = np.zeros((2, HEIGHT * WIDTH // 8), np.uint8)
    solid[:] = np.packbits(body_mask())
    shadow[:] = np.packbits(shadow_mask())
    return Truth(
        config='{"sensor": {"read_noise": 2.0, "shot_noise": 0.02}, "optics": {"vignetting": 0.8}}',
        frame_rate=Fraction(30),
        camera_names=whole.camera_names,
        timecodes=whole.timecodes,
        width=WIDTH,
        height=HEIGHT,
        pan_rad=np.array([t.pan_rad for t in tracks]),
        tilt_rad=np.array([t.tilt_rad for t in tracks]),
        roll_rad=np.array([np.full(frames, c.roll_rad) for c in cameras]),
        focal_px=np.array([t.focal_px for t in tracks]),
        principal_px=np.array([[c.principal_px for c in row] for row in instants]),
        k1=np.array([[c.k1 for c in row] for row in instants]),
        k2=np.zeros(4),
        p1=np.zeros(4),
        world_T_cam=np.array([[c.world_T_cam for c in row] for row in instants]),
        recorded=np.ones((4, frames), bool),
        clock_offset_s=np.zeros(4),
        clock_drift=np.zeros(4),
        readout_s=np.zeros(4),
        field_s=np.zeros(4),
        gain=np.ones((4, frames, 3)),
        reference_focal_px=np.array([c.focal_px for c in references]),
        reference_principal_px=np.array([c.principal_px for c in references]),
        reference_k1=np.array([c.k1 for c in references]),
        reference_world_T_cam=np.array([c.world_T_cam for c in references]),
        sweep_pan_rad=np.array([p.sweep_pan_rad for p in panoramas]),
        sweep_focal_px=np.array([np.full(30, c.focal_px) for c in references]),
        sweep_world_T_cam=np.zeros((4, 30, 4, 4)),
        zoom_focal_px=np.zeros((4, 3)),
        zoom_pan_rad=np.zeros(4),
        scene_points_m=rng.uniform([-15, -10, 0], [15, 10, 8], (4, 400, 3)),
        measurements_m={},
        root_position_m=whole.motion.root_position_m,
        rotations=whole.motion.rotations,
        joints_m=whole.motion.joints_m,
        contact=np.ones((frames, 4), bool),
        airborne=np.arange(frames) == 5,
        mask_bits=np.tile(solid, (4, 1, 1)),
        shadow_frames=np.array([0, 10]),
        shadow_bits=np.tile(shadow, (4, 1, 1)),
    )


def body_mask() -> Mask:
    """Mask of the athlete in every view."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[20:240, 100:160] = True
    return mask


def shadow_mask() -> Mask:
    """Mask of the athlete's shadow in every view that knows it."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[230:255, 160:220] = True
    return mask
