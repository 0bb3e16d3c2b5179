"""Films a capture: a session to ``capture/``, as a crew brings it home, and ``truth/`` beside it."""

from __future__ import annotations

import errno
import math
from collections.abc import Generator, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from pzcap.io.video import frames_per_day, frames_to_timecode
from pzcap.types import Array, CameraFiles, Capture, Image, PzcapError
from sim import motion
from sim.cameras.film import Recording
from sim.cameras.operator import Trajectory, follow, sweep, swinging, through, tilting, zooming
from sim.cameras.render import check_gl
from sim.cameras.sensor import draw_dropped, rolls
from sim.capture_writer import write_capture
from sim.collect_truth import FilmedMotion, collect_truth
from sim.hall import gym
from sim.hall.furniture import REARRANGED
from sim.people.crew import keyframe_indices, measure, pose_by_hand, to_and_fro
from sim.people.detector import Detector, write_openpose
from sim.scene import skeleton, stream
from sim.session import CAMERAS, Session, ShootConfig, assemble
from sim.truth import save

_SHADOW_EVERY: Final = 10  # frames


class Progress(NamedTuple):
    stage: str
    done: int
    total: int


def shoot(config: ShootConfig, folder: Path) -> Iterator[Progress]:
    """Write ``folder/capture`` and ``folder/truth``; yield the progress.

    Raises PzcapError if GL is missing, the disk is full, or a file that the config names cannot be used.
    """
    check_gl()
    try:
        yield from _shoot(config, folder)
    except OSError as error:
        reason = "the disk is full; free some space" if error.errno == errno.ENOSPC else error.strerror
        raise PzcapError(f"{folder}: cannot write the capture: {reason}") from error


def _shoot(config: ShootConfig, folder: Path) -> Iterator[Progress]:
    yield Progress("build", 0, 1)
    session = assemble(config, folder / "capture")
    yield Progress("build", 1, 1)
    try:
        hall = yield from _film_hall(session)
        filmed = yield from _film_motion(session)
        yield Progress("write", 0, 1)
        _write_manifest(session, folder / "capture", filmed)
        save(collect_truth(session, hall, filmed), folder / "truth")
        yield Progress("write", 1, 1)
    finally:
        session.stage.close()


def _film_hall(session: Session) -> Generator[Progress, None, dict[str, list[Trajectory]]]:
    """Reference image, sweep and zoom run of each camera; return the trajectories of each "sweep" and "zoom" run."""
    config, sensor = session.config, session.config.sensor
    focal_px = session.rigs[0].reference_focal_px
    low, high = (math.log(focal_px * zoom) for zoom in (config.optics.zoom_min, config.optics.zoom_max))
    trajectories: dict[str, list[Trajectory]] = {"sweep": [], "zoom": []}
    how = Recording(Fraction(config.sweep_frame_rate), sensor.crf_still, sensor.supersampling_still)
    walker = None
    if config.crew.walks_in_sweep:
        somebody = motion.make("pedestrian", session.measurements, stream(config.seed, "walker"))
        walker = to_and_fro(somebody, stream(config.seed, "walker's way"))
    for c, (camera, files) in enumerate(zip(session.cameras, session.files, strict=True)):
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
            trajectory = through(times_s, *run)
            trajectories[kind].append(trajectory)
            person, rng = walker if kind == "sweep" else None, stream(config.seed, kind, c)
            exposing = camera.record(getattr(files, kind), trajectory.at, times_s, person, how, rng)
            for k in exposing:
                yield Progress(f"{kind} {files.name}", k + 1, count)
    return trajectories


def _film_motion(session: Session) -> Generator[Progress, None, FilmedMotion]:
    """The motion, camera by camera, and its masks."""
    config, sensor, seed = session.config, session.config.sensor, session.config.seed
    rate = Fraction(config.frame_rate)
    times_s, frames = session.times_s, len(session.times_s)
    joints_m, outline_m = skeleton(session.stage, session.clip, times_s, session.measurements)
    trajectories = session.given_trajectories or [_operate(session, c, times_s, outline_m) for c in range(CAMERAS)]
    if config.gym.rearranged:
        for piece, by_m in REARRANGED.items():
            session.stage.carry(piece, by_m)
    clock = stream(seed, "clock")
    start = int(clock.integers(frames_per_day(rate) // 3, frames_per_day(rate) // 2))
    early, late = rolls(CAMERAS, sensor.largest_roll, clock)

    shadow_frames = np.arange(0, frames, _SHADOW_EVERY)
    packed = -(-config.width * config.height // 8)
    mask_bits = np.zeros((CAMERAS, frames, packed), np.uint8)
    shadow_bits = np.zeros((CAMERAS, len(shadow_frames), packed), np.uint8)
    recorded = np.ones((CAMERAS, frames), bool)
    detector = Detector(session.stage, session.measurements, config.detector, stream(seed, "detector"))
    for c, (camera, files) in enumerate(zip(session.cameras, session.files, strict=True)):
        dropped = draw_dropped(early[c] + frames + late[c], sensor.dropped_share, stream(seed, "dropped", c))
        recorded[c] = ~dropped[early[c] : early[c] + frames]
        indices = np.flatnonzero(~dropped)
        exposed_s = (indices - early[c]) / config.frame_rate
        how = Recording(
            rate, sensor.crf_motion, sensor.supersampling, sensor.sub_exposures, config.gym.lights_on,
            frames_to_timecode(start - early[c], rate), indices.tolist(),
        )  # fmt: skip
        rng = stream(seed, "motion video", c)
        exposing = camera.record(files.motion, trajectories[c].at, exposed_s, session.clip.at, how, rng)
        for k in exposing:
            yield Progress(f"motion {files.name}", k + 1, len(indices))
        if files.keypoints is not None:
            rng = stream(seed, "detector", c)
            found = detector.watch(session.rigs[c], trajectories[c], session.clip.at, exposed_s, sensor.shutter_s, rng)
            write_openpose(files.keypoints, files.motion.stem, found)
        for f, time_s in enumerate(times_s.tolist()):
            mask = camera.mask(trajectories[c].at, time_s, session.clip.at)
            mask_bits[c, f] = np.packbits(mask)
            if f % _SHADOW_EVERY == 0:
                shadow = camera.shadow(trajectories[c].at, time_s, session.clip.at, mask)
                shadow_bits[c, f // _SHADOW_EVERY] = np.packbits(shadow)
            yield Progress(f"masks {files.name}", f + 1, frames)
    timecodes = tuple(frames_to_timecode(start + f, rate) for f in range(frames))
    return FilmedMotion(times_s, timecodes, joints_m, trajectories, recorded, mask_bits, shadow_frames, shadow_bits)


def _operate(session: Session, c: int, times_s: Array, outline_m: Array) -> Trajectory:
    """The trajectory of camera ``c`` while the motion is recorded: its operator follows the body."""
    seed, rig, config = session.config.seed, session.rigs[c], session.config.operator
    trajectory = follow(rig, times_s, outline_m, config, stream(seed, "operator", c))
    if config.swing_deg_s > 0:
        trajectory = swinging(trajectory, config, stream(seed, "swing", c))
    if config.zoom_swing_s > 0:
        trajectory = zooming(trajectory, rig, config, stream(seed, "zoom swing", c))
    if config.tilts:
        trajectory = tilting(trajectory, rig, times_s, outline_m, config, stream(seed, "tilt", c))
    return trajectory


def _write_manifest(session: Session, folder: Path, filmed: FilmedMotion) -> None:
    """Write the capture's manifest: the object, the tape's readings, the keyframes."""
    config = session.config
    hand = stream(config.seed, "keyframes")
    keyframes = {
        filmed.timecodes[f]: pose_by_hand(session.clip.at(filmed.times_s[f]), config.crew, hand)
        for f in keyframe_indices(len(filmed.times_s), config.frame_rate, config.crew)
    }
    write_capture(
        Capture(
            folder=folder,
            name=f"{motion.title(config.motion)}, seed {config.seed}",
            frame_rate=Fraction(config.frame_rate),
            cameras=tuple(CameraFiles(*files) for files in session.files),
            calibration_object=gym.calibration_object(),
            subject=measure(session.measurements, config.crew, stream(config.seed, "tape")),
            keyframe_poses=keyframes,
            full_turn=config.sweep_deg >= 360.0,
        )
    )


def _write_png(path: Path, image: Image) -> None:
    encoded, data = cv2.imencode(".png", image)
    assert encoded
    path.write_bytes(data.tobytes())
