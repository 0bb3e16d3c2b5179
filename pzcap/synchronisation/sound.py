"""Delays between cameras by their sound: generalised cross-correlation with phase transform (GCC-PHAT; Knapp, Carter
1976), which makes an echoing hall's sound as short as a click. Where something bangs, all else is muted: what hums all
the time hums at one camera and not in the middle, and would be what they agree on.

Sound takes 2.9 ms for a metre. Where the cameras' places are known, what it takes from the middle of the hall, where
the crew claps, is taken off; else this stands in the uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Final

import av
import numpy as np
from av.audio.resampler import AudioResampler
from av.error import FFmpegError
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from pzcap.io.files import checked
from pzcap.synchronisation.offsets import Delay
from pzcap.synchronisation.tuning import SOUND
from pzcap.types import Array

SAMPLES_PER_S: Final = 8_000


@dataclass(frozen=True, slots=True, eq=False)
class Sound:
    """Sound of a recording."""

    samples: Array  # (N,) from the file's time 0 on
    distance_m: float | None  # of the camera from the middle of the hall


def sound_of(path: Path, distance_m: float | None, begins_s: float = 0.0) -> Sound | None:
    """The sound that a video has beside its pictures, on their clock; None where it has none, or a silent one.
    ``begins_s``: as of `VideoReader`."""
    pieces: list[Array] = []
    begin_s: float | None = None
    try:
        with av.open(str(checked(path)), metadata_errors="replace") as container:
            if not container.streams.audio:
                return None
            resampler = AudioResampler(format="flt", layout="mono", rate=SAMPLES_PER_S)
            length = 0
            for frame in container.decode(container.streams.audio[0]):
                if begin_s is None:
                    begin_s = 0.0 if frame.time is None else float(frame.time) - begins_s
                    if abs(begin_s) > SOUND.longest_s:  # not beside its pictures
                        return None
                for part in resampler.resample(frame):
                    pieces.append(part.to_ndarray().ravel().astype(np.float64))
                    length += len(pieces[-1])
                if length > SOUND.longest_s * SAMPLES_PER_S:
                    break
    except (FFmpegError, ValueError):  # a track that nobody can decode is none
        return None
    if not pieces or begin_s is None:
        return None
    samples, shift = np.concatenate(pieces), round(begin_s * SAMPLES_PER_S)
    samples = np.concatenate([np.zeros(shift), samples]) if shift >= 0 else samples[-shift:]
    return Sound(samples, distance_m) if np.ptp(samples) > 1e-4 else None


def delays(sounds: Sequence[Sound]) -> Iterator[Delay]:
    """Those delays between pairs of cameras of which their sound leaves no doubt."""
    for a, b in combinations(range(len(sounds)), 2):
        first, second = sounds[a], sounds[b]
        found = correlated(first.samples, second.samples)
        if found is None:
            continue
        if first.distance_m is None or second.distance_m is None:
            yield Delay(a, b, found, float(np.hypot(SOUND.recorder_s, SOUND.anywhere_m / SOUND.sound_m_per_s)))
        else:
            later = (second.distance_m - first.distance_m) / SOUND.sound_m_per_s
            yield Delay(a, b, found - later, float(np.hypot(SOUND.recorder_s, SOUND.middle_m / SOUND.sound_m_per_s)))


def rates(sounds: Sequence[Sound], offset_s: Array) -> Array:
    """(C,) seconds of the first camera's clock for one of each camera's, 1 where recordings are too short to tell."""
    found = np.ones(len(sounds))
    for c in range(1, len(sounds)):
        slope = _drift(sounds[0].samples, sounds[c].samples, float(offset_s[0] - offset_s[c]))
        found[c] = 1.0 / (1.0 + slope)
    return found


def _drift(one: Array, other: Array, delay_s: float) -> float:
    """Growth of the delay, s / s, over windows of two recordings; 0 where it is not known well."""
    window, shift = round(SOUND.window_s * SAMPLES_PER_S), round(delay_s * SAMPLES_PER_S)
    times, later = [], []
    for start in range(max(0, -shift), min(len(one), len(other) - shift) - window, window):
        there = correlated(one[start : start + window], other[start + shift : start + shift + window])
        if there is not None and abs(there) < 0.5:
            times.append((start + window / 2) / SAMPLES_PER_S)
            later.append(there)
    if len(times) < SOUND.windows:
        return 0.0
    (slope, _), covariance = np.polyfit(times, later, 1, cov=True)
    return float(slope) if np.sqrt(covariance[0, 0]) < SOUND.drift else 0.0


def bangs(samples: Array) -> Array:
    """The samples (N,), muted where nothing bangs; as they are, where nothing does at all."""
    frames = len(samples) // SOUND.frame
    energy = np.sum(samples[: frames * SOUND.frame].reshape(frames, SOUND.frame) ** 2, axis=1)
    loud = np.flatnonzero(energy > SOUND.bang * np.median(energy) + 1e-12)
    if not loud.size:
        return samples
    kept = np.zeros(len(samples), bool)
    for frame in loud.tolist():
        kept[max(0, frame - SOUND.held[0]) * SOUND.frame : (frame + SOUND.held[1]) * SOUND.frame] = True
    return np.where(kept, samples, 0.0)


def correlated(one: Array, other: Array) -> float | None:
    """How many seconds later ``other`` sounds like ``one``, both (N,) samples; None where that leaves doubt."""
    count = next_fast_len(len(one) + len(other), real=True)
    cross = rfft(bangs(other), count) * np.conj(rfft(bangs(one), count))
    frequency = rfftfreq(count, 1.0 / SAMPLES_PER_S)
    band = (frequency >= SOUND.band_hz[0]) & (frequency <= SOUND.band_hz[1])
    whitened = np.where(band, cross / (np.abs(cross) + 1e-12 * np.abs(cross).max() + 1e-300), 0.0)
    # hands that clap move about: what several claps say falls within some milliseconds of each other
    spread = np.exp(-2.0 * (np.pi * frequency * SOUND.spread_s) ** 2)
    sharp = irfft(whitened, count)
    correlation = irfft(rfft(np.maximum(sharp, 0.0), count) * spread, count)
    correlation -= correlation.mean()
    lags = np.arange(count)
    lags[lags >= len(other)] -= count
    peak = int(np.argmax(correlation))
    far = np.abs(lags - lags[peak]) > SOUND.neighbourhood_s * SAMPLES_PER_S
    height, noise = float(correlation[peak]), float(np.std(correlation))
    if height < SOUND.sure * noise or float(correlation[far].max(initial=0.0)) > SOUND.next * height:
        return None
    return float(lags[peak] / SAMPLES_PER_S)
