"""Light: what passes the lenses, before sensors and recorders make it a capture (`sim.develop`).

It depends on the hall, the athlete and the cameras' ways, but on no noise, exposure, compression or lost frame: a study
of those films each hall and motion once.
"""

from __future__ import annotations

import errno
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Final, NamedTuple

import av
import numpy as np
from av import VideoFrame
from numpy.typing import NDArray

from pzcap.types import Array, Image, PzcapError
from sim.cameras.film import FilmCamera, Person
from sim.cameras.operator import Trajectory, follow, swinging, tilting, zooming
from sim.cameras.optics import OpticsConfig
from sim.cameras.render import check_gl
from sim.cameras.sensor import SensorConfig
from sim.collect_truth import FilmedCamera, collect_truth
from sim.hall.furniture import REARRANGED
from sim.hall.gym import GymConfig
from sim.people.crew import CrewConfig
from sim.people.detector import DetectorConfig
from sim.scene import scene_points, skeleton, stream
from sim.session import Session, ShootConfig, assemble
from sim.team import Progress, side_by_side
from sim.truth import save

_SHADOW_EVERY: Final = 10  # frames
_SCENE_POINTS: Final = 600  # rays cast for each camera
_LOSSLESS: Final = "magicyuv"  # a third of the time of lossless H.264, to write and to read, and no larger


class Reel(NamedTuple):
    """Videos of light of one camera."""

    reference: Path
    sweep: Path
    zoom: Path
    motion: Path  # every frame, those that the camera starts early and stops late included


def reels(folder: Path, config: ShootConfig) -> list[Reel]:
    """The videos of light of each camera in ``folder``."""
    return [Reel(*(folder / f"camera{name}" / f"{part}.avi" for part in Reel._fields)) for name in config.camera_names]


def light_of(config: ShootConfig) -> ShootConfig:
    """The config with all that light does not depend on as by default: shoots with equal ones share their light."""
    sensor, default = config.sensor, SensorConfig()
    return replace(
        config,
        gym=replace(
            config.gym,
            lights_on=GymConfig().lights_on,
            mains_share=GymConfig().mains_share,
            mains_hz=GymConfig().mains_hz,
            mains_phases=GymConfig().mains_phases,
        ),
        optics=replace(config.optics, vignetting=OpticsConfig().vignetting),
        sensor=replace(
            sensor,
            read_noise=default.read_noise,
            shot_noise=default.shot_noise,
            exposure_drift=default.exposure_drift,
            auto_exposure=default.auto_exposure,
            white_drift=default.white_drift,
            crf_motion=default.crf_motion,
            crf_still=default.crf_still,
            dropped_share=default.dropped_share,
        ),
        crew=CrewConfig(
            walks_in_sweep=config.crew.walks_in_sweep,
            company=config.crew.company,
            coach_m=config.crew.coach_m,
            sync="none" if sensor.clock_offset and config.crew.sync != "timecode" else "timecode",
        ),
        detector=DetectorConfig(),
    )


def film(config: ShootConfig, folder: Path) -> Iterator[Progress]:
    """Write the light of ``config`` to ``folder``, and the truth to ``folder/truth``; yield the progress.

    Raises PzcapError if GL is missing, the disk is full, or a file that the config names cannot be used.
    """
    check_gl()
    yield Progress("build", 0, 1)
    session = assemble(config)
    for reel in reels(folder, config):
        reel.reference.parent.mkdir(parents=True)
    yield Progress("build", 1, 1)
    frames = len(session.times_s)
    lengths = [(session.sweep(c).times_s, session.zoom(c).times_s, session.exposed_s(c)) for c in range(config.cameras)]
    total = config.cameras * (1 + frames) + sum(len(times_s) for camera in lengths for times_s in camera)
    groups = yield from side_by_side("film", config.cameras, total, film_cameras, session, folder)
    shadow_frames = np.arange(0, frames, _SHADOW_EVERY)
    filmed = [camera for cameras, _ in groups for camera in cameras]
    save(collect_truth(session, filmed, groups[0][1], shadow_frames), folder / "truth")


def operate(session: Session, c: int, outline_m: Array) -> Trajectory:
    """The way of camera ``c`` while the motion is recorded, with its tripod's unrest. outline_m: (F, 21, 3)."""
    return replace(_operated(session, c, outline_m), unrest=session.unrest(c))


def _operated(session: Session, c: int, outline_m: Array) -> Trajectory:
    """Way of the camera by the operator, who follows the body."""
    if session.given_trajectories:
        return session.given_trajectories[c]
    seed, rig, config, times_s = session.config.seed, session.rigs[c], session.config.operator, session.times_s
    trajectory = follow(rig, times_s, outline_m, config, stream(seed, "operator", c))
    if config.swing_deg_s > 0:
        trajectory = swinging(trajectory, config, stream(seed, "swing", c))
    if config.zoom_swing_s > 0:
        trajectory = zooming(trajectory, rig, config, stream(seed, "zoom swing", c))
    if config.tilts:
        trajectory = tilting(trajectory, rig, times_s, outline_m, config, stream(seed, "tilt", c))
    return trajectory


def film_cameras(
    cameras: Sequence[int], session: Session, folder: Path
) -> Generator[int, None, tuple[list[FilmedCamera], Array]]:
    """Film some of the cameras; yield how many pictures are done. Return what they saw, and the joints (F, 16, 3)."""
    config, stage = session.config, session.stage()
    try:
        filming = {c: FilmCamera(stage, session.rigs[c], config.sensor) for c in cameras}
        walker, done = session.walker(), count(1)
        for c, camera in filming.items():
            yield from _film_hall(session, c, camera, walker, reels(folder, config)[c], done)
        if config.gym.rearranged:
            for piece, by_m in REARRANGED.items():
                stage.carry(piece, by_m)
        joints_m, outline_m = skeleton(stage.model, session.clip, session.times_s, session.measurements)
        session.accompany(stage)
        filmed = []
        for c, camera in filming.items():
            way = operate(session, c, outline_m)
            lights = (camera.exposure(way.at, t, session.clip.at) for t in session.exposed_s(c).tolist())
            yield from _write(reels(folder, config)[c].motion, lights, done)
            masks, shadows = yield from _silhouettes(session, c, way, camera, done)
            swept = session.sweep(c)
            pan_rad = np.array([swept.at(t).pan_rad for t in swept.times_s.tolist()])
            seen = scene_points(stage, session.rigs[c], pan_rad, _SCENE_POINTS, stream(config.seed, "points", c))
            filmed.append(FilmedCamera(way, seen, masks, shadows))
        return filmed, joints_m
    finally:
        stage.close()


def _film_hall(
    session: Session, c: int, camera: FilmCamera, walker: Person | None, reel: Reel, done: Iterator[int]
) -> Iterator[int]:
    """Film the reference image, the sweep, with the ``walker`` in it, and the zoom run of camera ``c``."""
    yield from _write(reel.reference, iter([camera.still()]), done)
    for path, run, person in ((reel.sweep, session.sweep(c), walker), (reel.zoom, session.zoom(c), None)):
        if len(run.times_s):
            yield from _write(path, (camera.instant(run.at, t, person) for t in run.times_s.tolist()), done)


def _silhouettes(
    session: Session, c: int, way: Trajectory, camera: FilmCamera, done: Iterator[int]
) -> Generator[int, None, tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Masks of the athlete in every frame, and of the shadow in every tenth, a bit a pixel."""
    masks, shadows = [], []
    for f, time_s in enumerate(session.own_s(c, session.times_s).tolist()):
        mask = camera.mask(way.at, time_s, session.clip.at)
        masks.append(np.packbits(mask))
        if f % _SHADOW_EVERY == 0:
            shadows.append(np.packbits(camera.shadow(way.at, time_s, session.clip.at, mask)))
        yield next(done)
    return np.array(masks), np.array(shadows)


# --------------------------------------------------------------------------------------------------------------
# Videos of light: without loss, in red, green and blue


def _write(path: Path, lights: Iterable[Image], done: Iterator[int]) -> Iterator[int]:
    """Encode pictures (H, W, 3) to ``path``; yield how many are done. Raises PzcapError if the disk is full."""
    try:
        with av.open(str(path), "w") as container:
            encoder = container.add_stream(_LOSSLESS, rate=1)
            encoder.pix_fmt = "gbrp"
            encoder.codec_context.thread_count = 1  # the cameras are filmed side by side as it is
            for light in lights:
                if not encoder.codec_context.is_open:
                    encoder.height, encoder.width = light.shape[:2]
                container.mux(encoder.encode(VideoFrame.from_ndarray(light, format="rgb24")))
                yield next(done)
            container.mux(encoder.encode())
    except OSError as error:
        reason = "the disk is full; free some space" if error.errno == errno.ENOSPC else error.strerror
        raise PzcapError(f"{path}: cannot write the video: {reason}") from error


def read_light(path: Path) -> Iterator[Image]:
    """Pictures (H, W, 3), red-green-blue, that `film` wrote to ``path``."""
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
