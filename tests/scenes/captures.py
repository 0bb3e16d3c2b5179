"""Shoots that tests share, filmed once and kept, cameras that face a place, and their projection."""

from __future__ import annotations

import fcntl
from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments import footage
from experiments.config import AppConfig
from experiments.footage import SMALL
from pzcap.types import Array, Camera
from sim.session import ShootConfig

CAPTURES = Path(__file__).parent.parent.parent / AppConfig().output.captures
TINY = replace(
    SMALL, motion_frames=2, width=160, height=120, sweep_deg=8.0, zoom_frames=2,
    gym=replace(SMALL.gym, texture_px_per_m=50.0),
)  # fmt: skip


def shot(config: ShootConfig) -> Path:
    """The folder of a shoot, made once and kept for later test runs; safe when tests run side by side."""
    CAPTURES.mkdir(parents=True, exist_ok=True)
    with (CAPTURES / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return footage.shot(config, CAPTURES)


def facing(place_m: Array, target_m: Array) -> Array:
    """(4, 4) ``world_T_cam`` of an upright camera at a place (3,) that looks at a target (3,)."""
    forward = np.subtract(target_m, place_m) / np.linalg.norm(np.subtract(target_m, place_m))
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_T_cam[:3, 3] = place_m
    return world_T_cam


def project(camera: Camera, points_m: Array) -> Array:
    """World points (N, 3) to pixels (N, 2) by the formulas of `pzcap.types`; NaN behind the camera."""
    cam_T_world = np.linalg.inv(camera.world_T_cam)
    points = points_m @ cam_T_world[:3, :3].T + cam_T_world[:3, 3]
    xy = points[:, :2] / np.where(points[:, 2:] > 0.5, points[:, 2:], np.nan)
    return camera.principal_px + camera.focal_px * (1 + camera.k1 * np.sum(xy**2, axis=1, keepdims=True)) * xy
