"""Synchronisation of the motion's recordings: one way after the other, until one leaves no doubt."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.io.video import VideoReader
from pzcap.progress import Report
from pzcap.synchronisation import flash, sound, subject_motion
from pzcap.synchronisation.offsets import Delay, connected, solve
from pzcap.types import Array, CameraClock, Image

WAYS: Final = ("sound", "flash", "motion")
_AGREE_FRAMES: Final = {"sound": 1.0, "flash": 1.5, "motion": 1.5}
"""Frames to which the delays of all pairs of cameras have to agree."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The motion as one camera recorded it."""

    name: str
    reader: VideoReader
    distance_m: float | None  # of the camera from the middle of the hall, where the crew claps


@dataclass(frozen=True, slots=True, eq=False)
class Synchronisation:
    """Clocks of the cameras, by name, and what each way that was tried had to say; no clocks: they are not known."""

    clocks: dict[str, CameraClock] | None
    tried: tuple[str, ...]
    left_s: float = 0.0


def synchronise(recordings: Sequence[Recording], ways: Sequence[str], report: Report) -> Synchronisation:
    """Find how the recordings lie to each other, the first being at 0, by the first of the ``ways`` that can tell."""
    tried: list[str] = []
    frame_s = max(1.0 / float(each.reader.frame_rate) for each in recordings)
    if len(recordings) == 1:
        return Synchronisation({recordings[0].name: CameraClock(0.0, 1.0, 0.0, "one camera")}, ())
    for way in ways:
        found, why, rates = _delays(way, recordings, report)
        solved = None if why else solve(len(recordings), found, _AGREE_FRAMES[way] * frame_s)
        if solved is not None:
            rate = rates(solved.offset_s)
            clocks = {
                each.name: CameraClock(float(o), float(r), float(s), way)
                for each, o, r, s in zip(recordings, solved.offset_s, rate, solved.sigma_s, strict=True)
            }
            return Synchronisation(clocks, tuple(tried), solved.left_s)
        tried.append(f"{way}: {why or _doubt(recordings, found)}")
    return Synchronisation(None, tuple(tried))


def _doubt(recordings: Sequence[Recording], found: Sequence[Delay]) -> str:
    names = [each.name for each in recordings]
    if not found:
        return "no two cameras can be brought together"
    if connected(len(names), found):
        return "pairs of cameras contradict each other"
    seen = {each.a for each in found} | {each.b for each in found}
    apart = [name for k, name in enumerate(names) if k not in seen]
    return f"nothing brings camera {', '.join(apart)} to the others" if apart else "some cameras know nothing of others"


def _delays(
    way: str, recordings: Sequence[Recording], report: Report
) -> tuple[list[Delay], str, Callable[[Array], Array]]:
    """Delays by a way, why there are none, and what tells the rates of the clocks from the offsets."""

    def even(_: Array) -> Array:
        return np.ones(len(recordings))

    if way == "sound":
        sounds = []
        for number, each in enumerate(recordings):
            report("sound", number, len(recordings))
            heard = sound.sound_of(each.reader.path, each.distance_m, each.reader.begins_s)
            if heard is None:
                return [], f"camera {each.name} has none", even
            sounds.append(heard)
        return list(sound.delays(sounds)), "", lambda offset_s: sound.rates(sounds, offset_s)
    if way == "flash":
        steps = []
        for each, images in _watched(way, recordings, report):
            steps.append(flash.steps(each.reader, np.array([flash.brightness(image) for image in images])))
        if not any(len(each.times_s) for each in steps):
            return [], "no camera saw one", even
        return list(flash.delays(steps)), "", even
    signals = []
    for each, images in _watched(way, recordings, report):
        gathered = subject_motion.RisingSignal()
        for image in images:
            gathered.add(image)
        signals.append(gathered.signal(each.reader))
    return list(subject_motion.delays(signals)), "", even


def _watched(way: str, recordings: Sequence[Recording], report: Report) -> Iterator[tuple[Recording, Iterator[Image]]]:
    """Each recording with its pictures."""
    total = sum(each.reader.frame_count for each in recordings)
    done = 0

    def pictures(reader: VideoReader) -> Iterator[Image]:
        nonlocal done
        for _, image in reader:
            yield image
            done += 1
            report(way, done, total)

    for each in recordings:
        yield each, pictures(each.reader)
