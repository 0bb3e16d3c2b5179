"""What is set up before anything is filmed: the hall, the athlete, the cameras, all drawn from one configuration."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from pzcap.types import Array, PzcapError
from sim import motion
from sim.cameras.film import FilmCamera, finest_plate
from sim.cameras.operator import Hands, OperatorConfig
from sim.cameras.optics import OpticsConfig, Rig, build_rig
from sim.cameras.render import Stage
from sim.cameras.sensor import SensorConfig
from sim.cameras.trajectories import read_hands
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
    motion: str = "floor_exercise"
    """A module of sim.motion, or a BVH file."""
    motion_frames: int = 0
    """Film only so many from the start; 0: the whole motion."""
    width: int = 640
    height: int = 480
    frame_rate: int = 30
    """Of the motion."""
    sweep_deg: float = 360.0
    """360: a full turn, and past its own start; less: centred on the reference pose."""
    sweep_frame_rate: int = 5
    zoom_frames: int = 22
    """0: no zoom run."""
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
    """What one camera records; as `pzcap.types.CameraFiles`."""

    name: str
    reference: Path
    sweep: Path
    zoom: Path | None
    motion: Path
    keypoints: Path | None


@dataclass(frozen=True, slots=True, eq=False)
class Crew:
    """Four cameras in the hall, and what is to be filmed."""

    config: ShootConfig
    measurements: dict[str, float]
    clip: MotionClip
    stage: Stage
    rigs: list[Rig]
    cameras: list[FilmCamera]
    files: list[Files]
    times_s: Array  # (F,) of the frames of the motion
    given_hands: list[Hands]  # what the cameras do, if a file says it; empty: operators follow the body


def assemble(config: ShootConfig, folder: Path) -> Crew:
    """Draw all that chance decides from the seed, build the hall, and make a folder in ``folder`` for each camera."""
    measurements = draw_measurements(config.athlete, stream(config.seed, "measurements"))
    clip = motion.make(config.motion, measurements, stream(config.seed, "motion"))
    rigs = [
        build_rig(c, config.width, config.height, config.optics, stream(config.seed, "rig", c)) for c in range(CAMERAS)
    ]
    frames = round(clip.duration_s * config.frame_rate) + 1
    times_s = np.arange(min(frames, config.motion_frames or frames)) / config.frame_rate
    given = config.operator.trajectories
    named = {str(c + 1): rig for c, rig in enumerate(rigs)}
    given_hands = read_hands(Path(given), named, config.frame_rate, float(times_s[-1])) if given else []
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
    return Crew(config, measurements, clip, stage, rigs, cameras, files, times_s, given_hands)
