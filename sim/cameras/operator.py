"""The people behind the cameras: how they pan and zoom by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PPoly
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from pzcap.types import Array, PzcapError
from sim.cameras.optics import Rig

_RATE_HZ = 240  # at which hands are simulated
_SETTLE_S = 3.0  # an operator finds the athlete this long before the recording begins
_TILT_SMOOTHING_S = 0.3  # nobody follows every jump with the tilt


@dataclass(frozen=True, slots=True)
class OperatorConfig:
    """How steady the hands are and how the picture is framed."""

    moves: Literal["pan_zoom", "pan", "none"] = "pan_zoom"
    """Pan: zoomed once, for all of it; none: locked."""
    reaction_s: float = 0.15
    """What is seen is acted upon this much later."""
    bandwidth_hz: float = 0.9
    """Of the hand on the pan bar, a mass on a spring."""
    damping: float = 0.55
    """Of the same; below 1 it overshoots."""
    tremor_deg: float = 0.02
    """Standard deviation."""
    tremor_hz: float = 4.0
    body_height: float = 0.55
    """Of the body in the picture, image heights."""
    whole_body: bool = True
    """False: as close as `body_height` says, if only the chest stays in the picture."""
    zoom_smoothing_s: float = 0.45
    sweep_step_deg: float = 2.05
    """Between the frames of the sweep."""
    sweep_speed_variation: float = 0.05
    """Standard deviation of a step, share of the step."""
    swing_deg_s: float = 0.0
    """Peak speed of a swing to and fro about the athlete; 0: none."""
    swing_hz: float = 1.9
    zoom_swing_s: float = 0.0
    """Time to zoom through the lens's whole range and back, for its own sake; 0: as framed."""
    tilts: bool = False
    """Follows the body's height by hand, too; else the tilt stays locked."""
    trajectories: str = ""
    """CSV file of what the cameras do while the motion is recorded, in place of operators."""

    def __post_init__(self) -> None:
        if self.trajectories and (self.swing_deg_s or self.zoom_swing_s or self.tilts):
            raise PzcapError(
                f"the operator's swing_deg_s, zoom_swing_s and tilts have no effect: {self.trajectories} says what the "
                "cameras do; leave them out"
            )


class CameraPrior(NamedTuple):
    """Where a camera looks."""

    pan_rad: float
    focal_px: float
    raised_rad: float = 0.0  # above the tilt at which the head was locked


@dataclass(frozen=True, slots=True, eq=False)
class Hands:
    """Pan, focal length and tilt over time."""

    pan: PPoly  # s -> rad
    log_focal: PPoly  # s -> log px
    raised: PPoly | None = None  # s -> rad above the locked tilt; None: it stays locked

    def at(self, time_s: float) -> CameraPrior:
        raised_rad = 0.0 if self.raised is None else float(self.raised(time_s))
        return CameraPrior(float(self.pan(time_s)), float(np.exp(self.log_focal(time_s))), raised_rad)


def follow(rig: Rig, times_s: Array, points_m: Array, config: OperatorConfig, rng: np.random.Generator) -> Hands:
    """Follow a body through its motion.

    times_s: (T,) evenly spaced. points_m: (T, N, 3) points that span the body, world.
    """
    time = np.arange(times_s[0] - _SETTLE_S, times_s[-1] + 1.0, 1 / _RATE_HZ)
    limits_px = rig.reference_focal_px * np.array([rig.config.zoom_min, rig.config.zoom_max])
    target_rad, wanted_px = _sight(rig, points_m, config)
    if config.moves != "pan_zoom":
        wanted_px = np.full_like(wanted_px, wanted_px.min())
    if config.moves == "none":
        pan_rad, longest_px = _whole_way(rig, points_m)
        focal_px = np.clip(min(longest_px, wanted_px[0]), *limits_px)
        return through(time[[0, -1]], np.full(2, pan_rad), np.full(2, focal_px))
    target_rad = np.interp(time, times_s, target_rad)
    log_focal = np.interp(time, times_s, np.log(wanted_px))
    # Who films a routine knows it, and opens the lens before it is needed.
    samples = config.zoom_smoothing_s * _RATE_HZ
    log_focal = gaussian_filter1d(minimum_filter1d(log_focal, max(1, round(2 * samples)), mode="nearest"), samples)
    pan = _chase(target_rad, config) + _tremor(len(time), config, rng)
    return Hands(CubicSpline(time, pan), CubicSpline(time, np.clip(log_focal, *np.log(limits_px))))


def swinging(hands: Hands, config: OperatorConfig, rng: np.random.Generator) -> Hands:
    """The same hands, which swing to and fro with the peak speed and the frequency of ``config``."""
    time = hands.pan.x
    rate = 2 * np.pi * config.swing_hz
    swing = np.deg2rad(config.swing_deg_s) / rate * np.sin(rate * time + rng.uniform(0, 2 * np.pi))
    return replace(hands, pan=CubicSpline(time, hands.pan(time) + swing))


def zooming(hands: Hands, rig: Rig, config: OperatorConfig, rng: np.random.Generator) -> Hands:
    """The same hands, which zoom from one end of the lens's range to the other and back, again and again."""
    time = hands.pan.x
    low, high = np.log(rig.reference_focal_px * np.array([rig.config.zoom_min, rig.config.zoom_max]))
    wave = np.sin(2 * np.pi * (time / config.zoom_swing_s + rng.uniform()))
    return replace(hands, log_focal=CubicSpline(time, (low + high) / 2 + (high - low) / 2 * wave))


def tilting(
    hands: Hands, rig: Rig, times_s: Array, points_m: Array, config: OperatorConfig, rng: np.random.Generator
) -> Hands:
    """The same hands, which tilt after the body's middle as they pan. Arguments as of `follow`."""
    elevation = _elevation(rig, _in_head(rig, points_m))
    middle = (elevation.max(axis=1) + elevation.min(axis=1)) / 2
    time = hands.pan.x
    target = gaussian_filter1d(np.interp(time, times_s, middle), _TILT_SMOOTHING_S * _RATE_HZ)
    raised = _chase(target, config) + _tremor(len(time), config, rng)
    return replace(hands, raised=CubicSpline(time, raised))


def through(times_s: Array, pan_rad: Array, focal_px: Array) -> Hands:
    """Hands that pass through given values (N,) at given times (N,)."""
    return Hands(CubicSpline(times_s, pan_rad), CubicSpline(times_s, np.log(focal_px)))


def sweep_length(degrees: float, config: OperatorConfig) -> int:
    """How many frames `sweep` has."""
    return 1 + round((degrees + 4 * config.sweep_step_deg * (degrees >= 360.0)) / config.sweep_step_deg)


def sweep(degrees: float, config: OperatorConfig, rng: np.random.Generator) -> Array:
    """Pan (M,) in radians of the frames of a sweep of so many degrees, to the left, centred on the reference pose.

    A full turn (360) goes on until it has overlapped its own start.
    """
    speed = gaussian_filter1d(rng.normal(size=sweep_length(degrees, config) - 1), 4.0, mode="wrap")
    speed = 1 + config.sweep_speed_variation * speed / max(float(np.std(speed)), 1e-9)
    pan_deg = config.sweep_step_deg * np.concatenate([[0.0], np.cumsum(np.maximum(speed, 0.2))])
    return np.deg2rad(pan_deg - pan_deg[-1] / 2)


def _sight(rig: Rig, points_m: Array, config: OperatorConfig) -> tuple[Array, Array]:
    """Where an ideal operator would look (T,) rad, and with which focal length (T,) px."""
    head = _in_head(rig, points_m)
    azimuth = np.unwrap(np.arctan2(head[..., 1], head[..., 0]), axis=0)
    azimuth = azimuth[:, :1] + (azimuth - azimuth[:, :1] + np.pi) % (2 * np.pi) - np.pi
    left, right = azimuth.max(axis=1), azimuth.min(axis=1)
    slope = np.tan(np.clip(_elevation(rig, head), -1.2, 1.2))
    tall = slope.max(axis=1) - slope.min(axis=1)
    centre = (left + right) / 2
    focal = config.body_height * rig.height / np.maximum(tall, 1e-3)
    # The tilt is fixed, so the body is off the centre at times: it must fit there, too.
    if not config.whole_body:
        chest = slope.min(axis=1) + 0.75 * tall
        return centre, np.minimum(focal, 0.47 * rig.height / np.maximum(np.abs(chest), 1e-3))
    beyond = np.abs(slope).max(axis=1)
    aside = np.tan(np.minimum((left - right) / 2 + np.deg2rad(2.0), 1.2))
    focal = np.minimum(focal, 0.47 * rig.height / beyond)
    return centre, np.minimum(focal, 0.45 * rig.width / aside)


def _whole_way(rig: Rig, points_m: Array) -> tuple[float, float]:
    """Pan (rad) of a locked camera that has all of the body's way in view, and its longest focal length (px)."""
    head = _in_head(rig, points_m)
    azimuth = np.unwrap(np.unwrap(np.arctan2(head[..., 1], head[..., 0]), axis=0), axis=1)
    centre, half = (azimuth.max() + azimuth.min()) / 2, np.ptp(azimuth) / 2
    beyond = (np.abs(np.tan(_elevation(rig, head))) / np.cos(azimuth - centre)).max()
    return float(centre), float(min(0.47 * rig.height / beyond, 0.45 * rig.width / np.tan(half + np.deg2rad(2.0))))


def _in_head(rig: Rig, points_m: Array) -> Array:
    """World points (T, N, 3) in the frame of the tripod head."""
    return (points_m - rig.world_T_head[:3, 3]) @ rig.world_T_head[:3, :3]


def _elevation(rig: Rig, head_m: Array) -> Array:
    """How far (T, N) rad points in the head's frame stand above the locked optical axis."""
    return np.arctan2(head_m[..., 2], np.hypot(head_m[..., 0], head_m[..., 1])) - rig.tilt_rad


def _chase(target_rad: Array, config: OperatorConfig) -> Array:
    """A mass on a spring, pulled to where the athlete was expected to be when last seen."""
    lag = round(config.reaction_s * _RATE_HZ)
    seen = np.concatenate([np.full(lag, target_rad[0]), target_rad[: len(target_rad) - lag]])
    speed = gaussian_filter1d(np.gradient(seen, 1 / _RATE_HZ), 0.05 * _RATE_HZ)
    expected = seen + config.reaction_s * speed
    stiffness = (2 * np.pi * config.bandwidth_hz) ** 2
    friction = 2 * config.damping * np.sqrt(stiffness)
    pan = np.empty_like(target_rad)
    position, velocity = float(expected[0]), 0.0
    for k in range(len(pan)):
        velocity += (stiffness * (expected[k] - position) + friction * (speed[k] - velocity)) / _RATE_HZ
        position += velocity / _RATE_HZ
        pan[k] = position
    return pan


def _tremor(samples: int, config: OperatorConfig, rng: np.random.Generator) -> Array:
    """Smooth noise around the tremor's frequency."""
    white = rng.normal(size=samples)
    period = _RATE_HZ / config.tremor_hz
    noise = gaussian_filter1d(white, period / 8) - gaussian_filter1d(white, period / 2)
    return np.deg2rad(config.tremor_deg) * noise / max(float(np.std(noise)), 1e-9)
