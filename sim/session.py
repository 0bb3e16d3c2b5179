"""A filming session: hall, athlete, motion and four cameras, set up from one configuration."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from pzcap.types import Array, PzcapError
from sim import motion
from sim.cameras.film import FilmCamera, finest_plate
from sim.cameras.operator import OperatorConfig, Trajectory
from sim.cameras.optics import OpticsConfig, Rig, build_rig
from sim.cameras.render import Stage
from sim.cameras.sensor import SensorConfig
from sim.cameras.trajectories import read_trajectories
from sim.hall.gym import GymConfig
from sim.motion import MotionClip
from sim.people.athlete import AthleteConfig, draw_measurements
from sim.people.crew import CrewConfig
from sim.people.detector import DetectorConfig
from sim.scene import build_stage, stream

CAMERAS: Final = 4


@dataclass(frozen=True, slots=True)
class ShootConfig:
    """All that decides what a capture looks like. The same config, and files that it names, give the same bytes."""

    seed: int = 0
    """Seed of all that chance decides: athlete, motion, tripods, hands, noise. Any integer from 0."""
    motion: str = "floor_exercise"
    """Motion of the athlete: a module of sim.motion, or a BVH file. Tumbling is what the method has to follow."""
    motion_frames: int = 0
    """Frames of the motion to film, from its start; 0: all."""
    width: int = 640
    """Image width, px."""
    height: int = 480
    """Image height, px. At 640 x 480 a capture is filmed in minutes."""
    frame_rate: int = 30
    """Frames a second of the motion video."""
    sweep_deg: float = 360.0
    """Range of the pan sweep, degrees. 360: a full turn and on past its own start, so that the circle closes; less:
    centred on the reference pose."""
    sweep_frame_rate: int = 5
    """Frames a second of the sweep and the zoom run: a slow pan of ten degrees a second."""
    zoom_frames: int = 22
    """Frames of the zoom run, from the widest to the longest focal length; 0: no zoom run."""
    gym: GymConfig = field(default_factory=GymConfig)
    athlete: AthleteConfig = field(default_factory=AthleteConfig)
    operator: OperatorConfig = field(default_factory=OperatorConfig)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    crew: CrewConfig = field(default_factory=CrewConfig)
    detector: DetectorConfig = field(default_factory=DetectorConfig)

    def __post_init__(self) -> None:
        if self.zoom_frames < 0 or self.zoom_frames == 1:
            raise PzcapError(f"zoom_frames is {self.zoom_frames}; give 2 or more, or 0 for no zoom run")


class Files(NamedTuple):
    """Files that one camera records; as `pzcap.types.CameraFiles`."""

    name: str
    reference: Path
    sweep: Path
    zoom: Path | None
    motion: Path
    keypoints: Path | None


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """Four cameras in the hall, and the motion to film."""

    config: ShootConfig
    measurements: dict[str, float]
    clip: MotionClip
    stage: Stage
    rigs: list[Rig]
    cameras: list[FilmCamera]
    files: list[Files]
    times_s: Array  # (F,) of the frames of the motion
    given_trajectories: list[Trajectory]  # from a file; empty: operators follow the body


def assemble(config: ShootConfig, folder: Path) -> Session:
    """Draw from the seed all that chance decides, build the hall, and make a folder in ``folder`` for each camera."""
    measurements = draw_measurements(config.athlete, stream(config.seed, "measurements"))
    clip = motion.make(config.motion, measurements, stream(config.seed, "motion"))
    rigs = [
        build_rig(c, config.width, config.height, config.optics, stream(config.seed, "rig", c)) for c in range(CAMERAS)
    ]
    frames = round(clip.duration_s * config.frame_rate) + 1
    times_s = np.arange(min(frames, config.motion_frames or frames)) / config.frame_rate
    given = config.operator.trajectories
    named = {str(c + 1): rig for c, rig in enumerate(rigs)}
    given_trajectories = read_trajectories(Path(given), named, config.frame_rate, float(times_s[-1])) if given else []
    zooms = [1.0, *np.linspace(config.optics.zoom_min, config.optics.zoom_max, 9).tolist()]
    plates = [finest_plate(rig, config.sensor, zoom) for rig in rigs for zoom in zooms]
    largest = max(width for width, _ in plates), max(height for _, height in plates)
    stage = build_stage(config.seed, config.gym, config.athlete, measurements, largest, mipmaps=config.sensor.mipmaps)
    cameras, files = [], []
    for c, (name, rig) in enumerate(named.items()):
        cameras.append(FilmCamera(stage, rig, config.sensor, stream(config.seed, "sensor", c)))
        place = folder / f"camera{name}"
        place.mkdir(parents=True)
        zoom = place / "zoom.mp4" if config.zoom_frames else None
        keypoints = place / "keypoints" if config.detector.enabled else None
        files.append(Files(name, place / "reference.png", place / "sweep.mp4", zoom, place / "motion.mp4", keypoints))
    return Session(config, measurements, clip, stage, rigs, cameras, files, times_s, given_trajectories)
