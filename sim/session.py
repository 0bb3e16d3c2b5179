"""A filming session: hall, athlete, motion and cameras, drawn from one configuration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from pzcap.io.timecode import frames_per_day, frames_to_timecode
from pzcap.types import Array, PzcapError
from sim import motion
from sim.cameras.film import Person, finest_plate
from sim.cameras.operator import OperatorConfig, PanTiltZoom, Trajectory, faltering, sweep, through
from sim.cameras.optics import OpticsConfig, Rig, build_rig
from sim.cameras.render import LARGEST_PICTURE_PX, Stage
from sim.cameras.sensor import SensorConfig, draw_clocks, nearest_frames, rolls
from sim.cameras.trajectories import read_trajectories
from sim.cameras.tripod import Unrest
from sim.hall import gym, sound
from sim.hall.gym import GymConfig
from sim.hall.mains import Mains, draw_mains
from sim.motion import MotionClip
from sim.people.anthropometry import draw_measurements
from sim.people.athlete import GEOM_GROUP, AthleteConfig, set_pose
from sim.people.company import Companion, coach, walkers
from sim.people.crew import CrewConfig, to_and_fro
from sim.people.detector import DetectorConfig
from sim.people.loose_clothing import Clothes
from sim.ranges import Range
from sim.scene import describe_scene, stream

_SIGNAL_S: Final = 0.15  # after the first frame that all cameras have: a clap, or a lamp that is lit
_LIT_S: Final = 0.25
_FLASH: Final = 1.3


@dataclass(frozen=True, slots=True)
class ShootConfig:
    """All that decides what a capture looks like. The same config, and files that it names, give the same bytes."""

    seed: Annotated[int, Range(0, 2**32 - 1)] = 0
    """Seed of all that chance decides: athlete, motion, tripods, hands, noise. Any integer from 0."""
    motion: str = "floor_exercise"
    """Motion of the athlete: a module of sim.motion, or a BVH file. Tumbling is what the method has to follow."""
    motion_frames: Annotated[int, Range(0, 1_000_000)] = 0
    """Frames of the motion to film, from its start; 0: all."""
    width: Annotated[int, Range(32, 8192, step=2)] = 640
    """Image width, px."""
    height: Annotated[int, Range(32, 8192, step=2)] = 480
    """Image height, px. At 640 x 480 a capture is filmed in minutes."""
    cameras: Annotated[int, Range(2, 8)] = 4
    """Cameras: the first four stand in the corners of the hall, further ones along a wall each."""
    frame_rate: Annotated[int, Range(1, 240)] = 30
    """Frames a second of the motion video."""
    sweep_deg: Annotated[float, Range(1.0, 360.0)] = 360.0
    """Range of the pan sweep, degrees. 360: a full turn and on past its own start, so that the circle closes; less:
    centred on the reference pose."""
    sweep_frame_rate: Annotated[int, Range(1, 240)] = 5
    """Frames a second of the sweep and the zoom run: a slow pan of ten degrees a second."""
    zoom_frames: Annotated[int, Range(0, 1000)] = 22
    """Frames of the zoom run, from the widest to the longest focal length; 0: no zoom run."""
    gym: GymConfig = field(default_factory=GymConfig)
    athlete: AthleteConfig = field(default_factory=AthleteConfig)
    operator: OperatorConfig = field(default_factory=OperatorConfig)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    crew: CrewConfig = field(default_factory=CrewConfig)
    detector: DetectorConfig = field(default_factory=DetectorConfig)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras, as crews number them."""
        return tuple(str(c + 1) for c in range(self.cameras))

    def __post_init__(self) -> None:
        if self.zoom_frames < 0 or self.zoom_frames == 1:
            raise PzcapError(f"zoom_frames is {self.zoom_frames}; give 2 or more, or 0 for no zoom run")


class Files(NamedTuple):
    """Files that one camera records; as `pzcap.types.CameraFiles`."""

    name: str
    reference: Path | None
    sweep: Path
    zoom: Path | None
    motion: Path
    keypoints: Path | None


class Clock(NamedTuple):
    """Begin and end of the motion's recordings."""

    start: int  # frames since midnight of the first frame that all cameras have
    early: list[int]  # frames that each camera starts before that
    late: list[int]  # frames that each camera stops after the last


class Run(NamedTuple):
    """Way of a camera through the empty hall, by the times of its frames (N,)."""

    times_s: Array
    trajectory: Trajectory | None  # None: no frame

    def at(self, time_s: float) -> PanTiltZoom:
        assert self.trajectory is not None, "a run without a frame has no way"
        return self.trajectory.at(time_s)


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """The cameras, an athlete, and the motion to film."""

    config: ShootConfig
    measurements: dict[str, float]
    clip: MotionClip
    rigs: list[Rig]
    times_s: Array  # (F,) of the frames of the motion
    given_trajectories: list[Trajectory]  # from a file; empty: operators follow the body

    def model_spec(self) -> mujoco.MjSpec:
        """Hall, athlete, calibration object and whoever else is there."""
        config = self.config
        return describe_scene(config.seed, config.gym, config.athlete, self.measurements, self.company())

    def company(self) -> list[Companion]:
        """Whoever else is in the hall while the motion is filmed."""
        crew, seed, end_s = self.config.crew, self.config.seed, float(self.times_s[-1])
        kind = crew.company

        def somebody(number: int) -> tuple[dict[str, float], MotionClip]:
            measurements = draw_measurements(stream(seed, "other", number))
            return measurements, motion.make("pedestrian", measurements, stream(seed, "other's walk", number))

        if kind == "none":
            return []
        if kind == "bystanders":
            cameras_m = np.array([rig.world_T_head[:3, 3] for rig in self.rigs])
            return walkers(self.clip, [somebody(0), somebody(1)], cameras_m, end_s)
        return [coach(self.clip, *somebody(0), end_s, crew.coach_m, touches=kind == "spotter")]

    def accompany(self, stage: Stage) -> None:
        """Let in whoever else is there, and hang loose clothes: from now on the motion is filmed."""
        others, athlete = self.company(), self.config.athlete
        clothes = Clothes(stage.model, self.clip, athlete.loose_m, stream(self.config.seed, "clothes"))

        def at(time_s: float) -> None:
            for other in others:
                set_pose(stage.model, stage.data, other.at(time_s), other.name)
            clothes.hang(stage.data, time_s)

        stage.accompany, stage.others = at, bool(others)

    def stage(self) -> Stage:
        """Set up the hall for filming. It has to be closed in the end."""
        optics, sensor = self.config.optics, self.config.sensor
        zooms = [1.0, *np.linspace(optics.zoom_min, optics.zoom_max, 9).tolist()]
        plates = [finest_plate(rig, sensor, zoom) for rig in self.rigs for zoom in zooms]
        largest = max(width for width, _ in plates), max(height for _, height in plates)
        if max(largest) > LARGEST_PICTURE_PX:
            raise PzcapError(
                f"pictures of {largest[0]} x {largest[1]} px would be rendered, and {LARGEST_PICTURE_PX} is the most; "
                "give a smaller shoot.width, shoot.height or supersampling"
            )
        return Stage(self.model_spec(), *largest, GEOM_GROUP, gym.OBJECT_GROUP, mipmaps=sensor.mipmaps)

    def clock(self) -> Clock:
        rng = stream(self.config.seed, "clock")
        day = frames_per_day(Fraction(self.config.frame_rate))
        start = int(rng.integers(day // 3, day // 2))
        clock = Clock(start, *rolls(self.config.cameras, self.config.sensor.largest_roll, rng))
        return clock if self.config.crew.sync == "timecode" else clock._replace(start=clock.early[0])

    def timecodes(self) -> tuple[str, ...]:
        """(F,) of the frames of the motion."""
        start, rate = self.clock().start, Fraction(self.config.frame_rate)
        return tuple(frames_to_timecode(start + f, rate) for f in range(len(self.times_s)))

    def flash(self, time_s: float) -> float:
        """Brightness of the hall by the lamp that marks a time for all cameras, 1 where it is not lit."""
        lit = self.config.crew.sync == "flash" and _SIGNAL_S <= time_s < _SIGNAL_S + _LIT_S
        return _FLASH if lit else 1.0

    def sound(self, c: int) -> NDArray[np.float32] | None:
        """(N,) samples of the sound that camera ``c`` records with the motion; None: it records none."""
        if self.config.crew.sync != "sound":
            return None
        seed, exposed_s = self.config.seed, self.exposed_s(c)
        rng = stream(seed, "sound")
        events = [
            (_SIGNAL_S + at_s, np.array([*rng.uniform(-0.5, 0.5, 2), 1.2]), sound.clap(rng))
            for at_s in (0.0, 0.31, 0.74)
        ]
        for at_s in self.clip.landings_s:
            events.append((float(at_s), self.clip.at(float(at_s)).root_position_m, 0.2 * sound.clap(rng, softness=5.0)))
        fan = rng.normal(size=round((12.0 + float(exposed_s[-1])) * sound.SAMPLES_PER_S))
        microphone_m = self.rigs[c].world_T_cam(0.0, self.rigs[c].reference_focal_px)[:3, 3]
        rate = 1.0 + float(self.own_clocks()[1][c])
        duration_s, own = len(exposed_s) / self.config.frame_rate, stream(seed, "microphone", c)
        fan_m = np.array([9.0, -6.0, 4.0])
        return sound.recorded(events, fan_m, fan, microphone_m, float(exposed_s[0]), rate, duration_s, own)

    def exposed_s(self, c: int) -> Array:
        """(N,) the middle of each exposure of the motion by camera ``c``; 0 at the first frame that all have."""
        clock = self.clock()
        frames = np.arange(clock.early[c] + len(self.times_s) + clock.late[c])
        return self.own_s(c, (frames - clock.early[c]) / self.config.frame_rate)

    def own_s(self, c: int, times_s: Array) -> Array:
        """(N,) when camera ``c`` exposes what its timecode says is of ``times_s`` (N,)."""
        offset_s, drift = (each[c] for each in self.own_clocks())
        return np.asarray(times_s + offset_s + drift * times_s)

    def own_clocks(self) -> tuple[Array, Array]:
        """Offset (C,), s, and drift (C,) of the cameras' clocks; 0 where they are genlocked."""
        sensor, period_s = self.config.sensor, 1 / self.config.frame_rate
        offset_s, drift = draw_clocks(self.config.cameras, sensor, period_s, stream(self.config.seed, "own clocks"))
        return offset_s if self.config.crew.sync == "timecode" else nearest_frames(offset_s, period_s), drift

    def mains(self, c: int, purpose: str) -> Mains | None:
        """Flicker of the hall's lamps in what camera ``c`` films for some purpose; None: they burn steadily."""
        gym, seed = self.config.gym, self.config.seed
        if not gym.mains_share:
            return None
        # all film the motion at one time, and the hall each at its own
        taken = stream(seed, "mains", purpose, *([] if purpose == "motion video" else [c]))
        sensor = self.config.sensor
        open_s = sensor.shutter_s if purpose == "motion video" else sensor.hall_shutter_s or sensor.shutter_s
        return draw_mains(gym, open_s, taken, stream(seed, "lamps", c))

    def unrest(self, c: int) -> Unrest | None:
        """Motion of the tripod of camera ``c`` while the athlete's is recorded; None: it stands still."""
        optics, seed = self.config.optics, self.config.seed
        if not (optics.settled_deg or optics.sprung_deg or optics.bump_deg):
            return None
        landings_s = self.clip.landings_s
        bumped = stream(seed, "bump")
        hit, when, towards = bumped.integers(self.config.cameras), bumped.uniform(0.3, 0.7), bumped.normal(size=3)
        towards *= np.deg2rad(optics.bump_deg) * (hit == c) / np.linalg.norm(towards)
        return Unrest(
            settled_rad=float(np.deg2rad(optics.settled_deg) * stream(seed, "settled", c).choice([-1.0, 1.0])),
            landings_s=landings_s,
            rings_rad=np.deg2rad(optics.sprung_deg)
            * stream(seed, "sprung", c).choice([-1.0, 1.0], (len(landings_s), 2)),
            ring_hz=optics.sprung_hz,
            bump_s=float(when * self.times_s[-1]),
            bump_rad=towards,
        )

    def sweep(self, c: int) -> Run:
        """Way of camera ``c`` through the sweep."""
        operator, seed = self.config.operator, self.config.seed
        pan_rad = sweep(self.config.sweep_deg, operator, stream(seed, "sweep", c))
        if operator.sweep_uneven or operator.sweep_stop_frames or operator.sweep_back_frames:
            pan_rad = faltering(pan_rad, operator, stream(seed, "faltering", c))
        return self._run(pan_rad, np.full(len(pan_rad), self.rigs[c].reference_focal_px * operator.sweep_zoom))

    def zoom(self, c: int) -> Run:
        """Way of camera ``c`` through the zoom run, which may have no frame."""
        optics, frames = self.config.optics, self.config.zoom_frames
        low, high = (math.log(self.rigs[c].reference_focal_px * zoom) for zoom in (optics.zoom_min, optics.zoom_max))
        locked_rad = np.deg2rad(stream(self.config.seed, "zoom run", c).uniform(-5.0, 5.0))
        return self._run(np.full(frames, locked_rad), np.exp(np.linspace(low, high, frames)))

    def _run(self, pan_rad: Array, focal_px: Array) -> Run:
        times_s = np.arange(len(pan_rad)) / self.config.sweep_frame_rate
        return Run(times_s, through(times_s, pan_rad, focal_px) if len(times_s) else None)

    def walker(self) -> Person | None:
        """The person who walks through the hall during the sweeps, if anyone does."""
        if not self.config.crew.walks_in_sweep:
            return None
        somebody = motion.make("pedestrian", self.measurements, stream(self.config.seed, "walker"))
        return to_and_fro(somebody, stream(self.config.seed, "walker's way"))

    def others(self) -> list[Person]:
        """People besides the athlete whom a detector finds in the motion."""
        found = []
        for number in range(self.config.detector.others):
            somebody = motion.make("pedestrian", self.measurements, stream(self.config.seed, "somebody", number))
            found.append(to_and_fro(somebody, stream(self.config.seed, "somebody's way", number)))
        return found

    def files(self, folder: Path) -> list[Files]:
        """The files of each camera in ``folder``."""
        files = []
        for name in self.config.camera_names:
            place = folder / f"camera{name}"
            zoom = place / "zoom.mp4" if self.config.zoom_frames else None
            keypoints = place / "keypoints" if self.config.detector.enabled else None
            reference = place / "reference.png" if self.config.crew.calibration_object else None
            found = Files(name, reference, place / "sweep.mp4", zoom, place / "motion.mp4", keypoints)
            files.append(found)
        return files


def assemble(config: ShootConfig) -> Session:
    """Draw from the seed all that chance decides about athlete, motion and tripods."""
    content, file = b"", motion.file_of(config.motion)
    if file is not None and file.is_file():  # else what reads it says so
        content = file.read_bytes()
    measurements, clip = _draw_motion(config.seed, config.motion, content)
    rigs = [
        build_rig(c, config.width, config.height, config.optics, stream(config.seed, "rig", c))
        for c in range(config.cameras)
    ]
    frames = round(clip.duration_s * config.frame_rate) + 1
    times_s = np.arange(min(frames, config.motion_frames or frames)) / config.frame_rate
    given = config.operator.trajectories
    named = dict(zip(config.camera_names, rigs, strict=True))
    given_trajectories = read_trajectories(Path(given), named, config.frame_rate, float(times_s[-1])) if given else []
    return Session(config, dict(measurements), clip, rigs, times_s, given_trajectories)


@lru_cache(maxsize=4)
def _draw_motion(seed: int, name: str, content: bytes) -> tuple[dict[str, float], MotionClip]:
    """Athlete and motion, which take seconds to fit and are the same for the light and all that is developed from it.
    ``content`` is that of a BVH file: with another it is another motion."""
    del content
    measurements = draw_measurements(stream(seed, "measurements"))
    return measurements, motion.make(name, measurements, stream(seed, "motion"))
