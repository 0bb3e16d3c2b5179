"""Develops light (`sim.light`) to a capture as a crew brings it home: sensor, recorder, papers; and its truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import asdict, replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from pzcap.io.timecode import frames_to_timecode
from pzcap.types import Array, CameraFiles, Capture, Image, Mask
from sim import motion
from sim.cameras.optics import vignette
from sim.cameras.sensor import Automatics, Exposure, Sensor, draw_dropped, field_delay_s, row_delay_s
from sim.capture_writer import write_capture, write_video
from sim.hall import gym
from sim.light import operate, read_light, reels
from sim.measuring import sides_of_carpet
from sim.people.crew import keyframe_indices, measure, pose_by_hand
from sim.people.detector import Detector, write_openpose
from sim.scene import skeleton, stream
from sim.session import Session, ShootConfig, assemble
from sim.team import Progress, side_by_side
from sim.truth import load, save


def develop(config: ShootConfig, light: Path, folder: Path) -> Iterator[Progress]:
    """Write ``folder/capture`` and ``folder/truth`` from what `sim.light.film` wrote to ``light``; yield the progress.

    Raises PzcapError if the disk is full.
    """
    session = assemble(config)
    for files in session.files(folder / "capture"):
        files.motion.parent.mkdir(parents=True)
    recorded = [_recorded(session, c) for c in range(config.cameras)]
    hall = 1 + len(session.sweep(0).times_s) + config.zoom_frames
    total = config.cameras * hall + sum(int(frames.sum()) for frames in recorded)
    yield from side_by_side("develop", config.cameras, total, develop_cameras, session, light, folder / "capture")
    if config.detector.enabled:
        yield from _detect(session, folder / "capture")
    truth = load(light / "truth")
    timecodes = session.timecodes()  # light does not know how the crew brings the cameras together
    _write_papers(session, folder / "capture", timecodes)
    clock, frames = session.clock(), len(session.times_s)
    filmed = np.array([recorded[c][clock.early[c] : clock.early[c] + frames] for c in range(config.cameras)])
    gain = np.array([_true_gain(session, c) for c in range(config.cameras)])
    known = replace(truth, config=json.dumps(asdict(config)), timecodes=timecodes, recorded=filmed, gain=gain)
    save(known, folder / "truth")


def develop_cameras(cameras: Sequence[int], session: Session, light: Path, capture: Path) -> Generator[int, None, None]:
    """Write the picture and the videos of some of the cameras; yield how many pictures are done."""
    config, done = session.config, 0
    for c in cameras:
        files, reel, clock = session.files(capture)[c], reels(light, session.config)[c], session.clock()
        sensor = Sensor(config.sensor, vignette(session.rigs[c]), stream(config.seed, "sensor", c))
        if files.reference is not None:
            [reference] = _developed(session, c, sensor, reel.reference, np.zeros(1), "reference")
            _write_png(files.reference, reference)
        done += 1
        yield done
        rate, woven = Fraction(config.sweep_frame_rate), bool(config.sensor.field_s and not config.sensor.bob)
        for path, film, run, purpose in (
            (files.sweep, reel.sweep, session.sweep(c), "sweep"),
            (files.zoom, reel.zoom, session.zoom(c), "zoom"),
        ):
            if path is not None:
                pictures = _developed(session, c, sensor, film, run.times_s, purpose)
                write_video(path, pictures, rate, crf=config.sensor.crf_still, interlaced=woven)
                done += len(run.times_s)
                yield done
        rate, kept = Fraction(config.frame_rate), _recorded(session, c)
        pictures = _developed(session, c, sensor, reel.motion, session.exposed_s(c), "motion video", kept)
        timecode, indices = frames_to_timecode(clock.start - clock.early[c], rate), np.flatnonzero(kept).tolist()
        write_video(
            files.motion, pictures, rate, crf=config.sensor.crf_motion, indices=indices, interlaced=woven,
            sound=session.sound(c), timecode=timecode if config.crew.sync == "timecode" else None,
        )  # fmt: skip
        done += len(indices)
        yield done


def _developed(
    session: Session, c: int, sensor: Sensor, film: Path, times_s: Array, purpose: str, kept: Mask | None = None
) -> Iterator[Image]:
    """Pictures of ``film`` by camera ``c``, exposed at ``times_s`` (N,), but for those that are not ``kept`` (N,)."""
    rng = stream(session.config.seed, purpose, c)
    gain_at = _gain(session, c, purpose, rng)
    keeps = np.ones(len(times_s), bool) if kept is None else kept
    for light, time_s, keep in zip(read_light(film), times_s.tolist(), keeps.tolist(), strict=True):
        if keep:
            yield sensor.develop(light, gain_at(time_s), rng)


def _gain(session: Session, c: int, purpose: str, rng: np.random.Generator) -> Callable[[float], Array | float]:
    """Gain over time of what camera ``c`` films for some purpose, as `Sensor.develop` takes it."""
    config, sensor = session.config, session.config.sensor
    exposure, mains = Exposure(sensor.exposure_drift, rng), session.mains(c, purpose)
    brightness = config.gym.lights_on if purpose == "motion video" else 1.0
    rows = np.arange(float(config.height))
    delays_s = (row_delay_s(rows, config.height, sensor.readout_s) + field_delay_s(rows, sensor))[:, None, None]
    automatics = None
    if sensor.auto_exposure or sensor.white_drift:
        rate = config.frame_rate if purpose == "motion video" else config.sweep_frame_rate
        automatics = Automatics(sensor, 1 / rate, stream(config.seed, "automatics", purpose, c))

    def at(time_s: float) -> Array | float:
        gain: Array | float = brightness * exposure(time_s)
        if purpose == "motion video":
            gain *= session.flash(time_s)
        gain = gain if automatics is None else gain * automatics(time_s)
        return gain if mains is None else gain * mains(time_s + delays_s)

    return at


def _true_gain(session: Session, c: int) -> Array:
    """(F, 3) gain of blue, green and red in the frames of the motion by camera ``c``, the mean of all rows."""
    purpose = "motion video"
    gain_at = _gain(session, c, purpose, stream(session.config.seed, purpose, c))
    gains = [np.broadcast_to(gain_at(t), (session.config.height, 1, 3)) for t in session.own_s(c, session.times_s)]
    return np.array(gains).mean(axis=(1, 2))


def _recorded(session: Session, c: int) -> Mask:
    """(N,) frames of the motion that camera ``c`` does not drop."""
    sensor, seed = session.config.sensor, session.config.seed
    return ~draw_dropped(len(session.exposed_s(c)), sensor.dropped_share, stream(seed, "dropped", c))


def _detect(session: Session, capture: Path) -> Iterator[Progress]:
    """Write the keypoints that a detector finds in the motion videos."""
    config, model = session.config, session.model_spec().compile()
    _, outline_m = skeleton(model, session.clip, session.times_s, session.measurements)
    detector = Detector(model, session.measurements, config.detector, stream(config.seed, "detector"))
    for c, files in enumerate(session.files(capture)):
        assert files.keypoints is not None
        way, times_s = operate(session, c, outline_m), session.exposed_s(c)[_recorded(session, c)]
        rng = stream(config.seed, "detector", c)
        people = [
            detector.watch(session.rigs[c], way, person, times_s, config.sensor, rng)
            for person in (session.clip.at, *session.others())
        ]
        write_openpose(files.keypoints, files.motion.stem, people)
        yield Progress("detect", c + 1, config.cameras)


def _write_papers(session: Session, folder: Path, timecodes: Sequence[str]) -> None:
    """Write the capture's manifest: the object, the tape's readings, the keyframes."""
    config, times_s = session.config, session.times_s
    hand = stream(config.seed, "keyframes")
    keyframes = {
        timecodes[f]: pose_by_hand(session.clip.at(times_s[f]), config.crew, hand)
        for f in keyframe_indices(len(times_s), config.frame_rate, config.crew)
    }
    write_capture(
        Capture(
            folder=folder,
            name=f"{motion.title(config.motion)}, seed {config.seed}",
            frame_rate=Fraction(config.frame_rate),
            cameras=tuple(CameraFiles(*files) for files in session.files(folder)),
            calibration_object=gym.calibration_object() if config.crew.calibration_object else None,
            subject=measure(session.measurements, config.crew, stream(config.seed, "tape"), config.athlete.garments()),
            keyframe_poses=keyframes,
            full_turn=config.sweep_deg >= 360.0,
            lengths=sides_of_carpet(session) if config.crew.lengths == "carpet" else (),
        )
    )


def _write_png(path: Path, image: Image) -> None:
    encoded, data = cv2.imencode(".png", image)
    assert encoded
    path.write_bytes(data.tobytes())
