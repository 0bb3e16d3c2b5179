"""Camera operators: trajectories of pan, zoom and tilt by hand, and the sweep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PPoly
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from pzcap.types import Array, PzcapError
from sim.cameras.optics import Rig
from sim.cameras.tripod import Unrest
from sim.ranges import Degrees, Range, Seconds

_RATE_HZ = 240  # at which trajectories are simulated
_SETTLE_S = 3.0  # an operator finds the athlete this long before the recording begins
_TILT_SMOOTHING_S = 0.3  # nobody follows every jump with the tilt


@dataclass(frozen=True, slots=True)
class OperatorConfig:
    """Steadiness of the operators, and framing of the picture."""

    moves: Literal["pan_zoom", "pan", "none"] = "pan_zoom"
    """Movements of the camera. pan: zoomed once, so that the athlete fits all the time; none: locked, with all of the
    athlete's way in view."""
    reaction_s: Seconds = 0.15
    """Delay between what an operator sees and does, s: the reaction time of a human who expects a movement."""
    bandwidth_hz: Annotated[float, Range(0.05, 100.0)] = 0.9
    """Natural frequency of the pan, a mass on a spring, Hz: a fluid head follows a person, and overshoots at leaps."""
    damping: Annotated[float, Range(0.05, 10.0)] = 0.55
    """Damping ratio of the pan; below 1 it overshoots."""
    tremor_deg: Degrees = 0.02
    """Standard deviation of the hand's tremor in pan and tilt, degrees: what a fluid head lets through."""
    tremor_hz: Annotated[float, Range(0.1, 100.0)] = 4.0
    """Frequency about which the tremor lies, Hz: that of an arm that holds a bar."""
    body_height: Annotated[float, Range(0.02, 5.0)] = 0.55
    """Height of the body in the picture, image heights: room for a leap. The zoom range limits it."""
    whole_body: bool = True
    """All of the body stays in the picture. Off: only the chest does, as close as `body_height` says."""
    zoom_smoothing_s: Seconds = 0.45
    """Time over which the zoom is smoothed, s, standard deviation: it follows the distance and not each movement."""
    sweep_step_deg: Annotated[float, Range(0.05, 60.0)] = 2.05
    """Step between frames of the sweep, degrees: neighbours overlap by 95 % of the image."""
    sweep_speed_variation: Annotated[float, Range(0.0, 0.3)] = 0.05
    """Standard deviation of a step of the sweep, share of the step: it is panned by hand."""
    sweep_uneven: Annotated[float, Range(0.0, 0.9)] = 0.0
    """Largest departure of the sweep's speed from its mean, share of it, in slow waves; the turn stays as wide. 0: none
    but `sweep_speed_variation`; 0.5: a hurried hand."""
    sweep_stop_frames: Annotated[int, Range(0, 100)] = 0
    """Frames for which the sweep stands still once, in its first half; 0: it goes on."""
    sweep_back_frames: Annotated[int, Range(0, 100)] = 0
    """Frames for which the sweep turns back once, in its second half, before it goes on; 0: it never does."""
    sweep_zoom: Annotated[float, Range(0.5, 2.0)] = 1.0
    """Focal length of the sweep over that of the reference image. 1: the zoom's mark was met."""
    swing_deg_s: Annotated[float, Range(0.0, 1000.0)] = 0.0
    """Peak speed of a swing to and fro about the athlete, degrees per second; 0: none."""
    swing_hz: Annotated[float, Range(0.01, 20.0)] = 1.9
    """Frequency of the swing to and fro, Hz."""
    zoom_swing_s: Seconds = 0.0
    """Period of a zoom through the lens's whole range and back, s, whatever the athlete does; 0: none."""
    tilts: bool = False
    """The operator follows the body's height by tilting. Off: the tilt stays locked, as the paper asks for."""
    trajectories: str = ""
    """CSV file of pan, tilt and focal length that replaces the operators while the motion is recorded."""

    def __post_init__(self) -> None:
        if self.trajectories and (self.swing_deg_s or self.zoom_swing_s or self.tilts):
            raise PzcapError(
                f"the operator's swing_deg_s, zoom_swing_s and tilts have no effect: {self.trajectories} says what the "
                "cameras do; leave them out"
            )


class PanTiltZoom(NamedTuple):
    """Pan, zoom, tilt and roll of a camera at one moment."""

    pan_rad: float
    focal_px: float
    raised_rad: float = 0.0  # above the tilt at which the head was locked
    rolled_rad: float = 0.0  # beyond the roll that the camera has on its head


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Pan, focal length, tilt and roll of a camera over time."""

    pan: PPoly  # s -> rad
    log_focal: PPoly  # s -> log px
    raised: PPoly | None = None  # s -> rad above the locked tilt; None: it stays locked
    unrest: Unrest | None = None  # of the tripod, which adds to that; None: it stands still

    def at(self, time_s: float) -> PanTiltZoom:
        raised_rad = 0.0 if self.raised is None else float(self.raised(time_s))
        aim = PanTiltZoom(float(self.pan(time_s)), float(np.exp(self.log_focal(time_s))), raised_rad)
        if self.unrest is None:
            return aim
        pan_rad, raised_rad, rolled_rad = self.unrest.at(time_s).tolist()
        return PanTiltZoom(aim.pan_rad + pan_rad, aim.focal_px, aim.raised_rad + raised_rad, rolled_rad)


def follow(rig: Rig, times_s: Array, points_m: Array, config: OperatorConfig, rng: np.random.Generator) -> Trajectory:
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
    # An operator who films a routine knows it, and zooms out before it is needed.
    samples = config.zoom_smoothing_s * _RATE_HZ
    log_focal = gaussian_filter1d(minimum_filter1d(log_focal, max(1, round(2 * samples)), mode="nearest"), samples)
    pan = _chase(target_rad, config) + _tremor(len(time), config, rng)
    return Trajectory(CubicSpline(time, pan), CubicSpline(time, np.clip(log_focal, *np.log(limits_px))))


def swinging(trajectory: Trajectory, config: OperatorConfig, rng: np.random.Generator) -> Trajectory:
    """The same, swinging to and fro with the peak speed and the frequency of ``config``."""
    time = trajectory.pan.x
    rate = 2 * np.pi * config.swing_hz
    swing = np.deg2rad(config.swing_deg_s) / rate * np.sin(rate * time + rng.uniform(0, 2 * np.pi))
    return replace(trajectory, pan=CubicSpline(time, trajectory.pan(time) + swing))


def zooming(trajectory: Trajectory, rig: Rig, config: OperatorConfig, rng: np.random.Generator) -> Trajectory:
    """The same, zooming from one end of the lens's range to the other and back, again and again."""
    time = trajectory.pan.x
    low, high = np.log(rig.reference_focal_px * np.array([rig.config.zoom_min, rig.config.zoom_max]))
    wave = np.sin(2 * np.pi * (time / config.zoom_swing_s + rng.uniform()))
    return replace(trajectory, log_focal=CubicSpline(time, (low + high) / 2 + (high - low) / 2 * wave))


def tilting(
    trajectory: Trajectory, rig: Rig, times_s: Array, points_m: Array, config: OperatorConfig, rng: np.random.Generator
) -> Trajectory:
    """The same, tilting after the body's middle. Arguments as of `follow`."""
    elevation = _elevation(rig, _in_head(rig, points_m))
    middle = (elevation.max(axis=1) + elevation.min(axis=1)) / 2
    time = trajectory.pan.x
    target = gaussian_filter1d(np.interp(time, times_s, middle), _TILT_SMOOTHING_S * _RATE_HZ)
    raised = _chase(target, config) + _tremor(len(time), config, rng)
    return replace(trajectory, raised=CubicSpline(time, raised))


def through(times_s: Array, pan_rad: Array, focal_px: Array) -> Trajectory:
    """Trajectory through given values (N,) at given times (N,)."""
    return Trajectory(CubicSpline(times_s, pan_rad), CubicSpline(times_s, np.log(focal_px)))


def sweep_length(degrees: float, config: OperatorConfig) -> int:
    """Number of frames of `sweep`."""
    return 1 + round((degrees + 4 * config.sweep_step_deg * (degrees >= 360.0)) / config.sweep_step_deg)


def sweep(degrees: float, config: OperatorConfig, rng: np.random.Generator) -> Array:
    """Pan (M,) in radians of the frames of a sweep of so many degrees, to the left, centred on the reference pose.

    A full turn (360) goes on until it has overlapped its own start.
    """
    speed = gaussian_filter1d(rng.normal(size=sweep_length(degrees, config) - 1), 4.0, mode="wrap")
    speed = 1 + config.sweep_speed_variation * speed / max(float(np.std(speed)), 1e-9)
    pan_deg = config.sweep_step_deg * np.concatenate([[0.0], np.cumsum(np.maximum(speed, 0.2))])
    return np.deg2rad(pan_deg - pan_deg[-1] / 2)


def faltering(pan_rad: Array, config: OperatorConfig, rng: np.random.Generator) -> Array:
    """The pan (M,) of a sweep at an uneven speed, with a stop and a step back: as many frames longer as those take."""
    steps = np.arange(float(len(pan_rad)))
    cycles = np.arange(1, 7)  # in all of the sweep
    wave = np.sin(2 * np.pi * (np.outer(steps[:-1] / len(steps[:-1]), cycles) + rng.uniform(size=6))).sum(axis=1)
    speed = 1 + config.sweep_uneven * (wave - wave.mean()) / np.abs(wave - wave.mean()).max()
    pan_rad = np.interp(np.concatenate([[0.0], np.cumsum(speed)]), steps, pan_rad)
    stop, turn = (float(share * (len(pan_rad) - 1)) for share in rng.uniform([0.2, 0.6], [0.4, 0.8]))
    back = 0.8 * np.arange(1, config.sweep_back_frames + 1)  # somewhat slower than forward
    # places on the way of an even sweep, in steps; the fraction keeps it from showing the same picture twice
    way = [steps[steps < stop], np.full(config.sweep_stop_frames, stop), steps[(steps >= stop) & (steps < turn)]]
    way += [turn - back, (turn - back)[::-1][1:], np.full(min(len(back), 1), turn), steps[steps >= turn]]
    return np.interp(np.concatenate(way), steps, pan_rad)


def _sight(rig: Rig, points_m: Array, config: OperatorConfig) -> tuple[Array, Array]:
    """Pan (T,) rad and focal length (T,) px of an ideal operator."""
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
    """Elevation (T, N) rad of points in the head's frame above the locked optical axis."""
    return np.arctan2(head_m[..., 2], np.hypot(head_m[..., 0], head_m[..., 1])) - rig.tilt_rad


def _chase(target_rad: Array, config: OperatorConfig) -> Array:
    """Angle (T,) of a damped mass on a spring, pulled to where the athlete is expected from what was last seen."""
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
