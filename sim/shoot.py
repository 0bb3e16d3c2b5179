"""Scene and operators to footage: what a crew brings home in ``capture/``, what the simulator knows in ``truth/``."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import shutil
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.capture import write_capture
from pzcap.types import Array, CameraFiles, Capture, Image, Mask, PzcapError
from pzcap.video import frames_per_day, frames_to_timecode
from sim import gym, motion
from sim.athlete import AthleteConfig, draw_measurements
from sim.crew import CrewConfig, keyframe_indices, measure, pose_by_hand, to_and_fro
from sim.detector import Detector, DetectorConfig, write_openpose
from sim.film import FilmCamera, finest_plate
from sim.furniture import REARRANGED
from sim.gym import GymConfig
from sim.motion import END_POINTS, MotionClip
from sim.operator import Hands, OperatorConfig, follow, sweep, sweep_length, swinging, through, tilting, zooming
from sim.optics import OpticsConfig, Rig, build_rig
from sim.render import Stage, check_gl
from sim.scene import build_stage, scene_points, skeleton, stream
from sim.sensor import SensorConfig, draw_dropped, rolls
from sim.trajectories import read_hands
from sim.truth import Truth, save
from sim.wallpaper import wall_pictures

VERSION: Final = 4
"""Of the simulator. Raise it with every change to a default or to what comes of one, so that cached captures are shot
again."""

_CAMERAS: Final = 4
_COMPLETE: Final = "complete"  # stands in a cached folder when its shoot has come to the end
_SHADOW_EVERY: Final = 10  # frames
_SCENE_POINTS: Final = 600  # rays cast for each camera


@dataclass(frozen=True, slots=True)
class ShootConfig:
    """All that decides what a capture looks like. The same config, and files that it names, give the same bytes."""

    seed: int = 0
    motion: str = "floor_exercise"  # a module of sim.motion, or a BVH file
    motion_frames: int = 0  # film only so many from the start; 0: the whole motion
    width: int = 640
    height: int = 480
    frame_rate: int = 30  # of the motion
    sweep_deg: float = 360.0  # 360: a full turn, and past its own start; less: centred on the reference pose
    sweep_frame_rate: int = 5
    zoom_frames: int = 22  # 0: no zoom run
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


class _Files(NamedTuple):
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
    files: list[_Files]
    times_s: Array  # (F,) of the frames of the motion
    given_hands: list[Hands]  # what the cameras do, if a file says it; empty: operators follow the body


@dataclass(frozen=True, slots=True, eq=False)
class _Filmed:
    """What is known about the motion once it is filmed. As in `sim.truth.Truth`."""

    times_s: Array
    timecodes: tuple[str, ...]
    joints_m: Array
    hands: list[Hands]
    recorded: Mask
    mask_bits: NDArray[np.uint8]
    shadow_frames: NDArray[np.int64]
    shadow_bits: NDArray[np.uint8]


class Progress(NamedTuple):
    stage: str
    done: int
    total: int


def shoot_cached(config: ShootConfig, root: Path) -> Generator[Progress, None, Path]:
    """Shoot into a folder of ``root`` named by a hash of config and files, or find it there; return the folder.

    A shoot that was killed leaves only a temporary folder behind, which is never used.
    Raises PzcapError if the disk is full, GL is missing, the motion is unknown, or a file cannot be used.
    """
    departures = _departures(asdict(config), asdict(ShootConfig()))
    canonical = json.dumps([VERSION, departures, *file_hashes(config)], sort_keys=True)
    name = f"{motion.title(config.motion)}-{config.seed}-{hashlib.sha256(canonical.encode()).hexdigest()[:12]}"
    folder = root / name
    if (folder / _COMPLETE).is_file():
        return folder
    root.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=root))
    try:
        yield from shoot(config, temporary)
        (temporary / _COMPLETE).touch()
        temporary.chmod(0o755)  # mkdtemp's folders are private
        if not (folder / _COMPLETE).is_file():  # else another process was faster
            shutil.rmtree(folder, ignore_errors=True)
            temporary.replace(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def _departures(values: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    """What of ``values`` is not as by default: a new effect that is off by default leaves cached captures valid."""
    return {
        key: _departures(value, defaults[key]) if isinstance(value, dict) else value
        for key, value in values.items()
        if value != defaults[key]
    }


def file_hashes(config: ShootConfig) -> list[str]:
    """Of the user's own files that a capture is made of, names and contents: changed, they make another capture.

    Raises PzcapError if one cannot be read.
    """
    acted = motion.file_of(config.motion)
    driven = Path(config.operator.trajectories) if config.operator.trajectories else None
    paths = [path for path in (acted, driven, *wall_pictures(config.gym.wall_pictures).values()) if path]
    try:
        return [f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in paths]
    except OSError as error:
        raise PzcapError(f"{error.filename}: cannot be read: {error.strerror}") from error


def shoot(config: ShootConfig, folder: Path) -> Iterator[Progress]:
    """Write ``folder/capture`` and ``folder/truth``, telling how far it is."""
    check_gl()
    try:
        yield from _shoot(config, folder)
    except OSError as error:
        reason = "the disk is full; free some space" if error.errno == errno.ENOSPC else error.strerror
        raise PzcapError(f"{folder}: cannot write the capture: {reason}") from error


def _shoot(config: ShootConfig, folder: Path) -> Iterator[Progress]:
    yield Progress("build", 0, 1)
    crew = assemble(config, folder / "capture")
    yield Progress("build", 1, 1)
    try:
        hall = yield from _film_hall(crew)
        filmed = yield from _film_motion(crew)
        yield Progress("write", 0, 1)
        _write_papers(crew, folder / "capture", filmed)
        save(_truth(crew, hall, filmed), folder / "truth")
        yield Progress("write", 1, 1)
    finally:
        crew.stage.close()


def assemble(config: ShootConfig, folder: Path) -> Crew:
    measurements = draw_measurements(config.athlete, stream(config.seed, "measurements"))
    clip = motion.make(config.motion, measurements, stream(config.seed, "motion"))
    rigs = [
        build_rig(c, config.width, config.height, config.optics, stream(config.seed, "rig", c)) for c in range(_CAMERAS)
    ]
    frames = round(clip.duration_s * config.frame_rate) + 1
    times_s = np.arange(min(frames, config.motion_frames or frames)) / config.frame_rate
    given = config.operator.trajectories
    named = {str(c + 1): rig for c, rig in enumerate(rigs)}
    given_hands = read_hands(Path(given), named, config.frame_rate, float(times_s[-1])) if given else []
    zooms = [1.0, *np.linspace(config.optics.zoom_min, config.optics.zoom_max, 9).tolist()]
    plates = [finest_plate(rig, config.sensor, zoom) for rig in rigs for zoom in zooms]
    largest = max(width for width, _ in plates), max(height for _, height in plates)
    stage = build_stage(config.seed, config.gym, config.athlete, measurements, largest)
    cameras, files = [], []
    for c, (name, rig) in enumerate(named.items()):
        cameras.append(FilmCamera(stage, rig, config.sensor, stream(config.seed, "sensor", c)))
        place = folder / f"camera{name}"
        place.mkdir(parents=True)
        zoom = place / "zoom.mp4" if config.zoom_frames else None
        keypoints = place / "keypoints" if config.detector.enabled else None
        files.append(_Files(name, place / "reference.png", place / "sweep.mp4", zoom, place / "motion.mp4", keypoints))
    return Crew(config, measurements, clip, stage, rigs, cameras, files, times_s, given_hands)


def _film_hall(crew: Crew) -> Generator[Progress, None, dict[str, list[Hands]]]:
    """Reference image, sweep and zoom run of each camera; return the hands of each "sweep" and "zoom" run."""
    config, sensor = crew.config, crew.config.sensor
    focal_px = crew.rigs[0].reference_focal_px
    low, high = (math.log(focal_px * zoom) for zoom in (config.optics.zoom_min, config.optics.zoom_max))
    hands: dict[str, list[Hands]] = {"sweep": [], "zoom": []}
    walker = None
    if config.crew.walks_in_sweep:
        somebody = motion.make("pedestrian", crew.measurements, stream(config.seed, "walker"))
        walker = to_and_fro(somebody, stream(config.seed, "walker's way"))
    for c, (camera, files) in enumerate(zip(crew.cameras, crew.files, strict=True)):
        _write_png(files.reference, camera.still(stream(config.seed, "reference", c)))
        pan_rad = sweep(config.sweep_deg, config.operator, stream(config.seed, "sweep", c))
        locked_rad = np.deg2rad(stream(config.seed, "zoom run", c).uniform(-5.0, 5.0))
        runs = {
            "sweep": (pan_rad, np.full(len(pan_rad), focal_px)),
            "zoom": (np.full(config.zoom_frames, locked_rad), np.exp(np.linspace(low, high, config.zoom_frames))),
        }
        for kind, run in runs.items():
            count = len(run[0])
            if not count:
                continue
            times_s = np.arange(count) / config.sweep_frame_rate
            hand = through(times_s, *run)
            hands[kind].append(hand)
            exposing = camera.record(
                getattr(files, kind), hand.at, times_s, person=walker if kind == "sweep" else None,
                frame_rate=Fraction(config.sweep_frame_rate), crf=sensor.crf_still, sub_exposures=1,
                rng=stream(config.seed, kind, c),
            )  # fmt: skip
            for k in exposing:
                yield Progress(f"{kind} {files.name}", k + 1, count)
    return hands


def _film_motion(crew: Crew) -> Generator[Progress, None, _Filmed]:
    """The motion, camera by camera, and its masks."""
    config, sensor, seed = crew.config, crew.config.sensor, crew.config.seed
    rate = Fraction(config.frame_rate)
    times_s, frames = crew.times_s, len(crew.times_s)
    joints_m, outline_m = skeleton(crew.stage, crew.clip, times_s, crew.measurements)
    hands = crew.given_hands or [_operate(crew, c, times_s, outline_m) for c in range(_CAMERAS)]
    if config.gym.rearranged:
        for piece, by_m in REARRANGED.items():
            crew.stage.carry(piece, by_m)
    clock = stream(seed, "clock")
    start = int(clock.integers(frames_per_day(rate) // 3, frames_per_day(rate) // 2))
    early, late = rolls(_CAMERAS, sensor.largest_roll, clock)

    shadow_frames = np.arange(0, frames, _SHADOW_EVERY)
    packed = -(-config.width * config.height // 8)
    mask_bits = np.zeros((_CAMERAS, frames, packed), np.uint8)
    shadow_bits = np.zeros((_CAMERAS, len(shadow_frames), packed), np.uint8)
    recorded = np.ones((_CAMERAS, frames), bool)
    detector = Detector(crew.stage, crew.measurements, config.detector, stream(seed, "detector"))
    for c, (camera, files) in enumerate(zip(crew.cameras, crew.files, strict=True)):
        dropped = draw_dropped(early[c] + frames + late[c], sensor.dropped_share, stream(seed, "dropped", c))
        recorded[c] = ~dropped[early[c] : early[c] + frames]
        indices = np.flatnonzero(~dropped)
        exposed_s = (indices - early[c]) / config.frame_rate
        exposing = camera.record(
            files.motion, hands[c].at, exposed_s, person=crew.clip.at,
            light=config.gym.lights_on, frame_rate=rate, crf=sensor.crf_motion, sub_exposures=sensor.sub_exposures,
            rng=stream(seed, "motion video", c), timecode=frames_to_timecode(start - early[c], rate),
            indices=indices.tolist(),
        )  # fmt: skip
        for k in exposing:
            yield Progress(f"motion {files.name}", k + 1, len(indices))
        if files.keypoints is not None:
            rng = stream(seed, "detector", c)
            found = detector.watch(crew.rigs[c], hands[c], crew.clip.at, exposed_s, sensor.shutter_s, rng)
            write_openpose(files.keypoints, files.motion.stem, found)
        for f, time_s in enumerate(times_s.tolist()):
            mask = camera.mask(hands[c].at, time_s, crew.clip.at)
            mask_bits[c, f] = np.packbits(mask)
            if f % _SHADOW_EVERY == 0:
                shadow_bits[c, f // _SHADOW_EVERY] = np.packbits(camera.shadow(hands[c].at, time_s, crew.clip.at, mask))
            yield Progress(f"masks {files.name}", f + 1, frames)
    timecodes = tuple(frames_to_timecode(start + f, rate) for f in range(frames))
    return _Filmed(times_s, timecodes, joints_m, hands, recorded, mask_bits, shadow_frames, shadow_bits)


def _operate(crew: Crew, c: int, times_s: Array, outline_m: Array) -> Hands:
    """What the hands of camera ``c``'s operator do while the motion is recorded."""
    seed, rig, config = crew.config.seed, crew.rigs[c], crew.config.operator
    hands = follow(rig, times_s, outline_m, config, stream(seed, "operator", c))
    if config.swing_deg_s > 0:
        hands = swinging(hands, config, stream(seed, "swing", c))
    if config.zoom_swing_s > 0:
        hands = zooming(hands, rig, config, stream(seed, "zoom swing", c))
    if config.tilts:
        hands = tilting(hands, rig, times_s, outline_m, config, stream(seed, "tilt", c))
    return hands


def _write_papers(crew: Crew, folder: Path, filmed: _Filmed) -> None:
    """What the crew writes down: the object, the tape's readings, the keyframes."""
    config = crew.config
    hand = stream(config.seed, "keyframes")
    keyframes = {
        filmed.timecodes[f]: pose_by_hand(crew.clip.at(filmed.times_s[f]), config.crew, hand)
        for f in keyframe_indices(len(filmed.times_s), config.frame_rate, config.crew)
    }
    write_capture(
        Capture(
            folder=folder,
            name=f"{motion.title(config.motion)}, seed {config.seed}",
            frame_rate=Fraction(config.frame_rate),
            cameras=tuple(CameraFiles(*files) for files in crew.files),
            calibration_object=gym.calibration_object(),
            subject=measure(crew.measurements, config.crew, stream(config.seed, "tape")),
            keyframe_poses=keyframes,
            full_turn=config.sweep_deg >= 360.0,
        )
    )


def _truth(crew: Crew, hall: dict[str, list[Hands]], filmed: _Filmed) -> Truth:
    config, rigs = crew.config, crew.rigs
    pan_rad, focal_px, raised_rad = _sampled(filmed.hands, filmed.times_s)
    frames = len(filmed.times_s)
    sweep_times_s = np.arange(sweep_length(config.sweep_deg, config.operator)) / config.sweep_frame_rate
    zoom_times_s = np.arange(config.zoom_frames) / config.sweep_frame_rate
    sweep_pan_rad = _sampled(hall["sweep"], sweep_times_s)[0]
    zoom_pan_rad, zoom_focal_px = np.zeros((_CAMERAS, 1)), np.zeros((_CAMERAS, 0))
    if config.zoom_frames:
        zoom_pan_rad, zoom_focal_px, _ = _sampled(hall["zoom"], zoom_times_s)
    reference_px = rigs[0].reference_focal_px
    points = [
        scene_points(crew.stage, rig, sweep_pan_rad[c], _SCENE_POINTS, stream(config.seed, "points", c))
        for c, rig in enumerate(rigs)
    ]
    fewest = min(len(group) for group in points)
    poses = [crew.clip.at(t) for t in filmed.times_s.tolist()]
    contact = [[crew.clip.contacts(t)[end] for end in END_POINTS] for t in filmed.times_s.tolist()]
    return Truth(
        config=json.dumps(asdict(config)),
        frame_rate=Fraction(config.frame_rate),
        camera_names=tuple(files.name for files in crew.files),
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
        reference_focal_px=np.full(_CAMERAS, reference_px),
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
        measurements_m=crew.measurements,
        root_position_m=np.stack([pose.root_position_m for pose in poses]),
        rotations=np.stack([pose.rotations for pose in poses]),
        joints_m=filmed.joints_m,
        contact=np.array(contact),
        airborne=np.array([not any(row) for row in contact]),
        mask_bits=filmed.mask_bits,
        shadow_frames=filmed.shadow_frames,
        shadow_bits=filmed.shadow_bits,
    )


def _sampled(hands: list[Hands], times_s: Array) -> tuple[Array, Array, Array]:
    """Pan, focal length and tilt above the locked one, (C, N) each, at these times."""
    values = np.array([[hand.at(t) for t in times_s.tolist()] for hand in hands])
    return values[..., 0], values[..., 1], values[..., 2]


def _poses(rigs: list[Rig], *aims: Array) -> Array:
    """(C, N, 4, 4) for pan, focal length and tilt (C, N) each."""
    return np.array(
        [[rig.world_T_cam(*aim) for aim in zip(*row, strict=True)] for rig, *row in zip(rigs, *aims, strict=True)]
    )


def _write_png(path: Path, image: Image) -> None:
    encoded, data = cv2.imencode(".png", image)
    assert encoded
    path.write_bytes(data.tobytes())
